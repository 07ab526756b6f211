"""Claim on geometric optics: the diameter of the blur."""

from __future__ import annotations

import numpy as np

from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.paper import STOP_RATIOS
from validation.reports.plots import CHANNEL_COLOURS, plot
from validation.scores.figures import Figure
from validation.subjects import rendering

BLUR_OFF_PX = (-5.0, 4.0, 6.0, 10.0, 16.0, 24.0)  # visible blur, negative beyond the focal plane; the hole's is 0.46 c
LENSES_MM = (3.6, 8.0)  # sec. 6.2 and Fig. 13
SOURCE_RADIUS_PX = 1.5
BLUR_OFF_SPP, BLUR_OFF_SEEDS = 4096, 4


def blur_off(progress: ShareDone) -> Evidence:
    """Without diffraction, the blur of a small source has the diameter given by thin-lens geometry, in every channel.

    Rationale: depth is inferred from the blur diameter, which must therefore be correct for each stop, channel, lens
    and side of the focal plane.

    Set-up: a lit white disc of 1.5 px radius on the optical axis before an empty background. Focus at 40 cm, both
    lenses (3.6 and 8 mm, f/2.8), six depths: visible blur diameters of 4, 6, 10, 16 and 24 px in front of the focal
    plane and 5 px behind it. The picture is rendered through both stops with diffraction off, as the mean of 4 seeds
    of 4,096 samples per pixel.

    Expectation: the second central moment along y and along x is c^2/16 (blur disc) + r^2/4 (source) + 1/12 (pixel),
    where c = A s (1/d - 1/d_f) / p follows from the lens's data sheet and the blur of the near-infrared hole is 0.46 c.
    A channel that receives light through both stops has the mean of both moments, weighted by the share of electrons
    that each stop contributes according to the spectra.

    Limit: relative error of 2 % at the worst depth and axis, for each lens and channel.

    Source: thin-lens geometry; a uniform disc of diameter c has a second moment of c^2/16.
    """
    rendering.activate()
    figures, worst_noise = [], 0.0
    ratios = {}
    for number, focal_mm in enumerate(LENSES_MM):
        camera = rendering.changed(cameras.load_camera("da-mobile"), lens={"focal_length_mm": focal_mm})
        relative = np.empty((len(BLUR_OFF_PX), 4, 2))
        for index, blur in enumerate(BLUR_OFF_PX):
            rendered, noise = _moments(camera, blur)
            expected = expected_moments(camera, blur)
            relative[index] = rendered / expected[:, None] - 1
            worst_noise = max(worst_noise, float((noise / expected[:, None]).max()))
            progress((number + (index + 1) / len(BLUR_OFF_PX)) / len(LENSES_MM))
        ratios[focal_mm] = relative
        for channel, name in enumerate(CHANNELS):
            at = np.unravel_index(np.abs(relative[:, channel]).argmax(), relative[:, channel].shape)
            what = f"{focal_mm:g} mm, {name}: largest relative error of the second moment over 6 depths and 2 axes"
            what += f" (at {BLUR_OFF_PX[at[0]]:g} px, {'yx'[at[1]]})"
            worst = float(np.abs(relative[:, channel]).max())
            figures.append(Figure(f"lens-{focal_mm:g}mm.{name}", worst, "1", what))
    text = "largest relative standard error of a moment, from the scatter over seeds"
    figures.append(Figure("noise", worst_noise, "1", text))
    return Evidence(figures, [("Error of the second moment against visible blur, mean of both axes", _plot(ratios))])


def expected_moments(camera: Camera, blur_px: float) -> FloatArray:
    """Expected second moment per axis in square pixels, [channel], for a visible blur diameter in pixels.

    It follows from the lens's data sheet and from the share of electrons that each stop contributes.
    """
    share = rendering.stop_electrons(camera, illuminants.illuminant("D65") * library.reflectance("white-paper"))
    stop_blur_px = np.array(STOP_RATIOS) * blur_px
    return (share * (stop_blur_px**2)[:, None]).sum(axis=0) / 16 + SOURCE_RADIUS_PX**2 / 4 + 1 / 12


def _moments(camera: Camera, blur_px: float) -> tuple[FloatArray, FloatArray]:
    """Rendered second moments in square pixels, [channel, axis (y, x)], and their standard errors over seeds."""
    depth = rendering.depth_m(camera, blur_px)
    size = 2 * int(np.ceil(abs(blur_px) / 2 + SOURCE_RADIUS_PX + 2))
    camera = rendering.changed(camera, sensor={"width_px": size, "height_px": size})
    radius_cm = SOURCE_RADIUS_PX * rendering.pixel_at_m(camera, depth) * 100
    disc = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": [0, 0, depth * 100]}
    scene = rendering.make_scene([disc | {"material": "white-paper"}])
    moments = []
    for seed in range(BLUR_OFF_SEEDS):
        pictures = rendering.stop_pictures(
            scene, camera, BLUR_OFF_SPP, seed, diffraction="off", max_blur_px=abs(blur_px) + 1
        )
        moments.append(second_moments(pictures.sum(axis=0)))
    return np.mean(moments, axis=0), np.std(moments, axis=0, ddof=1) / np.sqrt(BLUR_OFF_SEEDS)


def second_moments(picture: FloatArray) -> FloatArray:
    """Second central moments in square pixels of a picture [h, w, channel] along y and x, [channel, 2]."""
    result = np.empty((picture.shape[-1], 2))
    for axis in (0, 1):
        line = picture.sum(axis=1 - axis)
        line = line / line.sum(axis=0)
        place = np.arange(len(line))[:, None]
        mean = (line * place).sum(axis=0)
        result[:, axis] = (line * (place - mean) ** 2).sum(axis=0)
    return result


def _plot(ratios: dict[float, FloatArray]) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, (focal_mm, relative) in zip(np.atleast_1d(axes), ratios.items(), strict=True):
            for channel, name in enumerate(CHANNELS):
                mean = 100 * relative[:, channel].mean(axis=1)
                panel.plot(BLUR_OFF_PX, mean, "o-", label=name, color=CHANNEL_COLOURS[name])
            panel.axhspan(-2, 2, color="0.9", zorder=0)
            panel.set(title=f"{focal_mm:g} mm f/2.8", xlabel="visible blur diameter in px", ylabel="error in %")
            panel.legend(ncols=4)

    return plot(draw, columns=len(ratios), size=(4.5, 3.2))
