"""Fit the network of :mod:`recon.depth.learned`; needs the extra ``learn`` (PyTorch and safetensors).

The loss of a pixel is the cross entropy of its blur, shared linearly between the two nearest classes, plus
``MEAN_WEIGHT`` times the absolute error of the mean over 1 + blur / 4. A room is seen in several lights, with
noise of its own in each; a dataset's captures keep theirs. All are mirrored and cropped at random.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save
from torch import Tensor
from torch.nn import functional

from dasim.base import atomic
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.depth.learned import MULTIPLE, blur_grid, images
from recon.depth.learned_network import Network
from validation.training.depth_examples import Example, exposed
from validation.training.network import Training, train

BATCH = 8
EXPOSURES = 4  # of a room
LARGEST = (96, 128)  # height and width of what is seen of an example at a time, samples of the planes
TRAINING = Training(rate=3e-3, decay=1e-2, warm_up=0.1)
MEAN_WEIGHT = 0.5

Report = Callable[[int, float, Network], None]


class Shown(NamedTuple):
    """A fixed example: what the network sees, [IMAGES, h, w], and the visible blur in pixels, [h, w], NaN unknown."""

    images: Float32Array
    blur_px: Float32Array


Source = Callable[[np.random.Generator], Shown]
"""An example as one pass sees it."""


def of_room(one: Example, random: np.random.Generator) -> Source:
    """A room in ``EXPOSURES`` random lights, each mirrored in another way; a pass sees one of them."""
    made = [
        mirrored(exposed(one, random), one.blur_px, one.hole, bool(number & 1), bool(number & 2))
        for number in range(EXPOSURES)
    ]
    return lambda random: made[int(random.integers(EXPOSURES))]


def of_capture(capture: Capture, blur_px: NDArray, hole: float) -> Source:
    """A capture, mirrored at random; ``blur_px`` [h/2, w/2] is NaN where it is unknown."""
    return lambda random: mirrored(capture, blur_px, hole, *(random.random(2) < 0.5))


def mirrored(capture: Capture, blur_px: NDArray, hole: float, down: bool, across: bool) -> Shown:
    """An example whose picture is mirrored, and shifted by the pixel or two that keep the mosaic's pattern.

    A picture whose pattern is not that of its mirror image at any shift stays as it is along that axis.
    """
    pattern = np.array([list(row) for row in capture.camera.sensor.mosaic])
    raw, blur = capture.raw_dn, np.asarray(blur_px, np.float32)
    for axis, wanted in enumerate((down, across)):
        order = _mirrored_order(np.moveaxis(pattern, axis, 0), raw.shape[axis]) if wanted else None
        if order is not None:
            raw, blur = raw.take(order, axis), np.flip(blur, axis)
    seen = images(Capture(raw, capture.camera, capture.exposure_s, capture.gain, capture.seed), hole)
    return Shown(seen, np.ascontiguousarray(blur))


def _mirrored_order(pattern: NDArray[np.str_], count: int) -> NDArray[np.intp] | None:
    """Which of ``count`` rows each row of the mirror image shows, so that the pattern of rows stays; None if none can.

    Rows beyond the border are those of the same phase next to it.
    """
    period, rows = len(pattern), np.arange(count)
    for shift in sorted(range(1 - period, period), key=lambda shift: (abs(shift), -shift)):
        order = count - 1 - (rows + shift)
        if (pattern[order % period] == pattern[rows % period]).all():
            return np.where(order < 0, order + period, np.where(order >= count, order - period, order))
    return None


def fit(
    sources: Sequence[Source],
    epochs: int,
    seed: int = 0,
    *,
    device: str = "cpu",
    report: Report = lambda *_: None,
) -> Network:
    """Train for a number of passes; ``report`` gets the pass, its mean loss and the network."""
    torch.manual_seed(seed)
    random = np.random.default_rng((seed, 2))
    net = Network().to(device)

    def loss_of(shown: Tensor, blur: Tensor) -> Tensor:
        return loss(net(shown.to(device)), blur.to(device))

    passes = (_batches(sources, random) for _ in range(epochs))
    train(net, TRAINING, passes, epochs * -(-len(sources) // BATCH), loss_of, report)
    return net.cpu()


def loss(logits: Tensor, blur_px: Tensor) -> Tensor:
    """Mean over the pixels whose blur [batch, h, w] is known, 0 without any; ``logits`` are [batch, class, h, w]."""
    grid = torch.tensor(blur_grid(), dtype=torch.float32, device=logits.device)
    known = blur_px.isfinite()
    blur = blur_px.nan_to_num().clamp(0, float(grid[-1])).contiguous()
    low = torch.bucketize(blur, grid[1:-1], right=True)
    share = (blur - grid[low]) / (grid[low + 1] - grid[low])
    log = functional.log_softmax(logits, 1)
    near, far = (log.gather(1, index[:, None])[:, 0] for index in (low, low + 1))
    error = (torch.einsum("bkhw,k->bhw", log.exp(), grid) - blur).abs() / (1 + blur / 4)
    return (MEAN_WEIGHT * error - (1 - share) * near - share * far)[known].sum() / known.sum().clamp(min=1)


def mean_loss(net: Network, sources: Sequence[Source], seed: int = 0) -> tuple[float, float]:
    """Mean loss over examples, each in a light of its own, and the median error of the mean blur in pixels."""
    random = np.random.default_rng((seed, 3))
    grid = torch.tensor(blur_grid(), dtype=torch.float32)
    losses, errors = [], []
    device = next(net.parameters()).device
    with torch.no_grad():
        for shown, blur in _batches(sources, random, shuffled=False):
            logits = net(shown.to(device)).cpu()
            losses.append(float(loss(logits, blur)))
            error = (torch.einsum("bkhw,k->bhw", logits.softmax(1), grid) - blur).abs()
            errors.append(error[error.isfinite()].numpy())
    return float(np.mean(losses)), float(np.median(np.concatenate(errors)))


def _batches(
    sources: Sequence[Source], random: np.random.Generator, shuffled: bool = True
) -> Iterator[tuple[Tensor, Tensor]]:
    """All examples, those of a batch cropped to the size of the smallest of them, and to ``LARGEST`` at most."""
    order = random.permutation(len(sources)) if shuffled else np.arange(len(sources))
    for start in range(0, len(order), BATCH):
        shown = [sources[index](random) for index in order[start : start + BATCH]]
        size = np.minimum(LARGEST, np.min([one.blur_px.shape for one in shown], axis=0)) // MULTIPLE * MULTIPLE
        parts = [cropped(one, (int(size[0]), int(size[1])), random) for one in shown]
        yield tuple(torch.from_numpy(np.stack(part)) for part in zip(*parts, strict=True))


def cropped(shown: Shown, size: tuple[int, int], random: np.random.Generator) -> Shown:
    """A random part of an example of the given height and width."""
    top, left = (int(random.integers(have - want + 1)) for have, want in zip(shown.blur_px.shape, size, strict=True))
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    return Shown(shown.images[:, rows, columns], shown.blur_px[rows, columns])


def write(net: Network, path: Path, about: dict[str, str]) -> None:
    """Write the weights as safetensors, in half precision, with what ``about`` says of them; nothing runs when the file
    is read.
    """
    arrays = {name: value.detach().half().contiguous() for name, value in net.state_dict().items()}
    content = save(arrays, metadata={"about": json.dumps(about)})
    atomic.write(path, content)
