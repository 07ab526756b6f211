"""The near-infrared stop of a camera: which of its stops it is, and the camera with another shape in its place."""

from __future__ import annotations

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import stops
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.studies.shape import masks

INFRARED_NM = 730.0  # beyond the cut-off of the disc for visible light, within the band of the hole


def infrared_stop(camera: Camera) -> Stop:
    """The stop that a mask would replace: the one with the smallest open area of those that pass 730 nm."""
    passing = [
        stop for stop in camera.stops if np.interp(INFRARED_NM, grid.WAVELENGTH_NM, stops.transmittance(stop)) > 0.5
    ]
    if not passing:
        raise InputError(
            f"camera '{camera.name}' has no stop that passes 730 nm; there is no infrared aperture to shape"
        )
    return min(passing, key=stops.open_area)


def with_stop(camera: Camera, stop: Stop) -> Camera:
    """The camera with ``stop`` in place of its stop of the same name."""
    return camera.model_copy(update={"stops": tuple(stop if one.name == stop.name else one for one in camera.stops)})


def with_disc(camera: Camera, radius_ratio: float) -> Camera:
    """The camera with a centred disc as its near-infrared stop; ``radius_ratio`` is relative to the lens's radius."""
    stop = infrared_stop(camera)
    disc = stops.Disc(
        name=stop.name, radius_ratio=radius_ratio, passes_nm=stop.passes_nm, edge_width_nm=stop.edge_width_nm
    )
    return with_stop(camera, disc)


def with_mask(camera: Camera, amplitude: FloatArray) -> Camera:
    """The camera with a mask, [cells, cells], as its near-infrared stop; raises InputError for a mask without any
    opening.
    """
    transmittance = masks.transmittance(amplitude).round(4)
    if transmittance.max() <= 0:
        raise InputError("mask: is closed everywhere; no near-infrared light passes")
    stop = infrared_stop(camera)
    mask = stops.Mask(
        name=stop.name,
        shape="mask",
        mask=tuple(map(tuple, transmittance.tolist())),
        passes_nm=stop.passes_nm,
        edge_width_nm=stop.edge_width_nm,
    )
    return with_stop(camera, mask)
