"""Claim on colour over the field: coatings off the axis, and a grey card that stays grey to the corners."""

from __future__ import annotations

from typing import Any

import numpy as np

import dasim
import recon
from dasim.camera import response_curves
from dasim.camera.specification import Camera, crosstalk
from dasim.materials import library
from dasim.simulation.exposure import Shot
from dasim.spectra import grid, illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from recon.picture import colour, infrared
from validation.gates.claim import Evidence
from validation.reports.pictures import photo_address
from validation.scores.figures import Figure
from validation.subjects import rendering

SENSOR: dict[str, Any] = {}  # the full frame of da-mobile as it is
BLOCK_PX = 128  # about 4,000 pixels of each channel: noise of 0.1 to 0.2 units
SPP = 4  # an even wall in even light has no noise
LIGHTS = ("D65", "A")
FLAT_SEED = 1
WALL = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "grey-card"}
CARD = 0.18  # luminance at which colours are compared, that of a grey card
SIDE_DEG, CORNER_DEG = 25.6, 31.0
COATING_INDEX, GLASS_NM, CUTOFF_NM, EDGE_NM, HOLE = 1.8, 650.0, 810.0, 8.0, 0.46
FINE_NM = np.arange(400.0, 830.01, 0.05)


def field_colour(progress: ShareDone, seed: int = 0) -> Evidence:
    """A grey card that fills the full frame is as grey in the corners as in the middle.

    Rationale: the coatings of disc and cut-off shift to shorter wavelengths with the angle of the light. Red loses a
    fifth of its light at the side of the frame, and the coefficients of eq. (8) change; if the reconstruction had the
    responses of the axis everywhere, the picture would turn cyan to the corners.

    Set-up: an even grey wall fills the full frame of da-mobile (2048 x 1536 pixels, 31 degrees in the corners), in even
    light of D65 and of A, with sensor noise (dasim.simulate). The pictures are developed by recon.develop, without and
    with a flat field of the same wall under D65, and by recon.reconstruct. Blocks of 128 x 128 pixels are compared with
    the middle of the frame: at equal luminance without a flat field, because the cos^4 falloff remains; unchanged with
    a flat field. The losses of R and IR beyond cos^4 at 25.6 and 31 degrees are measured in ``mean_e`` along the
    frame's diagonal.

    Expectation: the losses of R and IR equal an integral over wavelength in steps of 0.05 nm, computed from the curves,
    edges and effective index of the data sheet alone. The coefficients of eq. (8) are ratios of areas between the
    shifted edges. Neutral colours do not change over the frame.

    Limit: 0.5 % of what is left of R and IR, and of the coefficients; CIEDE2000 of 1.0 for every block.

    Source: Macleod, Thin-Film Optical Filters, ch. 8; eqs. (7) and (8); Sharma et al. 2005 (CIEDE2000).
    """
    rendering.activate()
    camera = rendering.changed(dasim.load_camera("da-mobile"), sensor=SENSOR)
    figures, pictures = _coefficients(camera), []
    flat = None
    for number, light in enumerate(LIGHTS):
        shot = photograph(camera, light, seed)
        figures += _losses(shot, light)
        flat = flat or dasim.exposed(shot, 1.0, seed + FLAT_SEED)
        for name, developed, what in (
            ("cast", recon.develop(shot.capture), "at equal luminance"),
            ("flat", recon.develop(shot.capture, flat=flat), f"with a flat of {LIGHTS[0]}"),
        ):
            worst = float(differences(developed.linear_e @ developed.matrix.T, even=name == "flat").max())
            text = f"{light}: largest CIEDE2000 of a block from the middle, {what}, balanced for {developed.light}"
            figures.append(Figure(f"{light}.{name}", worst, "dE00", text))
            pictures.append((f"grey card under {light}, {what}", photo_address(developed.rgb)))
        progress((number + 0.8) / len(LIGHTS))
        figures.append(_reconstructed(shot, light))
    progress(1.0)
    return Evidence(figures, pictures=pictures)


def photograph(camera: Camera, light: str, seed: int) -> Shot:
    """The wall in even light of one illuminant."""
    scene = rendering.make_scene([WALL], [item | {"illuminant": light} for item in rendering.EVEN_LIGHT])
    return dasim.simulate(scene, camera, seed, spp=SPP)


def differences(linear: FloatArray, *, even: bool) -> FloatArray:
    """CIEDE2000 of blocks of a linear sRGB picture [h, w, 3] from the middle, whose luminance is that of a grey card.

    Without ``even``, every block is brought to that luminance.
    """
    import colour as science

    height, width = (n // BLOCK_PX for n in linear.shape[:2])
    cut = linear[: height * BLOCK_PX, : width * BLOCK_PX]
    blocks = cut.reshape(height, BLOCK_PX, width, BLOCK_PX, 3).mean(axis=(1, 3))
    y, x = (n // 2 for n in linear.shape[:2])
    half = BLOCK_PX // 2
    middle = linear[y - half : y + half, x - half : x + half].mean(axis=(0, 1))
    luminance = np.array(grid.LUMINANCE)
    scale = CARD / (middle @ luminance if even else (blocks @ luminance)[..., None])
    white = science.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    to_xyz = science.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    colours = (scale * blocks, CARD / (middle @ luminance) * middle)
    lab = [science.XYZ_to_Lab(np.maximum(rgb, 0) @ to_xyz.T, white) for rgb in colours]
    return np.asarray(science.delta_E(lab[0], np.broadcast_to(lab[1], lab[0].shape), method="CIE 2000"))


def _reconstructed(shot: Shot, light: str) -> Figure:
    """The largest difference in the picture of the whole reconstruction."""
    bank = recon.calibrate(dasim.calibration_captures(shot.capture.camera))
    result = recon.reconstruct(shot.capture, bank)
    separation = infrared.separation(shot.capture.camera, result.light, recon.DEFAULT)
    matrix = colour.colour_matrix(shot.capture.camera, result.light, separation)
    worst = float(differences(result.linear_e @ matrix.T, even=False).max())
    text = f"{light}: largest CIEDE2000 of a block from the middle, recon.reconstruct, at equal luminance"
    return Figure(f"{light}.reconstruct", worst, "dE00", text)


def _losses(shot: Shot, light: str) -> list[Figure]:
    """Relative errors of what R and IR have left of the axis' signal along the diagonal."""
    tangent, along, middle = _diagonal(shot)
    power = np.interp(FINE_NM, grid.WAVELENGTH_NM, illuminants.illuminant(light) * library.reflectance("grey-card"))
    axis = _signal(power * FINE_NM, 0.0)
    figures = []
    for place, angle_deg in (("side", SIDE_DEG), ("corner", CORNER_DEG)):
        near = np.abs(np.degrees(np.arctan(tangent)) - min(angle_deg, np.degrees(np.arctan(tangent.max())))) < 0.5
        cosine4 = (1 + tangent[near] ** 2) ** -2.0
        expected = np.mean([_signal(power * FINE_NM, a) for a in np.degrees(np.arctan(tangent[near]))], axis=0) / axis
        left = (along[near] / cosine4[:, None]).mean(axis=0) / middle
        for channel in ("R", "IR"):
            index = CHANNELS.index(channel)
            text = f"{light}, {angle_deg:g} degrees: {channel} has {left[index]:.3f} left, relative error"
            figures.append(Figure(f"{light}.{place}.{channel}", float(left[index] / expected[index] - 1), "1", text))
    return figures


def _diagonal(shot: Shot) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tangents of the field angle along the diagonal [n], ``mean_e`` there [n, channel] and in the middle [channel]."""
    camera, mean_e = shot.capture.camera, shot.truth.mean_e.astype(np.float64)
    height, width = mean_e.shape[:2]
    x = np.arange(width)
    y = np.minimum((x + 0.5) * height / width, height - 1).astype(int)
    lens = camera.lens
    image_mm = 1 / (1 / lens.focal_length_mm - 1 / (1e3 * lens.focus_distance_m))
    radius_mm = np.hypot(x + 0.5 - width / 2, y + 0.5 - height / 2) * camera.sensor.pixel_pitch_um * 1e-3
    return radius_mm / image_mm, mean_e[y, x], mean_e[height // 2 - 1 : height // 2 + 1, width // 2].mean(axis=0)


def _signal(power: FloatArray, angle_deg: float) -> FloatArray:
    """Relative electrons of R, G, B and IR for photons of a spectrum on ``FINE_NM`` at an angle of the field."""
    return np.trapezoid(_curves() * _passed(angle_deg) * power, FINE_NM, axis=-1)


def _passed(angle_deg: float) -> FloatArray:
    """Transmittance of both stops, weighted by their areas, and of the cut-off."""
    glass, cutoff = (_beyond(edge_nm * _moved(angle_deg)) for edge_nm in (GLASS_NM, CUTOFF_NM))
    return (1 - glass + HOLE**2 * glass) * (1 - cutoff)


def _moved(angle_deg: float) -> float:
    """Factor on the wavelengths of the edges at an angle of the field."""
    return float(np.sqrt(1 - (np.sin(np.radians(angle_deg)) / COATING_INDEX) ** 2))


def _beyond(edge_nm: float) -> FloatArray:
    """A logistic edge from 0 to 1 on ``FINE_NM``, 10-90 % within ``EDGE_NM``."""
    return np.asarray((1 + np.tanh(np.log(9) * (FINE_NM - edge_nm) / EDGE_NM)) / 2)


def _curves() -> FloatArray:
    table = response_curves.rgb_ir_quantum_efficiency()
    return np.stack([np.interp(FINE_NM, grid.WAVELENGTH_NM, row) for row in table])


def _coefficients(camera: Camera) -> list[Figure]:
    """Relative errors of eq. (8) off the axis, against areas between the shifted edges."""
    figures = []
    for place, angle_deg in (("side", SIDE_DEG), ("corner", CORNER_DEG)):
        low_nm, high_nm = (edge_nm * _moved(angle_deg) for edge_nm in (GLASS_NM, CUTOFF_NM))
        inside = (FINE_NM >= low_nm) & (FINE_NM <= high_nm)
        areas = np.trapezoid((_curves() * (1 - _beyond(high_nm)))[:, inside], FINE_NM[inside], axis=-1)
        for index, name in enumerate("RGB"):
            expected = float(areas[index] / areas[3])
            error = float(crosstalk(camera, angle_deg)[index] / expected - 1)
            text = f"alpha_{name} at {angle_deg:g} degrees: relative error of {expected:.3f}"
            figures.append(Figure(f"alpha.{place}.{name}", error, "1", text))
    return figures
