"""Claim on the bundled cameras: light at depth steps, along silhouettes, under mixed lights and in the corner."""

from __future__ import annotations

import numpy as np

import dasim
from dasim.camera import geometry, radiometry
from dasim.camera import sensor as sensors
from dasim.spectra import illuminants
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import mixed_room, planes, rendering

CAMERAS = ("da-mobile", "da-4x4", "da-8mm", "bayer-mobile", "chakrabarti-zickler", "bando")
STEP_PX, SILHOUETTE_PX = 10.0, 17.0
FURNACE_SIZE_PX, SILHOUETTE_SIZE_PX = (96, 24), (96, 48)
PLATEAU_PX = 12  # columns at each side of the frame; the blur ends before them
SPP, SEEDS = 64, 4
AROUND_PX = 1  # pixels on each side of the middle one
SIGNALS = ("R", "IR")


def bundled_cameras(progress: ShareDone) -> Evidence:
    """No bundled camera creates or loses light at depth steps, along silhouettes or under mixed lights.

    Rationale: cameras differ in the shapes, spectra and number of their stops. A result for ``da-mobile`` need not be
    true of a bare lens, of a filter in four quarters or of a colour-filtered aperture.

    Set-up: ``da-mobile``, ``da-4x4``, ``da-8mm``, ``bayer-mobile``, ``chakrabarti-zickler`` and ``bando``; mean_e of
    dasim.simulate with diffraction 'wave', mean of 4 seeds of 64 samples per pixel, all channels. Depth step: two black
    planes of equal radiance, the near one at 10 px of visible blur, the other at -1 px. Silhouettes: black before white
    and white before black, at 17 px. Mixed lights: the room of the claim ``mixed-lights`` under a D65 dome and an F11
    lamp, diffraction off, against traced light. Corner: kernels of a point in focus under D65, and the signal of a
    white surface, where the corner of the sensor's full frame is.

    Expectation: at the depth step between equal radiances (a furnace test), all columns are equal. Both silhouettes add
    up to an even picture, since the near object covers in one what it leaves free in the other. The means under mixed
    lights are equal. Figures are those of the worst column and channel. The light lost in the corner is reported
    without a limit.

    Limit: those of ``depth-step-furnace``, ``silhouette`` and ``mixed-lights``: 0.3 %, 1.5 % and 0.2 %.

    Source: conservation of radiance along rays; path tracing.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    for number, name in enumerate(CAMERAS):
        figures += [
            Figure(f"{name}.depth-step", _depth_step(name), "1", f"{name}: worst column of a furnace of two depths"),
            Figure(f"{name}.silhouettes", _silhouettes(name), "1", f"{name}: worst column of both silhouettes' sum"),
            Figure(f"{name}.mixed", _mixed(name), "1", f"{name}: mean under a dome and a lamp, over traced light's"),
            *_corner(name),
        ]
        progress((number + 1) / len(CAMERAS))
    return Evidence(figures)


def _depth_step(name: str) -> float:
    camera = planes.view_of(name, FURNACE_SIZE_PX)
    near, far = planes.plane("near", camera, STEP_PX, to_px=0.0), planes.plane("far", camera, planes.FAR_BLUR_PX)
    scene = planes.lit([near, far])
    return _unevenness(np.mean([planes.rendered(scene, camera, SPP, seed, "wave") for seed in range(SEEDS)], axis=0))


def _silhouettes(name: str) -> float:
    camera = planes.view_of(name, SILHOUETTE_SIZE_PX)
    sums = []
    for near, far in ((planes.DARK, planes.BRIGHT), (planes.BRIGHT, planes.DARK)):
        scene = planes.silhouette_scene(camera, SILHOUETTE_PX, near, far)
        sums.append(np.mean([planes.rendered(scene, camera, SPP, seed, "wave") for seed in range(SEEDS)], axis=0))
    return _unevenness(np.sum(sums, axis=0))


def _unevenness(picture: FloatArray) -> float:
    """Largest relative difference of a column [h, w, channel] from the columns at the sides of the frame."""
    column = picture.mean(axis=0)
    sides = np.concatenate([column[:PLATEAU_PX], column[-PLATEAU_PX:]]).mean(axis=0)
    return float(np.abs(column / sides - 1).max())


def _mixed(name: str) -> float:
    scene = rendering.make_scene(mixed_room.OBJECTS, mixed_room.LIGHTS["D65-F11"])
    captures, traced = (np.mean(each, axis=(0, 1, 2)) for each in mixed_room.pictures(scene, mixed_room.camera(name)))
    return max((captures / traced - 1).tolist(), key=abs)


def _corner(name: str) -> list[Figure]:
    """Light of a point in focus near its image, on the axis and in the corner, and the signal that is left there."""
    camera = dasim.load_camera(name)
    field_px = camera.sensor.width_px / 2, camera.sensor.height_px / 2
    angle_deg = geometry.field_angle_deg(camera, field_px)
    light = illuminants.illuminant("D65")
    left = (radiometry.response(camera, angle_deg) @ light) / (radiometry.response(camera) @ light)
    figures = [Figure(f"{name}.corner.angle", angle_deg, "deg", f"{name}: angle of the full frame's corner")]
    names = sensors.channels(camera.sensor)
    for channel in ("G", "IR"):
        if channel not in names:
            continue
        for place, at in (("axis", (0.0, 0.0)), ("corner", field_px)):
            kernel = dasim.psf(camera, camera.lens.focus_distance_m, channel, "D65", field_px=at)
            middle = kernel.shape[0] // 2
            near = slice(middle - AROUND_PX, middle + AROUND_PX + 1)
            what = f"{name}: {channel} light of a point in focus within 3 x 3 pixels, {place}"
            figures.append(Figure(f"{name}.{place}.{channel}", float(kernel[near, near].sum()), "1", what))
    for channel in SIGNALS:
        if channel in names:
            value = float(left[names.index(channel)] - 1)
            what = f"{name}: change of the {channel} signal under D65 by the coatings in the corner"
            figures.append(Figure(f"{name}.shift.{channel}", value, "1", what))
    return figures
