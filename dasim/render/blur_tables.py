"""Tables of blur as textures, and how numbers find their place in them.

Tested in tests/dasim/render/test_radial_blur.py and tests/dasim/render/test_aberrated_blur.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.camera import wavefront
from dasim.camera.wavefront import Phase, Wavefront
from dasim.render.plugin import tensor
from dasim.typing import FloatArray

FLOOR = 1e-12  # of a density per square pixel that others are divided by
TURNS_STEP = 0.03  # RMS of the aberrations' change between two tabulated wavelengths, in waves


def texture(values: Any, channels: bool = False) -> Any:
    """A texture of one to three dimensions, linear between its nodes; ``channels``: the last axis holds channels."""
    import mitsuba as mi

    kinds = {1: mi.Texture1f, 2: mi.Texture2f, 3: mi.Texture3f}
    return kinds[values.ndim - channels](tensor(values if channels else values[..., None]))


def texel(value: Any, step: float, nodes: Any) -> Any:
    """Texture coordinate of ``value`` on nodes 0, step, ...; the first node lies at half a texel."""
    return (value / step + 0.5) / nodes


@dataclass(frozen=True)
class AberratedRows:
    """Where a table of aberrated kernels h has a defocus and a wavelength.

    Its rows are all values of defocus, of both signs, at one wavelength after another, at equal steps of 1 / lambda.
    With a step of phase, its channels are h averaged over the phase, and the factors of its cosine and sine.
    """

    rows: Any  # for each wavelength
    first_waves: Any
    waves_step: float
    inverse_first: Any  # 1/nm
    inverse_step: Any
    wavelengths: int
    step_nm: Any | None

    def evaluate(self, read: Callable[[Any], Any], waves: Any, wavelength_nm: Any) -> Any:
        """The kernel at a defocus; ``read`` gives the table's channels at a row."""
        import drjit as dr
        import mitsuba as mi

        row = dr.clip((waves - self.first_waves) / self.waves_step, 0, mi.Float(self.rows - 1))
        values = read(row)
        if self.wavelengths > 1:
            at = dr.clip((dr.rcp(wavelength_nm) - self.inverse_first) / self.inverse_step, 0, self.wavelengths - 1)
            node = dr.minimum(mi.UInt32(at), self.wavelengths - 2)
            before = read(row + mi.Float(node * self.rows))
            after = read(row + mi.Float((node + 1) * self.rows))
            values = [dr.lerp(a, b, at - mi.Float(node)) for a, b in zip(before, after, strict=True)]
        if self.step_nm is None:
            return values[0]
        sine, cosine = dr.sincos(2 * dr.pi * self.step_nm / wavelength_nm)
        return values[0] + cosine * values[1] + sine * values[2]


def aberrated(
    front: Wavefront,
    range_nm: tuple[float, float],
    waves: FloatArray,
    kernels: Callable[[Phase, FloatArray], FloatArray],
) -> tuple[AberratedRows, FloatArray]:
    """The table of a stop's aberrated kernels, [wavelength x waves, ..., channel], and where to find them in it.

    Args:
        front: the wavefront of the light through the stop.
        range_nm: shortest and longest wavelength.
        waves: evenly spaced values of defocus.
        kernels: kernels [waves, ...] of unit integral for a phase and values of defocus.
    """
    import drjit as dr
    import mitsuba as mi

    low, high = 1 / range_nm[1], 1 / range_nm[0]
    count = 1 + int(np.ceil(np.hypot.reduce(front.zernike_nm) * (high - low) / TURNS_STEP))
    parts = []
    for inverse in np.linspace(low, high, count) if count > 1 else [(low + high) / 2]:
        phase = wavefront.at(front, 1 / inverse)
        assert phase is not None
        if front.opening is None:
            parts.append(kernels(phase, waves)[..., None])
            continue
        mean, cosine, sine = (kernels(phase._replace(step=step), waves) for step in (0.0, 1.0, 1j))
        parts.append(np.stack([mean, cosine - mean, sine - mean], axis=-1))
    place = AberratedRows(
        rows=dr.opaque(mi.UInt32, len(waves)),
        first_waves=dr.opaque(mi.Float, float(waves[0])),
        waves_step=float(waves[1] - waves[0]),
        inverse_first=dr.opaque(mi.Float, low),
        inverse_step=dr.opaque(mi.Float, (high - low) / max(count - 1, 1)),
        wavelengths=count,
        step_nm=None if front.opening is None else dr.opaque(mi.Float, front.step_nm),
    )
    return place, np.concatenate(parts).astype(np.float32)
