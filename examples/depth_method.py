"""A depth method of one's own: how much less fine detail green has than near-infrared, compared with the PSFs.

Blur dims the detail of green, which sees through the whole lens, more than that of near-infrared, which sees through
the small hole. The ratio of both energies of a Laplacian of Gaussian, in a window around each pixel, therefore tells
the blur level. Its value at each level follows from the kernels of the PSF bank for a texture of natural spectrum; the
estimate is the level that explains how the ratio changes from one of three scales to the next. The method is small and
classical: it assumes that green and near-infrared show the same texture, up to a factor.

    dasim validate --method laplacian=examples/depth_method.py:laplacian_ratio --only depth --out out/mine
    dasim score CAPTURE --method laplacian=examples/depth_method.py:laplacian_ratio
"""

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_laplace

from dasim.camera import noise
from dasim.values import Capture, DepthEstimate, PsfBank

SIGMAS_PX = (2.0, 4.0, 8.0)  # of the Laplacians of Gaussian, in pixels of the frame; a colour plane has half as many
WINDOW_PX = 12.0  # standard deviation of the Gaussian window over which energies are averaged
LEAST_SNR = 1.0  # energy of the detail over that of the noise, below which there is no estimate
STEP = 0.25  # blur levels between the candidates
GREEN, INFRARED = 1, 3  # places in the channel axis of a bank: R, G, B, IR


def laplacian_ratio(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """Blur level of each pixel from the ratio of detail in green and near-infrared; NaN without texture."""
    camera = capture.camera
    electrons = noise.collected_e(capture.raw_dn.astype(float), camera.sensor, capture.gain)
    green, infrared = (_plane(electrons, camera.sensor.mosaic, name) for name in ("G", "IR"))
    colour = np.log(bank.signature[:, INFRARED] / bank.signature[:, GREEN])
    light = int(np.argmin(np.abs(colour - np.log(infrared.mean() / green.mean()))))
    ratio = np.stack(
        [np.log(_detail(green, sigma / 2, capture) / _detail(infrared, sigma / 2, capture)) for sigma in SIGMAS_PX]
    )
    level = np.full(green.shape, np.nan)
    least = np.full(green.shape, np.inf)
    for number, expected in enumerate(_expected(bank, light)):
        distance = np.var(ratio - expected[:, None, None], axis=0)  # about the mean: the contrast's own ratio is free
        nearer = distance < least  # never where a scale has no detail, NaN
        level[nearer], least[nearer] = STEP * number, distance[nearer]
    return DepthEstimate(level=level.repeat(2, axis=0).repeat(2, axis=1))


def _detail(plane: np.ndarray, sigma: float, capture: Capture) -> np.ndarray:
    """Energy of a plane's detail over its squared mean, less that of the noise; NaN where the noise is stronger."""
    mean = np.maximum(gaussian_filter(plane, WINDOW_PX / 2), 1.0)
    energy = gaussian_filter(gaussian_laplace(plane, sigma) ** 2, WINDOW_PX / 2)
    variance = noise.variance(capture.camera.sensor, capture.exposure_s, capture.gain).at(mean)
    grain = variance / (2 * np.pi * sigma**6)  # integral of |LoG|^2: white noise of variance 1 keeps 1 / (2 pi sigma^6)
    return np.where(energy > (1 + LEAST_SNR) * grain, energy - grain, np.nan) / mean**2


def _plane(electrons: np.ndarray, mosaic: tuple[tuple[str, ...], ...], name: str) -> np.ndarray:
    """The pixels of one channel of a 2x2 mosaic, [h/2, w/2]; those of the first place where it has several."""
    row, column = next((y, x) for y, names in enumerate(mosaic) for x, cell in enumerate(names) if cell == name)
    return electrons[row :: len(mosaic), column :: len(mosaic[0])]


def _expected(bank: PsfBank, light: int) -> np.ndarray:
    """Logarithm of the ratio, [candidate level, scale], for a texture of power 1 / frequency^2."""
    size = 2 * bank.kernel.shape[-1]
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    square = (2 * np.pi) ** 2 * (fy**2 + fx**2)
    transfer = np.abs(np.fft.fft2(bank.kernel[light][:, [GREEN, INFRARED]], (size, size))) ** 2
    levels = np.arange(0, len(bank.depth_m) - 1 + STEP / 2, STEP)
    responses = []
    for sigma in SIGMAS_PX:
        energy = (transfer * square * np.exp(-(sigma**2) * square)).sum(axis=(-2, -1))  # |LoG|^2 over frequency^2
        responses.append(np.interp(levels, np.arange(len(energy)), np.log(energy[:, 0] / energy[:, 1])))
    return np.stack(responses, axis=-1)
