"""Claim on the colours of the developed picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.base.toml import parse
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.spectra import colour_checker, grid, illuminants
from dasim.spectra.colour import to_srgb
from dasim.typing import FloatArray, ShareDone
from dasim.values import Developed
from validation.gates.claim import Evidence
from validation.reports.pictures import photo_address
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.shots import photographed

CHECKER_SIZE_PX = (512, 384)
CHECKER_SPP = 16  # a patch has about 1,400 pixels: their mean is known far better than any colour difference
TWIN = "bayer-mobile"  # the same camera without infrared
CHECKER_CAMERAS = ("da-mobile", TWIN, "da-4x4")
CHECKER_LIGHTS = ("D65", "D55", "A", "energy-saving-3500K", "incandescent-2800K")
RIM_PX = 9  # of a patch, left out: blur and demosaicing mix neighbours there
NEUTRALS = tuple(f"checker-{name}" for name in ("white", "neutral-8", "neutral-6.5", "neutral-5", "neutral-3.5"))


def colour(progress: ShareDone, seed: int = 0) -> Evidence:
    """The picture of the ColorChecker has the right colours.

    Rationale: near-infrared in red, green and blue, and an estimated white point, must not show as a colour cast.

    Set-up: the scene colour-checker at 512 x 384 pixels with sensor noise, under D65, D55, A, an energy-saving lamp of
    3,500 K and light of 2,800 K; the complete picture pipeline on the raw mosaic, with its own estimate of the white
    balance. The mean of each patch without its rim is converted to sRGB, with the exposure at which the greys have
    their true luminance (a camera's exposure is not a colour error). The true colours follow from the patches' spectra
    under the light, CIE 1931 2 degrees, adapted to D65 (Bradford). The figures of the Bayer twin are measured in the
    same way; those of the 4x4 mosaic, and of da-mobile with the full 4x4 crosstalk matrix and without any removal of
    infrared, are reported without limit.

    Expectation: a sensor whose responses are not linear combinations of those of the eye has an error of 1 to 3 units.

    Limit: mean CIEDE2000 over the 24 patches below 3.0 under D65 and D55, below 4.5 under A and at 2,800 K, and below
    1.8 under the energy-saving lamp, both for da-mobile and for the Bayer twin; da-mobile exceeds the twin by at most
    1.0.

    Source: sec. 4.4 and 4.5; Sharma et al. 2005 (CIEDE2000).
    """
    rendering.activate()
    figures, rows, pairs = [], [], []
    pictures: dict[str, str] = {}
    steps = [(camera, light) for light in CHECKER_LIGHTS for camera in CHECKER_CAMERAS]
    for number, (camera, light) in enumerate(steps):
        shot = checker(camera, light, seed)
        name = light if camera == "da-mobile" else f"{camera}.{light}"
        variants = {name: recon.develop(shot.capture)}
        if camera == "da-mobile":
            matrix = recon.PAPER.model_copy(update={"infrared_removal": "matrix"})
            none = recon.PAPER.model_copy(update={"crosstalk": (0.0, 0.0, 0.0)})
            variants |= {f"matrix.{light}": recon.develop(shot.capture, matrix)}
            variants |= {f"kept.{light}": recon.develop(shot.capture, none)}
        for key, developed in variants.items():
            difference = differences(developed, shot, light)
            what = f"mean CIEDE2000 of 24 patches, {camera} under {light}, balanced for {developed.light}"
            figures.append(Figure(key, float(difference.mean()), "dE00", f"{what}; largest {difference.max():.1f}"))
            rows.append([key, *(f"{value:.1f}" for value in difference)])
        pictures[camera] = photo_address(variants[name].rgb)
        if camera == TWIN:
            panels = ("da-mobile", pictures["da-mobile"]), (camera, pictures[camera])
            pairs.append((f"The ColorChecker under {light} (compare Fig. 6)", *panels))
            value = {figure.id: figure.value for figure in figures}
            case = f"what da-mobile's mean CIEDE2000 is above {TWIN}'s under {light}"
            figures.append(Figure(f"more.{light}", value[light] - value[name], "dE00", case))
        progress((number + 1) / len(steps))
    head = ["", *(name.removeprefix("checker-") for name in colour_checker.PATCHES)]
    return Evidence(figures, tables=[("CIEDE2000 of each patch", head, rows)], pairs=pairs)


def checker(camera_name: str, light: str, seed: int = 0) -> Shot:
    """A capture of the ColorChecker under a light."""
    template = dasim.load_scene("colour-checker")
    assert isinstance(template, Scene)
    data = template.model_dump()
    data["lights"] = [lamp | {"illuminant": light} for lamp in data["lights"]]
    scene = parse(Scene, data, "scene colour-checker")
    camera = dasim.focused(dasim.cropped(dasim.load_camera(camera_name), *CHECKER_SIZE_PX), scene)
    return photographed(scene, camera, seed, spp=CHECKER_SPP)


def differences(developed: Developed, shot: Shot, light: str) -> FloatArray:
    """CIEDE2000 of each patch, [24], between a developed picture and the true colours."""
    import colour as science

    true = true_xyz(light)
    linear = np.stack([developed.linear_e[mask].mean(axis=0) for mask in patches(shot)])
    grey = [colour_checker.PATCHES.index(name) for name in NEUTRALS]
    measured, exact = (linear @ developed.matrix.T @ grid.LUMINANCE)[grey], true[grey, 1]
    scale = float(measured @ exact / (measured @ measured))
    srgb = to_srgb(linear.astype(np.float32), developed.matrix, scale)
    white = science.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    lab = [science.XYZ_to_Lab(xyz, white) for xyz in (science.sRGB_to_XYZ(srgb), true)]
    return np.asarray(science.delta_E(*lab, method="CIE 2000"))


def patches(shot: Shot) -> list[NDArray[np.bool_]]:
    """Mask [h, w] of each patch without its rim, in the order of ``colour_checker.PATCHES``."""
    rim = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
    masks = []
    for name in colour_checker.PATCHES:
        number = shot.truth.objects.index(name.removeprefix("checker-")) + 1
        mask = (shot.truth.object_id == number).astype(np.uint8)
        masks.append(cv2.erode(mask, rim, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0)
    return masks


def true_xyz(light: str) -> FloatArray:
    """CIE 1931 colours of the patches under a light, adapted to D65, [24, 3]; a perfect diffuser has Y = 1."""
    import colour as science

    observer = science.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = np.stack([np.interp(grid.WAVELENGTH_NM, observer.wavelengths, c, right=0.0) for c in observer.values.T])
    weighted = curves * illuminants.illuminant(light)
    reflectance = np.stack([colour_checker.curve(name) for name in colour_checker.PATCHES])
    white = grid.integrate(weighted)
    xyz = grid.integrate(reflectance[:, None, :] * weighted) / white[1]
    d65 = science.xy_to_XYZ(science.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    adapted = science.adaptation.chromatic_adaptation_VonKries(xyz, white / white[1], d65, transform="Bradford")
    return np.asarray(adapted)
