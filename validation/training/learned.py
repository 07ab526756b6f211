"""Training of :mod:`recon.depth.learned` from random rooms and datasets: ``dasim learn train``.

Tested in tests/validation/training/test_fit_depth.py.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera.sensor import channels
from dasim.dataset.reading import Sample, open_dataset, spec_of
from dasim.dataset.sample import key
from dasim.files.captures import capture_of
from dasim.typing import Progress
from recon.depth.learned import MULTIPLE
from recon.depth.learned_network import Network
from validation.training import depth_examples, fit_depth
from validation.training.fit_depth import Source

HELD_OUT = 24  # rooms, of the next seed
BEHIND_PX = -1.0  # blur behind the focus down to which a pixel counts as in focus; others are left out


class Examples(NamedTuple):
    """What is learned from, what the loss is measured with, and where both come from."""

    train: list[Source]
    held_out: list[Source]
    about: str


def examples(dataset: str | None, rooms: int, seed: int, progress: Progress = lambda stage, share: None) -> Examples:
    """Rooms and the samples of a dataset; raises InputError where there are none, or they have no truth."""
    if not dataset and not rooms:
        raise InputError("training: neither a dataset nor rooms to learn from; give a dataset, or --rooms 180")
    train: list[Source] = []
    held: list[Source] = []
    about = []
    if rooms:
        for into, count, own in ((train, rooms, seed), (held, min(HELD_OUT, rooms), seed + 1)):
            made = depth_examples.make(count, own, lambda share: progress("rooms", share))
            random = np.random.default_rng((own, 2))
            into += [fit_depth.of_room(one, random) for one in made]
        about.append(f"{rooms} rooms of validation.training.depth_examples, seed {seed}")
    if dataset:
        train += of_dataset(dataset, "train")
        if "val" in spec_of(dataset).splits:
            held += of_dataset(dataset, "val")
        spec = spec_of(dataset)
        about.append(f"the split train of the dataset {spec.name} {spec.version}")
    return Examples(train, held, " and ".join(about))


def of_dataset(dataset: str, split: str) -> list[Source]:
    """The samples of a split; raises InputError for one without depth, or a mosaic without infrared."""
    samples = open_dataset(dataset, split)
    if not len(samples):
        raise InputError(f"{dataset}: split '{split}' has no samples")
    found = [one for one in map(of_sample, samples) if one is not None]
    if not found:
        raise InputError(f"{dataset}: no sample of the split '{split}' shows a surface nearer than its focus")
    return found


def of_sample(sample: Sample) -> Source | None:
    """A sample; pixels behind the focus, without a surface, or beyond the truth's margin do not count.

    None for a sample in which none counts.
    """
    where = f"sample {key(sample.index)}"
    if "depth_m" not in sample.truth:
        raise InputError(f"{where}: its truth lacks depth; make the dataset with truth.keep = ['depth'] or more")
    capture = capture_of(sample.meta, sample.raw_dn, where)
    if missing := {"G", "IR"} - set(channels(capture.camera.sensor)):
        raise InputError(
            f"{where}: camera '{capture.camera.name}' has no {' or '.join(sorted(missing))} pixels; both are needed"
        )
    if min(capture.raw_dn.shape) < 2 * MULTIPLE:
        raise InputError(f"{where}: is smaller than {2 * MULTIPLE} pixels; make larger captures")
    blur = np.asarray(geometry.blur_px(capture.camera, np.asarray(sample.truth["depth_m"], np.float64)))
    blur = np.where(blur < BEHIND_PX, np.nan, np.maximum(blur, 0))
    if not np.isfinite(blur).any():
        return None
    return fit_depth.of_capture(capture, _of_blocks(blur, capture.raw_dn.shape), depth_examples.hole_of(capture.camera))


def _of_blocks(image: NDArray, size: tuple[int, ...]) -> NDArray:
    """Median of each 2x2 block, [h/2, w/2], of an image that may lack a margin of the frame; NaN there."""
    margin = [(have - want) // 2 for have, want in zip(size, image.shape, strict=True)]
    ends = [have - want - first for have, want, first in zip(size, image.shape, margin, strict=True)]
    whole = np.pad(image, list(zip(margin, ends, strict=True)), constant_values=np.nan)
    height, width = size[0] // 2, size[1] // 2
    blocks = whole.reshape(height, 2, width, 2).swapaxes(1, 2).reshape(height, width, 4)
    return np.asarray(np.median(blocks, axis=-1))


def check_device(device: str) -> None:
    """Raise InputError for a device that PyTorch lacks."""
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"--device {device}: {' '.join(str(error).split())[:150]}; try cpu") from None


def fitted(
    found: Examples, epochs: int, seed: int, device: str = "cpu", report: Callable[[str], None] = lambda text: None
) -> Network:
    """The trained network; ``report`` gets a line per pass. Raises InputError for a device that PyTorch lacks."""
    check_device(device)

    def line(number: int, loss: float, net: Network) -> None:
        text = f"pass {number + 1} of {epochs}: loss {loss:.3f}"
        if found.held_out:
            held, error = fit_depth.mean_loss(net, found.held_out, seed + 1)
            text += f", held out {held:.3f}, median error {error:.2f} px of blur"
        report(text)

    return fit_depth.fit(found.train, epochs, seed, device=device, report=line)


def write(net: Network, path: Path, found: Examples, epochs: int, seed: int) -> None:
    """Write the weights with what they were trained with."""
    about = {"trained_on": found.about, "passes": str(epochs), "seed": str(seed)}
    fit_depth.write(net, path, about)
