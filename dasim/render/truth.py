"""Exact geometry at the pixel centres: depth, normals and object numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import distortion
from dasim.camera import geometry as camera_geometry
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.render.plugin import aligned
from dasim.typing import Float32Array, FloatArray

# Of the rays that look for the largest blur: their number per pixel, the width of the surroundings of the frame that
# they see, about half of the largest blur with wave optics, and how many are traced at a time.
RAYS, AROUND_PX, BATCH = 4, 76, 2**21


class Geometry(NamedTuple):
    """First intersection of the pinhole ray through the centre of each pixel."""

    depth_m: FloatArray  # [h, w] z from the lens plane, NaN where the ray hits nothing
    normal: Float32Array  # [h, w, 3] unit vectors, turned towards the camera; 0 where the ray hits nothing
    object_id: NDArray[np.uint32]  # [h, w] 1 for the scene's first object; 0 for lights and where the ray hits nothing


def field_of_view_deg(camera: Camera, width_px: int | None = None) -> float:
    """Horizontal field of view in degrees at the camera's focus, 2 atan(w / (2 s)) with the image distance s.

    It is that of a film centred on the axis, by default as wide as the frame.
    """
    width_m = (width_px or camera.sensor.width_px) * camera.sensor.pixel_pitch_um * 1e-6
    return float(np.degrees(2 * np.arctan(width_m / (2 * camera_geometry.image_distance_m(camera)))))


def camera_axes() -> Any:
    """Transform of Mitsuba's camera axes (x left, y up, z forward) to ours (x right, y down): half a turn about z."""
    import mitsuba as mi

    return mi.ScalarTransform4f().rotate([0, 0, 1], 180)


def geometry(mitsuba_scene: Any, camera: Camera) -> Geometry:
    """Geometry at the pixel centres, by one ray per pixel from the centre of the lens."""
    import mitsuba as mi

    if camera.lens.distortion_per_mm:
        return _bent_geometry(mitsuba_scene, camera)
    body = camera.sensor
    x, y = principal_point(body)
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "principal_point_offset_x": 0.5 - x / body.width_px,
            "principal_point_offset_y": 0.5 - y / body.height_px,
            "fov": field_of_view_deg(camera),
            "fov_axis": "x",
            "near_clip": 1e-4,
            "far_clip": 1e5,
            "to_world": camera_axes(),
            "film": {
                "type": "hdrfilm",
                "width": body.width_px,
                "height": body.height_px,
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
            # A single stratified sample without jitter lies at the centre of the pixel.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        }
    )
    integrator = mi.load_dict({"type": "aov", "aovs": "pos:position,nn:geo_normal,id:shape_index,t:depth"})
    values = np.array(mi.render(mitsuba_scene, sensor=sensor, integrator=integrator, spp=1), dtype=np.float64)
    return _geometry(mitsuba_scene, values[..., 0:3], values[..., 3:6], values[..., 6], values[..., 7] > 0)


def largest_blur_px(mitsuba_scene: Any, camera: Camera) -> float:
    """Largest diameter of visible blur whose disc reaches the frame, from ``RAYS`` rays per pixel at random places.

    They find objects between the pixel centres, and those within ``AROUND_PX`` of the frame, which blur into it. For
    the JIT variants; distortion is left out.
    """
    import drjit as dr
    import mitsuba as mi

    body, (x_axis, y_axis) = camera.sensor, principal_point(camera.sensor)
    width, height = body.width_px + 2 * AROUND_PX, body.height_px + 2 * AROUND_PX
    at_infinity, at_metre = (float(camera_geometry.blur_px(camera, depth_m)) for depth_m in (np.inf, 1.0))
    slope_px, half = body.pixel_pitch_um * 1e-6 / camera_geometry.image_distance_m(camera), AROUND_PX
    x_shift, y_shift = (dr.opaque(mi.Float, half + value) for value in (x_axis, y_axis))
    known = [dr.opaque(mi.Float, v) for v in (slope_px, at_infinity, at_metre - at_infinity)]
    right, bottom = (dr.opaque(mi.Float, half + value) for value in (body.width_px, body.height_px))
    columns, largest, count = dr.opaque(mi.UInt32, width), 0.0, RAYS * width * height
    for first in range(0, count, BATCH):
        lane = dr.arange(mi.UInt32, min(BATCH, count - first)) + dr.opaque(mi.UInt32, first)
        pixel = lane // RAYS
        x, y = (
            mi.Float(whole) + mi.sample_tea_float32(lane, number)
            for number, whole in enumerate((pixel % columns, pixel // columns))
        )
        direction = mi.Vector3f((x - x_shift) * known[0], (y - y_shift) * known[0], 1.0)
        hit = mitsuba_scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.0), direction), coherent=True)
        blur = dr.abs(known[1] + dr.select(hit.is_valid(), known[2] / hit.t, 0.0))  # t is z: z of the direction is 1
        beside = mi.Vector2f(
            dr.maximum(dr.maximum(half - x, x - right), 0.0), dr.maximum(dr.maximum(half - y, y - bottom), 0.0)
        )
        reaches = dr.norm(beside) <= blur / 2 + 1
        largest = max(largest, float(dr.max(dr.select(reaches, blur, 0.0))[0]))
    return largest


def _bent_geometry(mitsuba_scene: Any, camera: Camera) -> Geometry:
    """The same through a lens with distortion, in the JIT variants."""
    import drjit as dr
    import mitsuba as mi

    body = camera.sensor
    y, x = np.indices((body.height_px, body.width_px)) + 0.5
    place = distortion.to_pinhole_px(camera, np.stack([x, y], axis=-1) - principal_point(body))
    slope = place.reshape(-1, 2) * (body.pixel_pitch_um * 1e-6 / camera_geometry.image_distance_m(camera))
    x_slope, y_slope = (mi.Float(aligned(part)) for part in slope.T)
    ray = mi.Ray3f(mi.Point3f(0.0), dr.normalize(mi.Vector3f(x_slope, y_slope, 1.0)))
    si = mitsuba_scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
    position, normal = (np.array(vector, dtype=np.float64).T.reshape(*x.shape, 3) for vector in (si.p, si.n))
    index, hit = np.array(dr.reinterpret_array(mi.UInt32, si.shape)), np.array(si.is_valid())
    return _geometry(mitsuba_scene, position, normal, index.reshape(x.shape), hit.reshape(x.shape))


def _geometry(
    mitsuba_scene: Any, position: FloatArray, normal: FloatArray, shape_index: NDArray[Any], hit: NDArray[np.bool_]
) -> Geometry:
    """Geometry from positions and normals [h, w, 3] and Mitsuba's shape numbers [h, w] where rays hit something."""
    towards_camera = np.where(np.sum(normal * position, axis=-1, keepdims=True) > 0, -normal, normal)
    return Geometry(
        depth_m=np.where(hit, position[..., 2], np.nan),
        normal=np.where(hit[..., None], towards_camera, 0.0).astype(np.float32),
        object_id=_object_ids(mitsuba_scene, np.where(hit, shape_index, 0).astype(np.uint32)),
    )


def _object_ids(mitsuba_scene: Any, shape_index: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Object numbers from 1 for Mitsuba's shape numbers, [h, w]; 0 for lights and where nothing is hit.

    The scalar variants number the shapes of a scene from 1; the JIT variants use the shape's number in Mitsuba's
    registry, which counts all shapes of the process.
    """
    import drjit as dr
    import mitsuba as mi

    numbers = np.zeros(int(shape_index.max()) + 1, np.uint32)  # by Mitsuba's shape number
    for place, shape in enumerate(mitsuba_scene.shapes()):
        scalar = mi.variant().startswith("scalar")
        number = place + 1 if scalar else int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
        kind, _, index = shape.id().partition("_")
        if kind == "object" and number < len(numbers):
            numbers[number] = int(index) + 1
    return numbers[shape_index]
