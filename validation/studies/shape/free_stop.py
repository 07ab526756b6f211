"""The objective of the mask search: a criterion of the camera as a function of the mask in its near-infrared stop.

:func:`free_stop` computes all that does not depend on the mask, so that one evaluation takes tens of milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dasim.bounds import cramer_rao, pupils
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.typing import ComplexArray, FloatArray
from validation.studies import criteria
from validation.studies.criteria import PLANES, SHAPE, SPACING_PX, Texture, TexturePatch
from validation.studies.shape.infrared_stop import infrared_stop, with_disc

Objective = Literal["depth", "all-in-focus"]


@dataclass(frozen=True)
class FreeStop:
    """A camera at a given light budget, but for the shape of its near-infrared stop."""

    pupil: pupils.Pupil  # of the free stop
    others: ComplexArray  # [blur step, plane, h, w/2 + 1], transfer through the other stops, times their share of light
    share: FloatArray  # [plane], of the light that passes the free stop
    patch: TexturePatch
    dioptre_px: float
    planes: tuple[int, ...]  # indices of the channels
    objective: Objective
    texture: Texture


def free_stop(
    camera: Camera,
    blur_px: FloatArray,
    cells: int,
    *,
    budget: float,
    light: str = "D65",
    level_lux: float = 5000.0,
    objective: Objective = "depth",
    texture: Texture = "free",
    fine_cells: int = pupils.FINE_CELLS,
) -> FreeStop:
    """The free stop for masks of ``cells`` across the lens whose open area is ``budget`` of the lens's area.

    ``blur_px`` [blur] are the visible blurs over which the objective is averaged. ``fine_cells`` is the least number of
    cells across the lens in the transforms.
    """
    stop = infrared_stop(camera)
    steps = np.concatenate([blur_px - cramer_rao.SLOPE_STEP_PX, blur_px + cramer_rao.SLOPE_STEP_PX])
    pupil = pupils.pupil(camera, stop, light, steps, cells, SHAPE, spacing_px=SPACING_PX, fine_cells=fine_cells)
    light_share = pupil.electrons * budget
    transfer: ComplexArray = np.zeros((len(steps), len(light_share), SHAPE[0], SHAPE[1] // 2 + 1), complex)
    signal = np.zeros_like(light_share)
    if others := tuple(one for one in camera.stops if one.name != stop.name):
        without = camera.model_copy(update={"stops": others})
        transfer, signal = pupils.stop_transfers(without, steps, light, SHAPE, spacing_px=SPACING_PX)
    total = light_share + signal
    index = tuple(sensors.channels(camera.sensor).index(name) for name in PLANES)
    return FreeStop(
        pupil,
        ((signal / total)[:, None, None] * transfer)[:, index],
        (light_share / total)[list(index)],
        criteria.texture_patch(with_disc(camera, float(np.sqrt(budget))), light, level_lux),
        criteria.dioptre_px(camera),
        index,
        objective,
        texture,
    )


def per_blur(stop: FreeStop, amplitude: FloatArray) -> FloatArray:
    """Standard deviation of depth in dioptres, or error of the sharp picture over the texture's contrast, [blur].

    ``amplitude`` is the mask, [cells, cells].
    """
    transfer, slope = _plane_transfers(stop, amplitude)
    if stop.objective == "depth":
        return np.asarray(
            np.sqrt(criteria.blur_variance(transfer, slope, stop.patch, stop.texture)[0]) / stop.dioptre_px
        )
    return np.asarray(np.sqrt(criteria.sharp_error(transfer, stop.patch)[0]))


def value(stop: FreeStop, amplitude: FloatArray) -> float:
    """The objective: root mean square of :func:`per_blur`."""
    return float(np.sqrt(np.mean(per_blur(stop, amplitude) ** 2)))


def value_and_gradient(stop: FreeStop, amplitude: FloatArray) -> tuple[float, FloatArray]:
    """Logarithm of :func:`value`, and its gradient by the amplitude, [cells, cells]."""
    transfer, slope = _plane_transfers(stop, amplitude)
    if stop.objective == "depth":
        variance, (by_transfer, by_slope) = criteria.blur_variance(transfer, slope, stop.patch, stop.texture)
        square = variance / stop.dioptre_px**2
        by_information = -(variance**2) / stop.dioptre_px**2
        scale = (by_information / (2 * square.sum()))[:, None, None, None]
        by_transfer, by_slope = scale * by_transfer, scale * by_slope
    else:
        square, by_transfer = criteria.sharp_error(transfer, stop.patch)
        by_transfer = by_transfer / (2 * square.sum())
        by_slope = np.zeros_like(by_transfer)
    step = 1 / (2 * cramer_rao.SLOPE_STEP_PX)
    by_step = np.concatenate([by_transfer / 2 - step * by_slope, by_transfer / 2 + step * by_slope])
    by_channel = np.zeros((len(by_step), len(stop.pupil.electrons), *by_step.shape[2:]), complex)
    by_channel[:, stop.planes] = by_step * stop.share[:, None, None]
    return float(np.log(np.mean(square)) / 2), pupils.gradient(stop.pupil, amplitude, by_channel)


def _plane_transfers(stop: FreeStop, amplitude: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """H and dH/dc of the planes with a mask in the stop, c the visible blur in px, [blur, plane, h, w/2 + 1]."""
    transfer = pupils.transfers(stop.pupil, amplitude)[:, stop.planes]
    below, above = np.split(stop.others + stop.share[:, None, None] * transfer, 2, axis=0)
    return (below + above) / 2, (above - below) / (2 * cramer_rao.SLOPE_STEP_PX)
