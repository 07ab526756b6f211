"""Exact geometry at the pixel centres: depth, normals, object labels, and what follows for the blur."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.camera import geometry as cameras
from dasim.camera.specification import Camera
from dasim.typing import FloatArray

BLUR_JUMP_PX = 0.5  # neighbours whose visible blur differs by more are a depth discontinuity
_RADIUS_BINS_PX = 1.0  # boundary discs are drawn with their radius rounded up to this


class Geometry(NamedTuple):
    """What a pinhole ray through each pixel's centre meets first."""

    depth_m: FloatArray  # [h, w] z, NaN where nothing is met
    normal: FloatArray  # [h, w, 3] unit, turned towards the camera
    object_id: NDArray[np.uint32]  # [h, w] 1 is the scene's first object, 0 nothing


def field_of_view_deg(camera: Camera) -> float:
    """Horizontal field of view at the present focus; it follows from the image distance, not from f."""
    width_m = camera.sensor.width_px * camera.sensor.pixel_pitch_um * 1e-6
    return float(np.degrees(2 * np.arctan(width_m / (2 * cameras.image_distance_m(camera)))))


def camera_axes() -> Any:
    """Mitsuba's camera looks along z with x left and y up: half a turn about z gives x right, y down."""
    import mitsuba as mi

    return mi.ScalarTransform4f().rotate([0, 0, 1], 180)


def geometry(mitsuba_scene: Any, camera: Camera) -> Geometry:
    """Trace one ray through the centre of every pixel, from the lens centre."""
    import mitsuba as mi

    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": field_of_view_deg(camera),
            "fov_axis": "x",
            "near_clip": 1e-4,
            "far_clip": 1e5,
            "to_world": camera_axes(),
            "film": {
                "type": "hdrfilm",
                "width": camera.sensor.width_px,
                "height": camera.sensor.height_px,
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
            # One sample without jitter is the pixel's centre.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        }
    )
    integrator = mi.load_dict({"type": "aov", "aovs": "pos:position,nn:geo_normal,id:shape_index,t:depth"})
    values = np.array(mi.render(mitsuba_scene, sensor=sensor, integrator=integrator, spp=1), dtype=np.float64)
    position, normal = values[..., 0:3], values[..., 3:6]
    hit = values[..., 7] > 0
    towards = np.where(np.sum(normal * position, axis=-1, keepdims=True) > 0, -normal, normal)
    return Geometry(
        depth_m=np.where(hit, position[..., 2], np.nan),
        normal=np.where(hit[..., None], towards, 0.0),
        object_id=_object_ids(mitsuba_scene, np.where(hit, values[..., 6], 0).astype(np.uint32)),
    )


def _object_ids(mitsuba_scene: Any, shape_index: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Numbers of the scene's objects, from 1, for Mitsuba's shape numbers; 0 for lamps and nothing.

    Mitsuba counts shapes from 1 in the scalar variants, and by its registry of all that was ever made in the others.
    """
    import drjit as dr
    import mitsuba as mi

    known = np.zeros(int(shape_index.max()) + 1, np.uint32)
    for place, shape in enumerate(mitsuba_scene.shapes()):
        scalar = mi.variant().startswith("scalar")
        number = place + 1 if scalar else int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
        kind, _, index = shape.id().partition("_")
        if kind == "object" and number < len(known):
            known[number] = int(index) + 1
    return known[shape_index]


def signed_blur_px(depth_m: FloatArray, camera: Camera) -> FloatArray:
    """Signed visible blur of each pixel; what is not hit counts as infinitely far."""
    return cameras.blur_px(camera, np.where(np.isnan(depth_m), np.inf, depth_m))


def boundary(blur_px: FloatArray) -> NDArray[np.bool_]:
    """Pixels whose blur disc, or that of a surface beyond the edge, crosses a depth discontinuity.

    Each discontinuity is surrounded by a disc of the larger blur radius of its two sides.
    """
    size = np.abs(blur_px)
    reach = np.zeros_like(size)
    for axis in (0, 1):
        here, there = [slice(None)] * 2, [slice(None)] * 2
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        first, second = tuple(here), tuple(there)
        jump = np.abs(blur_px[first] - blur_px[second]) > BLUR_JUMP_PX
        larger = np.where(jump, np.maximum(size[first], size[second]) / 2 + 1.0, 0.0)
        reach[first] = np.maximum(reach[first], larger)
        reach[second] = np.maximum(reach[second], larger)
    found = np.zeros(size.shape, bool)
    steps = np.ceil(reach / _RADIUS_BINS_PX)
    for step in np.unique(steps[steps > 0]):
        found |= ndimage.distance_transform_edt(steps != step) <= step * _RADIUS_BINS_PX
    return found
