"""The learned baseline: depth by a network that sees the four planes of the mosaic, their noise and the hole's size.

It is what a user without a camera model would train: its inputs contain no point-spread functions and no likelihoods.
Infrared is subtracted from the visible planes (eq. (7)), and each plane is the logarithm of its electrons relative to
the frame mean. Four constant planes give the noise; a fifth gives the ratio of the radii of the infrared and the
visible aperture. The network (:mod:`recon.depth.learned_network`) predicts probabilities of visible blur diameters.
Their mean and standard deviation are converted to a level of the bank and its standard deviation.

The network needs PyTorch and safetensors, of the extra ``learn``; both are imported at the first estimate.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array, FloatArray
from dasim.values import Capture, DepthEstimate, PsfBank
from recon.calibration.fit import check_fits
from recon.picture import infrared, mosaic

FILE = Path(__file__).with_name("learned.safetensors")
MISSING = "the learned depth estimate needs PyTorch and safetensors: pip install -c constraints.txt -e '.[learn]'"
MOST_BYTES = 5 * 2**20  # of a file of weights

FINEST_PX, RELATIVE, LAST_PX = 1.0, 1 / 8, 60.0  # spacing of blurs: the larger of a number and a share of the blur
FLOOR = 2.0  # noise standard deviations in the dark that are added before the logarithm
IMAGES = 2 * len(CHANNELS) + 1  # that the network sees
STEP = 4  # samples of the planes between estimates
MULTIPLE = 16  # of the sides of the images


def blur_grid() -> FloatArray:
    """Visible blur diameters in pixels that the network gives probabilities of, [class], rising from 0."""
    grid = [0.0]
    while grid[-1] < LAST_PX:
        grid.append(grid[-1] + max(FINEST_PX, RELATIVE * grid[-1]))
    return np.array(grid)


def images(capture: Capture, hole: float) -> Float32Array:
    """What the network sees of a capture, [image, h/2, w/2]: R, G, B and IR, their noise, and the hole.

    A plane of x electrons is log((max(x, 0) + f) / (m + f)) with its mean m over the frame and f of ``FLOOR`` standard
    deviations of its noise in the dark; its noise is the constant log(s / m) with the standard deviation s at the mean.

    Args:
        capture: the capture, of a mosaic with infrared.
        hole: radius of the infrared aperture over that of the visible one, 0..1.
    """
    electrons, _ = mosaic.linearise(capture)
    planes = mosaic.planes(electrons, capture.camera)
    alpha = dict(zip("RGB", infrared.crosstalk(capture.camera, None), strict=True))
    own = {name: mosaic.noise_variance(capture, name) for name in planes}
    shown, noise = [], []
    for name in CHANNELS:
        leak = alpha.get(name, 0.0)
        plane = planes[name] - leak * planes["IR"]
        dark, at_mean = (
            own[name].at(planes[name].mean() * share) + leak**2 * own["IR"].at(planes["IR"].mean() * share)
            for share in (0.0, 1.0)
        )
        floor = FLOOR * np.sqrt(dark)
        mean = max(float(plane.mean()), 0.0)
        shown.append(np.log((np.maximum(plane, 0) + floor) / (mean + floor)))
        noise.append(np.full_like(plane, np.log(np.sqrt(at_mean) / (mean + floor))))
    return np.stack([*shown, *noise, np.full_like(shown[0], hole)]).astype(np.float32)


def hole_of(bank: PsfBank) -> float:
    """Radius of the infrared aperture over that of the visible one, from the kernels at the bank's last level.

    There blur is much wider than diffraction, and the sum of the squares of a flat kernel of unit sum is 1 over its
    area. The light with the least infrared in green is used.
    """
    light = int(np.argmin(bank.signature[:, CHANNELS.index("IR")] / bank.signature[:, CHANNELS.index("G")]))
    green, ir = (bank.kernel[light, -1, CHANNELS.index(name)].astype(np.float64) for name in ("G", "IR"))
    return float(np.clip(np.sqrt((green**2).sum() / (ir**2).sum()), 0, 1))


def estimate(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """Blur level of every pixel and its standard deviation by the network that comes with the project.

    A depth method (:data:`recon.Method`); raises InputError without the extra ``learn``, and for a camera without
    infrared pixels. All is taken to be nearer than the focus.
    """
    return estimated(capture, bank, FILE)


def estimated(capture: Capture, bank: PsfBank, weights: Path) -> DepthEstimate:
    """The same as :func:`estimate`, by a user's own network, whose weights ``dasim learn train`` wrote."""
    check_fits(bank, capture)
    blur, sd = probabilities(images(capture, hole_of(bank)), float(bank.blur_px[-1]), weights)
    levels = np.arange(len(bank.blur_px), dtype=np.float64)
    level = np.interp(blur, bank.blur_px, levels)
    per_px = np.interp(blur, (bank.blur_px[1:] + bank.blur_px[:-1]) / 2, 1 / np.diff(bank.blur_px))
    pixels = [part.repeat(2, axis=0).repeat(2, axis=1).astype(np.float32) for part in (level, sd * per_px)]
    return DepthEstimate(level=pixels[0], sd=pixels[1], joined=True)


def probabilities(shown: Float32Array, last_px: float, weights: Path) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the visible blur in pixels, [h/2, w/2], among blurs up to ``last_px``."""
    net = network(weights)
    import torch

    height, width = shown.shape[1:]
    padding = [(0, 0), (0, -height % MULTIPLE), (0, -width % MULTIPLE)]
    grid = blur_grid()
    with torch.inference_mode():
        logits = net(torch.from_numpy(np.pad(shown, padding, mode="edge"))[None])[0, :, :height, :width]
        logits[torch.from_numpy(grid > last_px)] = -torch.inf
        share = torch.softmax(logits, 0).numpy().astype(np.float64)
    mean, square = (np.tensordot(grid**power, share, (0, 0)) for power in (1, 2))
    return mean, np.sqrt(np.maximum(square - mean**2, 0))


def network(weights: Path) -> Any:
    """The network of a file of weights, read again if the file changes; raises InputError where it is none, or PyTorch
    is missing.
    """
    path = weights.resolve()
    return _network(path, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache(maxsize=4)
def _network(weights: Path, _: int) -> Any:
    check_installed()
    from safetensors import SafetensorError
    from safetensors.torch import load

    from recon.depth import learned_network

    try:
        return learned_network.of_arrays(load(untrusted.content(weights, str(weights), MOST_BYTES)))
    except (SafetensorError, KeyError, RuntimeError, ValueError) as error:
        text = " ".join(str(error).split())
        raise InputError(
            f"{weights}: holds no network of 'dasim learn train' ({text[:120]}); train it again, or leave the file out"
        ) from None


def check_installed() -> None:
    """Raise InputError where the extra ``learn`` is not installed, without importing it."""
    if not (find_spec("torch") and find_spec("safetensors")):
        raise InputError(MISSING)
