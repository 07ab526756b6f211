"""The pictures of a view in mean electrons per second: through the lens, stop by stop, and through a pinhole.

Tested in tests/dasim/simulation/test_simulate.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from dasim.camera import noise, radiometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.render import passes
from dasim.render.foreign.scene import World
from dasim.render.truth import Geometry
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.adaptive_sampling import StopPictures, render_to_noise_target
from dasim.simulation.checks import check_lit
from dasim.typing import FloatArray, Progress

TWIN = "bayer-mobile"  # the camera whose colours ``sharp_srgb`` has
SHARP_SPP = 64  # of the pinhole picture, which has no lens to sample
BLUR_MARGIN = 1.1  # something nearer than all that is seen may lie just outside the frame


@dataclass(frozen=True)
class View:
    """A scene in front of a camera, ready to be rendered."""

    scene: Scene | MitsubaScene
    camera: Camera
    variant: str
    diffraction: str
    world: World
    geometry: Geometry
    blur_px: FloatArray  # [h, w] signed diameter of visible blur
    illuminant: str  # of the main light
    spectrum: FloatArray  # of all lights together

    @property
    def reach_px(self) -> float:
        """Largest diameter of visible blur that tables and margins must cover."""
        return float(np.abs(self.blur_px).max()) * BLUR_MARGIN

    @property
    def objects_in_view(self) -> list[str]:
        """Names of the objects that are visible at the centre of some pixel."""
        return [self.world.objects[number - 1] for number in np.unique(self.geometry.object_id) if number]


@dataclass(frozen=True)
class Sampling:
    """How the lens picture is sampled: samples per pixel and stop, or the share of the sensor's noise to reach."""

    spp: int | Literal["auto"]
    noise_share: float
    seed: int


@dataclass(frozen=True)
class LensPicture:
    """The picture through all stops together."""

    rate: FloatArray  # [h, w, channel] mean electrons per second
    field: Any  # irradiance, for further passes of the same view
    sampling: dict[str, Any]  # for provenance: samples per pixel, and the rendering noise reached


@dataclass(frozen=True)
class SharpPictures:
    """The pictures through a pinhole that admits as much light as the lens, mean electrons per second."""

    rate: FloatArray  # [h, w, channel] of the camera
    twin_rate: FloatArray  # [h, w, 3] of a Bayer camera without near-infrared
    twin: Camera


def lens_picture(view: View, sampling: Sampling, exposure: Exposure, progress: Progress) -> LensPicture:
    """Render through every stop; raises InputError if no light reaches the sensor."""
    if sampling.spp == "auto":
        picture = _adaptive_picture(view, sampling, exposure, progress)
    else:
        spp = passes.sample_count(sampling.spp)
        pictures = stop_pictures(view, (spp,) * len(view.camera.stops), sampling.seed, progress)
        picture = LensPicture(pictures.rate.sum(axis=0), pictures.field, {"spp": spp})
    check_lit(view.scene, picture.rate, view.objects_in_view)
    return picture


def stop_pictures(view: View, spp: tuple[int, ...], seed: int, progress: Progress, label: str = "") -> StopPictures:
    """One picture through each stop with ``spp[stop]`` samples per pixel, and the irradiance that they share."""
    field = passes.irradiance_field(view.world.scene, view.camera, view.spectrum, view.reach_px, max(spp), seed)
    pictures = [
        passes.stop_pass(
            view.world.scene,
            view.camera,
            stop,
            passes.Sampling(count, seed, partial(progress, f"rendering through stop '{stop.name}'{label}")),
            diffraction=view.diffraction,
            max_blur_px=view.reach_px,
            illuminant=view.illuminant,
            field=field,
        )
        for stop, count in zip(view.camera.stops, spp, strict=True)
    ]
    return StopPictures(np.stack(pictures), field)


def _adaptive_picture(view: View, sampling: Sampling, exposure: Exposure, progress: Progress) -> LensPicture:
    """The lens picture with rendering noise below a share of the sensor's temporal noise by its data sheet."""
    camera = view.camera

    def picture(index: int, spp: tuple[int, ...]) -> StopPictures:
        seed = int(np.random.SeedSequence((sampling.seed, index)).generate_state(1)[0])
        spp = tuple(passes.sample_count(count) for count in spp)
        return stop_pictures(view, spp, seed, progress, f", picture {index + 1} of {max(spp)} samples")

    def sensor_noise(rate: FloatArray) -> FloatArray:
        time_s = exposure_time_s(rate, camera, exposure)
        return np.sqrt(noise.temporal_variance(camera.sensor, time_s, exposure.gain).at(rate * time_s)) / time_s

    result = render_to_noise_target(picture, sensor_noise, stops=len(camera.stops), target=sampling.noise_share)
    described = {
        "spp": dict(zip((stop.name for stop in camera.stops), result.spp, strict=True)),
        "rendering_noise_share": dict(zip(cameras.channels(camera.sensor), result.share, strict=True)),
        "rendering_noise_share_wanted": sampling.noise_share,
    }
    return LensPicture(result.rate, result.field, described)


def sharp_pictures(view: View, field: Any, seed: int, progress: Progress) -> SharpPictures:
    """Render through a pinhole, for the camera and its Bayer twin in one pass."""
    twin = cameras.load_camera(TWIN)
    camera_response = radiometry.response(view.camera)
    sampling = passes.Sampling(SHARP_SPP, seed, partial(progress, "rendering the pinhole picture"))
    response = np.concatenate([camera_response, radiometry.response(twin)])
    both = passes.pinhole_pass(view.world.scene, view.camera, sampling, field, response)
    rate, twin_rate = np.split(both, [len(camera_response)], axis=-1)
    return SharpPictures(rate, twin_rate, twin)


def exposure_time_s(rate: FloatArray, camera: Camera, exposure: Exposure) -> float:
    """The given exposure time, or the automatic one for mean electrons per second [h, w, channel]."""
    return exposure.time_s or noise.auto_exposure_s(rate, camera, exposure)
