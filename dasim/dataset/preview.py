"""What a dataset will contain and cost, before it is made: ``dasim dataset make --dry-run``.

Tested in tests/dasim/cli/test_datasets.py.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from dasim.dataset import plan
from dasim.dataset.draws import draft
from dasim.dataset.make import estimate
from dasim.dataset.sample import activate, make
from dasim.dataset.specification import DatasetSpec

TRIALS = 3  # small renders from which the cost of a dataset is estimated
TRIAL_SHARE = 4  # divisor of the frame's width and height for these renders
LEAST_SIDE_PX = 32


def lines(spec: DatasetSpec, processes: int, variant: str) -> Iterator[str]:
    """Samples and shards of each split, three samples as drawn, and the estimated cost, as text."""
    groups = plan.shards(spec)
    for split in spec.splits:
        split_groups = [group for group in groups if group.split == split]
        yield f"{split}: {sum(len(group.indices) for group in split_groups)} samples in {len(split_groups)} shards"
    for index in sorted({0, spec.made // 2, spec.made - 1}):
        yield sample_line(spec, index)
    width, height = trial_size(spec)
    count = min(TRIALS, spec.made)
    cost = estimate(spec, seconds_per_sample(spec, variant), processes)
    yield f"estimate from {count} renders of {width} x {height} pixels on one core: {cost}"


def sample_line(spec: DatasetSpec, index: int) -> str:
    """Split, scene, focus distance and drawn values of one sample."""
    drafted = draft(spec, index)
    values = (f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
              for name, value in drafted.drawn.items())  # fmt: skip
    focus_m = drafted.camera.lens.focus_distance_m
    return f"sample {index}: {drafted.split}, {drafted.scene_key}, focus {focus_m:.3g} m, {', '.join(values)}"


def trial_size(spec: DatasetSpec) -> tuple[int, int]:
    """Width and height of the trial renders, px, both even."""
    width, height = (max(side // TRIAL_SHARE // 2 * 2, LEAST_SIDE_PX) for side in spec.size_px)
    return width, height


def seconds_per_sample(spec: DatasetSpec, variant: str) -> float:
    """Estimated time of one core per sample, s, from small renders of the first samples.

    Each is rendered twice. The difference is the time of compilation, which does not depend on the frame's size; the
    second time is proportional to the number of pixels.
    """
    size_px = trial_size(spec)
    trial = spec.model_copy(update={"size_px": size_px, "truth": spec.truth.model_copy(update={"margin_px": 0})})
    factor = spec.size_px[0] * spec.size_px[1] / (size_px[0] * size_px[1])
    activate(variant)
    costs = []
    for index in range(min(TRIALS, spec.made)):
        times = []
        for _ in range(2):
            begin = time.perf_counter()
            make(trial, index, variant)
            times.append(time.perf_counter() - begin)
        costs.append(max(times[0] - times[1], 0) + times[1] * factor)
    return sum(costs) / len(costs)
