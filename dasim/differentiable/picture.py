"""Differentiable pictures of layers through a lens, and their sensor signals.

Layers are composited from the farthest to the nearest: each is blurred by its own kernel and occludes those behind it
by its blurred mask. In a path tracer, a near object also clips the kernels of points that it partly hides; here the
kernels keep their shape. Pictures are periodic: layers need a margin as wide as the largest blur.

Tested in tests/dasim/differentiable/test_picture.py.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.specification import Camera, mosaic_channels


def picture(radiance: Tensor, mask: Tensor, transfer: Tensor) -> Tensor:
    """Picture of layers behind a lens, [..., channel, h, w], in the unit of ``radiance``.

    Args:
        radiance: of each layer, from the farthest to the nearest, [..., layer, channel, h, w].
        mask: 0..1 where a layer is, [..., layer, h, w]; the farthest should be 1 everywhere.
        transfer: transfer functions of the layers' blurs, complex, [..., layer, channel, h, w/2 + 1].
    """
    size = mask.shape[-2:]
    masks = mask[..., None, :, :]
    lit = torch.fft.irfft2(torch.fft.rfft2(radiance * masks) * transfer, size)
    cover = torch.fft.irfft2(torch.fft.rfft2(masks) * transfer, size)
    total = lit[..., 0, :, :, :]
    for layer in range(1, lit.shape[-4]):
        total = total * (1 - cover[..., layer, :, :, :]) + lit[..., layer, :, :, :]
    return total


def nearest(mask: Tensor, values: Tensor) -> Tensor:
    """Values of the nearest layer at each pixel, [..., h, w]: of depth or blur.

    Args:
        mask: as in :func:`picture`, [..., layer, h, w].
        values: of the layers, [..., layer] or [..., layer, h, w].
    """
    if values.ndim < mask.ndim:
        values = values[..., None, None].expand(mask.shape)
    total = values[..., 0, :, :]
    for layer in range(1, mask.shape[-3]):
        share = mask[..., layer, :, :]
        total = total * (1 - share) + share * values[..., layer, :, :]
    return total


def planes(mean_e: Tensor, camera: Camera) -> Tensor:
    """The pixels of a 2x2 mosaic, [..., 4, h/2, w/2] in the order of its block, from [..., channel, h, w].

    Raises InputError for a mosaic of another period.
    """
    pattern = camera.sensor.mosaic
    if (len(pattern), len(pattern[0])) != (2, 2):
        raise InputError(f"planes: the mosaic of '{camera.name}' is {len(pattern[0])}x{len(pattern)}; it must be 2x2")
    block = mosaic_channels(camera)[:2, :2]
    places = [(y, x) for y in (0, 1) for x in (0, 1)]
    return torch.stack([mean_e[..., int(block[y, x]), y::2, x::2] for y, x in places], dim=-3)


def noisy(
    mean_e: Tensor, camera: Camera, exposure_s: float, gain: float = 1.0, generator: torch.Generator | None = None
) -> Tensor:
    """Electrons with Gaussian noise of the data sheet's standard deviation. Unlike Poisson samples, they are
    differentiable with respect to the mean. Pixels do not saturate.
    """
    constant, linear, quadratic = noise.variance(camera.sensor, exposure_s, gain)
    light = mean_e.clamp(min=0)
    deviation = (constant + linear * light + quadratic * light**2).sqrt()
    normal = torch.randn(mean_e.shape, generator=generator, dtype=mean_e.dtype, device=mean_e.device)
    return mean_e + deviation * normal
