"""Claim on Fig. 6: the same scenes captured by the dual-aperture camera and by its Bayer twin, side by side."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera import noise as sensor
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure
from dasim.simulation.exposure import Shot
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.spectra.grid import LUMINANCE
from dasim.typing import BoolArray, FloatArray, ShareDone
from dasim.values import Developed
from recon.picture import colour
from validation.gates.claim import Evidence, Pair
from validation.reports.pictures import photo_address
from validation.scores.edges import gradients, slope
from validation.scores.figures import Figure
from validation.scores.pictures import infrared_free
from validation.subjects import rendering, scene_set
from validation.subjects.shots import photographed

CAMERAS = ("da-mobile", "bayer-mobile")
SPP = {
    "da-mobile": scene_set.SPP,
    "bayer-mobile": 64,
}  # the twin's picture is of one stop, and compared in means alone
MEAN_SIGMA_PX = 3.0  # Gaussian of the local means whose colours are compared: noise is judged apart
FOCUS_PX = 1.5  # visible blur up to which a pixel is in focus
OTHER_SENSOR = 1000  # its seed, also on the capture's
DARKEST = 0.02  # of the display's white: below it, neither eye nor display shows a colour


def two_cameras(progress: ShareDone, seed: int = 0) -> Evidence:
    """On real scenes, the dual-aperture camera has the same colours as its Bayer twin, and similar noise and detail.

    Rationale: Fig. 6 and sec. 4.5: replacing a green pixel by infrared, and removing infrared from red, green and blue,
    must not degrade the picture. Claim ``colour`` covers the ColorChecker; this one covers the scenes.

    Set-up: desk (D55), flowers (shade) and adam (energy-saving lamp), 512 x 384 px, captured by da-mobile (as in claim
    ``depth``) and by bayer-mobile with the same lens, focus, exposure time and pixels, both with sensor noise. Each is
    developed twice: with the camera's own estimate of the white balance, as in Fig. 6 (pictures; reported), and for the
    scene's light (limits), so that only the sensors differ. CIEDE2000 is that of local means (Gaussian of 3 px, linear
    light) at equal luminance of at least 0.02: between both pictures everywhere, because the visible blur is the same,
    and of each against the twin's noise-free pinhole picture under the scene's light, where the visible blur is below
    1.5 px, away from boundaries. Noise is the rms difference in linear sRGB from the picture that another sensor of the
    same type takes of the same light, over sqrt(2) and the mean luminance: sensor noise after noise reduction, without
    rendering noise. Detail is the slope of green's gradients on those of the sharp truth, as in claim
    ``scene-pictures``, in focus.

    Expectation: colour differences as between two cameras of the same make; 1 is just visible side by side. The removal
    of infrared adds its noise, but green interpolated from a quarter of the pixels instead of half has less noise and
    slightly less detail. White balance differs: by infrared, da-mobile distinguishes the energy-saving lamp from a
    bulb, whereas the twin, without infrared, chooses the bulb.

    Limit: a mean difference between the pictures of at most 1.5, and for da-mobile at most 0.6 more than for its twin
    from the truth; at most 1.2 times the twin's noise and at least 0.8 of its detail.

    Source: sec. 4.5, Fig. 6; Sharma et al. 2005 (CIEDE2000).
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    pairs: list[Pair] = []
    for number, name in enumerate(scene_set.SCENES):
        shots = photographs(name, seed)
        automatic = {camera: recon.develop(shot.capture) for camera, shot in shots.items()}
        balanced = {camera: recon.develop(shot.capture, lights=[_light(shot)]) for camera, shot in shots.items()}
        figures += [*colours(name, shots, balanced), *noises(name, shots, balanced)]
        figures += colours(name, shots, automatic, ".auto")
        labels = {camera: f"{camera}, balanced for {one.light}" for camera, one in automatic.items()}
        first, second = ((labels[camera], photo_address(automatic[camera].rgb)) for camera in CAMERAS)
        pairs.append((f"{name} through both cameras (Fig. 6)", first, second))
        progress((number + 1) / len(scene_set.SCENES))
    return Evidence(figures, pairs=pairs)


def photographs(name: str, seed: int) -> dict[str, Shot]:
    """Captures of a scene by both cameras, the second with the exposure time of the first."""
    scene = dasim.load_scene(name)
    shots: dict[str, Shot] = {}
    for camera_name in CAMERAS:
        camera = dasim.focused(dasim.cropped(dasim.load_camera(camera_name), *scene_set.SIZE_PX), scene)
        exposure = Exposure(time_s=shots[CAMERAS[0]].capture.exposure_s) if shots else None
        shots[camera_name] = photographed(scene, camera, seed, spp=SPP[camera_name], exposure=exposure)
    return shots


def _light(shot: Shot) -> str:
    """The scene's main light."""
    assert shot.capture.illuminant is not None, "the bundled scenes have one"
    return shot.capture.illuminant


def colours(name: str, shots: dict[str, Shot], developed: dict[str, Developed], suffix: str = "") -> list[Figure]:
    """Colour differences of one scene, from captures and developed pictures by camera; ``suffix`` is appended to the
    ids.
    """
    ours, twins = CAMERAS
    truth = shots[twins].truth
    camera, light = shots[twins].capture.camera, _light(shots[twins])
    exact = infrared_free(truth.sharp_e, camera, light) @ colour.colour_matrix(camera, light).T
    linear = {camera: one.linear_e @ one.matrix.T for camera, one in developed.items()}
    focus = truth.valid & ~truth.boundary & (np.abs(truth.blur_px) <= FOCUS_PX)
    between = differences(linear[ours], linear[twins], truth.valid)
    to_truth = {camera: float(differences(linear[camera], exact, focus).mean()) for camera in CAMERAS}
    balanced = " and ".join(dict.fromkeys(one.light for one in developed.values()))
    name_, case = f"{name}, balanced for {balanced}", "CIEDE2000 of local means"
    more = to_truth[ours] - to_truth[twins]
    return [
        Figure(f"{name}.between{suffix}", float(between.mean()), "dE00", f"{name_}: {case} between both, mean"),
        Figure(f"{name}.between-90{suffix}", float(np.percentile(between, 90)), "dE00", f"{name_}: the same, 90 %"),
        *(
            Figure(f"{name}.{camera}{suffix}", value, "dE00", f"{name_}: {case}, {camera} against the truth, mean")
            for camera, value in to_truth.items()
        ),
        Figure(f"{name}.more{suffix}", more, "dE00", f"{name_}: what da-mobile is farther from the truth"),
    ]


def noises(name: str, shots: dict[str, Shot], developed: dict[str, Developed]) -> list[Figure]:
    """Noise and detail of one scene's pictures, of the first camera relative to the second."""
    noisy = {camera: noise(shots[camera], developed[camera]) for camera in CAMERAS}
    fine = {camera: detail(shots[camera], developed[camera]) for camera in CAMERAS}
    figures = []
    for what, values, text in (
        ("noise", noisy, "noise over mean luminance"),
        ("detail", fine, "slope of edges in focus over the sharp truth's"),
    ):
        figures += [Figure(f"{name}.{c}.{what}", value, "1", f"{name}, {c}: {text}") for c, value in values.items()]
        ratio = values[CAMERAS[0]] / values[CAMERAS[1]]
        figures.append(Figure(f"{name}.{what}-ratio", ratio, "1", f"{name}: {text}, da-mobile's over bayer-mobile's"))
    return figures


def differences(image: NDArray, other: NDArray, where: BoolArray) -> FloatArray:
    """CIEDE2000 between local means of two linear sRGB pictures [h, w, 3] at one luminance, [n] pixels."""
    import colour as science

    means = [cv2.GaussianBlur(i.astype(np.float32), (0, 0), MEAN_SIGMA_PX).astype(np.float64) for i in (other, image)]
    light = [i @ np.array(LUMINANCE) for i in means]
    scale = exposure_scale(means[0].astype(np.float32), np.eye(3))
    fitted_scale = scale * float((light[0] * light[1])[where].sum() / (light[1] ** 2)[where].sum())
    bright = where & (scale * light[0] >= DARKEST)
    white = science.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    lab = [
        science.XYZ_to_Lab(science.sRGB_to_XYZ(to_srgb(i[bright].astype(np.float32), np.eye(3), s)), white)
        for i, s in zip(means, (scale, fitted_scale), strict=True)
    ]
    return np.asarray(science.delta_E(*lab, method="CIE 2000"))


def noise(shot: Shot, developed: Developed) -> float:
    """Rms difference between linear sRGB pictures of two sensors of one type, over sqrt(2) and the mean luminance."""
    capture = shot.capture
    body = capture.camera.sensor
    light = electronic_crosstalk(sensor.mosaic(shot.truth.mean_e.astype(np.float64), capture.camera), capture.camera)
    other = body.model_copy(update={"sensor_seed": OTHER_SENSOR})
    raw_dn, _ = sensor.expose(light, other, capture.exposure_s, capture.seed + OTHER_SENSOR)
    again = recon.develop(replace(capture, raw_dn=raw_dn), lights=[developed.light])
    first, second = (one.linear_e @ developed.matrix.T for one in (developed, again))
    return float(np.sqrt(np.mean((first - second) ** 2) / 2) / np.mean(first @ np.array(LUMINANCE)))


def detail(shot: Shot, developed: Developed) -> float:
    """Slope of green's gradients on those of the sharp truth, where these are steepest and in focus."""
    truth = shot.truth
    exact = infrared_free(truth.sharp_e, developed.camera, developed.light)
    where = truth.valid & ~truth.boundary & (np.abs(truth.blur_px) <= FOCUS_PX)
    return slope(gradients(developed.linear_e[..., 1]), gradients(exact[..., 1]), where)
