"""The study ``dasim study bound``: the least error of depth from one patch, by distance."""

from __future__ import annotations

import time
from collections.abc import Iterator

from dasim.bounds import cramer_rao
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from validation.studies import criteria
from validation.studies.criteria import Texture


def bound_lines(
    camera: Camera, blur_px: FloatArray, light: str, level_lux: float, texture: Texture, planes: tuple[str, ...]
) -> Iterator[str]:
    """The bound as a table of text, one line per visible blur: depth, blur, and the error in levels, 1/m and mm.

    ``light`` is an illuminant's name, ``planes`` the channels that are compared, the sharp one first.
    """
    deviation = criteria.camera_bound(camera, blur_px, light=light, level_lux=level_lux, texture=texture, planes=planes)
    depth_m = geometry.depth_of_blur_m(camera, blur_px)
    error_m = cramer_rao.depth_deviation_m(camera, depth_m, deviation)
    levels = cramer_rao.level_deviation(camera, deviation)
    yield (
        f"{camera.name}, focus {camera.lens.focus_distance_m:g} m, {light}, {level_lux:g} lux, channels "
        f"{', '.join(planes)}, texture {texture}: least standard deviation in a patch of 31 px"
    )
    yield f"{'depth':>9}  {'blur':>8}  {'levels':>8}  {'dioptres':>9}  {'depth':>10}"
    for z, blur, level, error in zip(depth_m, blur_px, levels, error_m, strict=True):
        yield f"{100 * z:6.2f} cm  {blur:5.1f} px  {level:8.3f}  {error / z**2:9.4f}  {1000 * error:7.3f} mm"


def seconds_per_design(
    camera: Camera, blur_px: FloatArray, light: str, level_lux: float, texture: Texture, planes: tuple[str, ...]
) -> float:
    """Time of one evaluation of :func:`bound_lines`, s; call it after another one, which reads the spectral tables."""
    begin = time.perf_counter()
    list(bound_lines(camera, blur_px, light, level_lux, texture, planes))
    return time.perf_counter() - begin
