"""Claim on what real lenses do: wavefront errors, the phase step of the hole, and veiling glare."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

import dasim
from dasim.camera.specification import Camera
from dasim.materials import reflectances
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import ShareDone
from validation.gates.claim import Evidence
from validation.references.paper import HOLE_RATIO
from validation.scores.figures import Figure
from validation.subjects import rendering

# A small source in the middle of few fine pixels: the four in the middle see the peak of the diffraction pattern.
PITCH_UM = 0.5
SENSOR = {"width_px": 8, "height_px": 8, "pixel_pitch_um": PITCH_UM, "cutoff_width_nm": 1.0, "principal_point_px": None}
SOURCE_PX = 1.0  # radius; the visible pattern is 7 px across, the infrared one 22
PEAK_PX = slice(3, 5)
SPP = 32768
GREEN_NM, INFRARED_NM = 530.0, 730.0  # middles of bands of 20 nm

Polynomial = Callable[[Any, Any], Any]  # of (rho, theta) in the open lens
# Zernike terms in nm RMS with their polynomials (ISO 24157), which are written out here.
TERMS: dict[str, tuple[float, Polynomial]] = {
    "coma": (40.0, lambda rho, theta: np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(theta)),
    "spherical": (40.0, lambda rho, theta: np.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1)),
}
HOLE_DEFOCUS_NM = 150.0
STEP_TURNS = {"half-wave": 0.5, "quarter-wave": 0.25}

GLARE_PX = 384
GLARE_SQUARE_PX = 24
GLARE_SHARE, GLARE_RADIUS_PX = 0.1, 30.0
GLARE_AT_PX = 40  # of what is measured, from the middle of the square
GLARE_SPP = 16


def lens_errors(progress: ShareDone) -> Evidence:
    """Zernike errors, a phase step of the hole and veiling glare change captures as integrals say.

    Rationale: these keys of a camera file are 0 by default, so no other claim would fail if they had no effect.

    Set-up: ``mean_e`` of ``dasim.simulate``. Peaks: a white disc of 2 px in focus, 8 x 8 px of 0.5 um, a lens of 3.6 mm
    f/2.8 whose open stop passes 520 to 540 nm and whose hole passes 720 to 740 nm. The Strehl ratio is the light of the
    four pixels in the middle over that of the same camera without errors: coma and spherical aberration of 40 nm RMS
    through the open stop (G), defocus of 150 nm RMS through the hole (IR), and a step of a half and of a quarter wave
    at the rim of the hole (G). Glare: a white square of 24 px before black, da-mobile without diffraction, a tenth of
    the hole's light veiled, half of it within 30 px.

    Expectation: the ratio of the integrals of |<exp(2 pi i W + i v rho)>|^2 over source and pixels, by quadrature over
    the stop. In the middle of a point's picture that is Marechal's exp(-(2 pi sigma / lambda)^2) for small errors,
    sinc^2(2 sqrt(3) sigma a / lambda) for the part of the defocus that the hole sees, with a = 0.46^2 its share of the
    area, and |1 - a + a exp(i phi)|^2 for a step: 0.333 for a half wave, and 0.666 for a quarter of one, which is the
    mean over all phases. The light 40 px from the centre of the square is the glare share times the integral over the
    square of the spread function of a diffuser in front of a mirror, k(r) = R^2 / (pi (R^2 + r^2)^2).

    Limit: Strehl ratios within 0.01 of the integral (three times the rendering noise), and glare within 1 %. The ratios
    of a point source are reported.

    Source: Mahajan, J. Opt. Soc. Am. 72 (1982), for Marechal's ratio; ISO 24157 for the terms.
    """
    rendering.needs_wave()
    clear = {"G": _peak(_camera("open"), "G"), "IR": _peak(_camera("hole"), "IR")}
    cases = _cases()
    figures = []
    for number, (name, (camera, waves, point)) in enumerate(cases.items()):
        channel, reach = ("IR", HOLE_RATIO) if name.startswith("hole") else ("G", 1.0)
        ratio = _peak(camera, channel) / clear[channel]
        expected = peak(waves, reach) / peak(lambda rho, theta: 0.0, reach)
        text = f"{name}, {channel}: Strehl ratio of a small source, less the integral's {expected:.3f}"
        figures.append(Figure(f"strehl.{name}", ratio - expected, "1", text))
        text = f"{name}, {channel}: Strehl ratio of a small source, less a point's {point:.3f}"
        figures.append(Figure(f"point.{name}", ratio - point, "1", text))
        progress((number + 1) / (len(cases) + 1))
    text = f"IR: light {GLARE_AT_PX} px beside a square's middle, relative to the integral of the veil, less 1"
    figures.append(Figure("glare", _glare() / _veil() - 1, "1", text))
    return Evidence(figures)


def _cases() -> dict[str, tuple[Camera, Polynomial, float]]:
    """Cameras with errors, their wavefronts in waves, and the Strehl ratios of a point in closed form."""
    area = HOLE_RATIO**2
    result: dict[str, tuple[Camera, Polynomial, float]] = {}
    for name, (sigma_nm, term) in TERMS.items():
        camera = _camera("open", wavefront_nm={name: sigma_nm})
        result[name] = camera, _times(sigma_nm / GREEN_NM, term), marechal(sigma_nm / GREEN_NM)
    turns = HOLE_DEFOCUS_NM / INFRARED_NM
    result["hole-defocus"] = (
        _camera("hole", wavefront_nm={"defocus": HOLE_DEFOCUS_NM}),
        _times(turns, lambda rho, theta: np.sqrt(3) * (2 * rho**2 - 1)),
        float(np.sinc(2 * np.sqrt(3) * turns * area) ** 2),
    )
    for name, turns in STEP_TURNS.items():
        camera = _camera("open", "hole", phase_nm=turns * GREEN_NM)
        point = abs(1 - area + area * np.exp(2j * np.pi * turns)) ** 2
        result[name] = camera, _times(turns, lambda rho, theta: np.where(rho < HOLE_RATIO, 1.0, 0.0)), float(point)
    return result


def _times(factor: float, polynomial: Polynomial) -> Polynomial:
    return lambda rho, theta: factor * polynomial(rho, theta)


def marechal(turns: float) -> float:
    """Strehl ratio exp(-(2 pi sigma)^2) of a small error of RMS sigma, in waves, over the stop."""
    return float(np.exp(-((2 * np.pi * turns) ** 2)))


# --- the pattern by quadrature -------------------------------------------------------------------


def peak(waves: Polynomial, reach: float) -> float:
    """Light of the source in the four pixels, relative to the middle of a point's pattern without errors.

    |<exp(2 pi i W + i v rho)>|^2 with v = pi u / (lambda N) at the distance u from a point's image, averaged over the
    pixels by Gauss-Legendre and over rings of the source.

    Args:
        waves: wavefront W in waves at (rho, theta) of the open lens.
        reach: radius of the stop, 1 or that of the hole, whose light is the infrared.
    """
    wavelength_um = (GREEN_NM if reach == 1 else INFRARED_NM) * 1e-3
    scale = np.pi * PITCH_UM / (wavelength_um * _working_f_number(_camera("open")))
    rho, theta, weight = _pupil(reach)
    pupil = weight * np.exp(2j * np.pi * waves(rho, theta))
    nodes, shares = np.polynomial.legendre.leggauss(4)
    rings = SOURCE_PX * np.sqrt((np.arange(3) + 0.5) / 3)  # of equal area
    around = [(ring * np.sin(angle), ring * np.cos(angle)) for ring in rings for angle in np.arange(8) * (np.pi / 4)]
    light = 0.0
    for (y, y_share), (x, x_share) in itertools.product(zip(nodes, shares, strict=True), repeat=2):
        for down, across in around:
            along = (x - across) * np.cos(theta) + (y - down) * np.sin(theta)
            light += y_share * x_share / 4 / len(around) * abs((pupil * np.exp(1j * scale * rho * along)).sum()) ** 2
    return float(light)


def _pupil(reach: float) -> tuple[Any, Any, Any]:
    """Places (rho, theta) and weights of unit sum: Gauss-Legendre in rho^2 on both sides of the hole's rim."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    parts = itertools.pairwise(sorted({0.0, HOLE_RATIO**2, reach**2}))
    halves = [(low + (high - low) * (nodes + 1) / 2, (high - low) * weights / 2) for low, high in parts]
    rho, weight = np.sqrt(np.concatenate([s for s, _ in halves])), np.concatenate([w for _, w in halves])
    theta = np.arange(48) * (2 * np.pi / 48)
    return rho[:, None], theta, weight[:, None] / (48 * reach**2)


def _working_f_number(camera: Camera) -> float:
    """Image distance over the diameter of the lens, from the data sheet."""
    lens = camera.lens
    return lens.f_number / (1 - lens.focal_length_mm * 1e-3 / lens.focus_distance_m)


# --- cameras and pictures ------------------------------------------------------------------------


def _camera(*names: str, wavefront_nm: dict[str, float] | None = None, phase_nm: float = 0.0) -> Camera:
    """da-mobile with fine pixels and the named stops, which pass narrow bands; the hole has the step ``phase_nm``.

    With the open stop, a filter on the sensor passes visible light alone.
    """
    bands = {"open": (GREEN_NM - 10, GREEN_NM + 10), "hole": (INFRARED_NM - 10, INFRARED_NM + 10)}
    camera = dasim.load_camera("da-mobile")
    stops = {stop.name: stop.model_dump() | {"passes_nm": [bands[stop.name]]} for stop in camera.stops}
    stops["hole"]["phase_nm"] = phase_nm
    return rendering.changed(
        camera,
        lens={"wavefront_nm": wavefront_nm or {}},
        sensor=SENSOR | {"cutoff_nm": 640.0 if "open" in names else 810.0},
        stops=[stops[name] | {"edge_width_nm": 1.0} for name in names],
    )


def _peak(camera: Camera, channel: str) -> float:
    """Electrons per second in the middle of the picture of a small disc in focus."""
    depth_m = camera.lens.focus_distance_m
    source = {
        "name": "source",
        "shape": "disc",
        "radius_cm": SOURCE_PX * rendering.pixel_at_m(camera, depth_m) * 100,
        "position_cm": (0, 0, depth_m * 100),
        "material": "white-paper",
    }
    shot = dasim.simulate(rendering.make_scene([source]), camera, 0, spp=SPP, diffraction="wave")
    assert shot.truth.mean_e is not None
    middle = shot.truth.mean_e[PEAK_PX, PEAK_PX, CHANNELS.index(channel)]
    return float(middle.mean()) / shot.capture.exposure_s


def _glare() -> float:
    """Light beside a bright square through a hole with glare, over that in the square of a clear lens."""
    camera = dasim.load_camera("da-mobile")
    stops = [stop.model_dump() for stop in camera.stops]
    radius_mm = GLARE_RADIUS_PX * camera.sensor.pixel_pitch_um * 1e-3
    stops[1] |= {"glare_share": GLARE_SHARE, "glare_radius_mm": radius_mm}
    frame = {"width_px": GLARE_PX, "height_px": GLARE_PX, "principal_point_px": None}
    camera = rendering.changed(camera, sensor=frame, stops=stops)
    depth_m = camera.lens.focus_distance_m
    side_cm = GLARE_SQUARE_PX * rendering.pixel_at_m(camera, depth_m) * 100
    square = {
        "name": "square",
        "shape": "plane",
        "size_cm": (side_cm, side_cm),
        "position_cm": (0, 0, depth_m * 100),
        "material": "white-paper",
    }
    shot = dasim.simulate(rendering.make_scene([square]), camera, 0, spp=GLARE_SPP, diffraction="off")
    assert shot.truth.mean_e is not None
    infrared = shot.truth.mean_e[..., CHANNELS.index("IR")].astype(np.float64)
    middle = GLARE_PX // 2
    places = [(0, GLARE_AT_PX), (0, -GLARE_AT_PX), (GLARE_AT_PX, 0), (-GLARE_AT_PX, 0)]
    beside = np.mean([infrared[middle + y - 1 : middle + y + 1, middle + x - 1 : middle + x + 1] for y, x in places])
    return float(beside / (infrared.sum() / GLARE_SQUARE_PX**2))  # the veil keeps the sum of the light


def _veil() -> float:
    """The same from the law of the veil, by the midpoint rule over the square, and the share of it.

    A little of the infrared pixels' light passes the open stop, at the edge of the coating, and is not veiled.
    """
    light = illuminants.illuminant("D65") * reflectances.curve("white-paper")
    through_hole = rendering.stop_electrons(dasim.load_camera("da-mobile"), light)[1, CHANNELS.index("IR")]
    place = (np.arange(400) + 0.5) * (GLARE_SQUARE_PX / 400) - GLARE_SQUARE_PX / 2
    distance2 = place[:, None] ** 2 + (place[None, :] - GLARE_AT_PX) ** 2
    density = GLARE_RADIUS_PX**2 / (np.pi * (GLARE_RADIUS_PX**2 + distance2) ** 2)
    return GLARE_SHARE * float(through_hole * density.mean()) * GLARE_SQUARE_PX**2
