"""Claims on the amount of light: light loss of small apertures, near-infrared crosstalk, absolute electrons.

All of them render an even wall, whose picture does not depend on blur.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.camera import noise, specification
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.spectra import grid, illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references import radiometry
from validation.references.paper import HOLE_RATIO, STOP_RATIOS
from validation.scores.figures import Figure
from validation.subjects import rendering, walls
from validation.subjects.rendering import NotRun

FRAME = {"width_px": 16, "height_px": 12}
SPP = 256

# From the paper, below eq. (1): the number of pixels of the 2 x 2 mosaic behind each aperture, and its radius ratio.
REDUCTIONS = {
    "dual-aperture": ("da-mobile", [(1, 0.46)]),
    "chakrabarti-zickler": ("chakrabarti-zickler", [(2, 0.59)]),
    "bando": ("bando", [(1, 0.5), (2, 0.5), (1, 0.5)]),
}
BANDS_NM = {"B": (400.0, 496.0), "G": (496.0, 590.0), "R": (590.0, 650.0), "IR": (650.0, 810.0)}  # those of the stops
GUARD_NM = 8.0  # distance of a box response from its stop's spectral edge, which would otherwise cost light
SHARP_NM = 3.0  # 10-90 % width of an edge; the wavelength grid has steps of 2 nm
BOX_PEAK = 0.9
LOSS_LIGHTS = ("D65", "A")

EQ8_GLASS_NM = 630.0  # edge of the disc, moved below the band: eq. (8) assumes that near-infrared passes the hole only
HOLE_LIGHT_NM = (680.0, 790.0)  # clear of the spectral edges of disc (650 nm) and sensor (810 nm)
REAL_LIGHTS = ("D65", "D55", "A")

RADIOMETRY_FRAME = {"width_px": 48, "height_px": 36, "pixel_pitch_um": 50.0}  # wide angle: cos^4 is 0.77 in the corner
PLACES = {"middle": (slice(15, 21), slice(21, 27)), "corner": (slice(0, 6), slice(0, 6))}


# --- light loss ----------------------------------------------------------------------------------


def light_loss(progress: ShareDone) -> Evidence:
    """Cameras with colour-dependent apertures lose the share of the light that eq. (1) predicts.

    Rationale: low light loss is the paper's main advantage over earlier cameras with coded apertures.

    Set-up: an even wall under D65, captured by three cameras: the dual aperture, the green stop of Chakrabarti and
    Zickler, and Bando's three displaced discs. Eq. (1) assumes equal signals, disjoint colours and no crosstalk. The
    responses are therefore boxes in the stops' bands, 8 nm inside their edges, scaled for equal electrons; the edges
    are 3 nm wide. Each camera is rendered with its stops and with the whole lens open to all light; the loss is
    1 - ratio of the two means over the mosaic. The losses of the same cameras with their bundled responses and 8 nm
    edges, under D65 and A, are reported without a limit.

    Expectation: the sum over stops of n_k (1 - alpha_k^2) / 4, where n_k is the number of pixels of the 2 x 2 mosaic
    behind stop k and alpha_k its radius ratio: 19.7 %, 32.6 % and 75 %.

    Limit: 0.5 percentage points.

    Source: eq. (1) and the numbers below it.
    """
    if rendering.activate().startswith("scalar"):
        raise NotRun("only scalar_spectral works here, which has no displaced discs; install LLVM 17 or newer")
    lit = {light: walls.wall(light) for light in LOSS_LIGHTS}
    figures = []
    for number, (name, (bundled, reductions)) in enumerate(REDUCTIONS.items()):
        camera = rendering.changed(cameras.load_camera(bundled), sensor=FRAME)
        expected = sum(count * (1 - alpha**2) for count, alpha in reductions) / 4
        loss, uneven = _loss(lit["D65"], _ideal(camera))
        figures.append(Figure(name, loss, "1", f"light loss with ideal responses; eq. (1) gives {expected:.4f}"))
        text = "spread of the channels' electrons without stops, ideal responses, over their mean"
        figures.append(Figure(f"{name}.uneven", uneven, "1", text))
        for light in LOSS_LIGHTS:
            real, _ = _loss(lit[light], camera)
            text = f"light loss under {light} with the bundled responses"
            figures.append(Figure(f"{name}.real-{light}", real, "1", text))
        progress((number + 1) / len(REDUCTIONS))
    return Evidence(figures)


def _loss(wall: Any, camera: Camera) -> tuple[float, float]:
    """Share of the light lost relative to the open lens, and the relative spread of channels behind the open lens."""
    whole = _rates(wall, rendering.changed(camera, stops=[{"name": "whole", "radius_ratio": 1.0}]))
    stopped = _rates(wall, camera)
    channels = whole.mean(axis=(0, 1))
    loss = 1 - noise.mosaic(stopped, camera).mean() / noise.mosaic(whole, camera).mean()
    return float(loss), float(np.ptp(channels) / channels.mean())


def _ideal(camera: Camera) -> Camera:
    """The camera with sharp spectral edges and disjoint box responses, of equal electrons from the wall under D65."""
    nm = grid.WAVELENGTH_NM
    light = illuminants.illuminant("D65") * library.reflectance("white-paper") * grid.photons_per_joule()
    boxes = {}
    for name in sensors.channels(camera.sensor):
        low, high = BANDS_NM[name]
        box = (nm >= (low + GUARD_NM if low > nm[0] else low)) & (nm <= high - GUARD_NM)
        boxes[name] = box / grid.integrate(box * light)
    highest = max(float(box.max()) for box in boxes.values())
    curves = {name: tuple(BOX_PEAK * box / highest) for name, box in boxes.items()}
    response = {"wavelength_nm": tuple(nm), "channels": curves}
    return rendering.changed(
        camera,
        stops=[stop.model_dump() | {"edge_width_nm": SHARP_NM} for stop in camera.stops],
        sensor={"quantum_efficiency": response, "cutoff_width_nm": SHARP_NM},
    )


# --- near-infrared -------------------------------------------------------------------------------


def eq8_flat_field(progress: ShareDone) -> Evidence:
    """Near-infrared light reaches R, G and B in the ratios of eq. (8).

    Rationale: the reconstruction subtracts near-infrared from R, G and B with these coefficients, which it computes
    from the response curves alone.

    Set-up: an even wall with constant reflectance in the band, under light with equal photons per wavelength from 650
    to 810 nm and edges of 0.001 nm. The edge of the disc's coating lies at 650 nm, partly within this band, where the
    open lens still passes up to five times the hole's light. Eq. (8) does not model the disc, so the figures with a
    limit use a disc whose edge is moved down to 630 nm. The sensor's 810 nm filter is part of the response. The
    unchanged da-mobile is reported without a limit, under equal photons and under D65, D55 and A cut to the same band.

    Expectation: the electrons of R, G and B divided by those of IR equal the ratios of the areas under their response
    curves over 650-810 nm.

    Limit: 1 % of each coefficient.

    Source: eq. (8).
    """
    rendering.activate()
    as_built = rendering.changed(cameras.load_camera("da-mobile"), sensor=FRAME)
    below = {"open": [(400.0, EQ8_GLASS_NM)], "hole": [(EQ8_GLASS_NM, 830.0)]}
    moved = rendering.changed(
        as_built, stops=[stop.model_dump() | {"passes_nm": below[stop.name]} for stop in as_built.stops]
    )
    expected = specification.crosstalk(as_built)
    equal = walls.sharp_light(grid.NEAR_INFRARED_NM, 1 / grid.photons_per_joule())
    runs: list[tuple[str, Camera, dict[str, Any], str]] = [
        ("", moved, equal, "equal photons, all through the hole"),
        ("as-built.", as_built, equal, "unchanged da-mobile, equal photons"),
    ]
    for light in REAL_LIGHTS:
        curve = walls.sharp_light(grid.NEAR_INFRARED_NM, illuminants.illuminant(light))
        runs.append((f"{light}.", as_built, curve, f"unchanged da-mobile, {light} cut to 650-810 nm"))
    figures = []
    for number, (prefix, camera, spectrum, what) in enumerate(runs):
        signal = _rates(walls.wall(spectrum), camera).mean(axis=(0, 1))
        for name, ratio, coefficient in zip("RGB", signal[:3] / signal[3], expected, strict=True):
            meaning = f"{what}: relative error of {name} over IR, {ratio:.4f}, against {coefficient:.4f} by eq. (8)"
            figures.append(Figure(f"{prefix}{name}", float(ratio / coefficient - 1), "1", meaning))
        progress((number + 1) / len(runs))
    return Evidence(figures)


def hole_alpha_squared(progress: ShareDone) -> Evidence:
    """The hole passes the share alpha^2 of the near-infrared light, alpha being its radius ratio.

    Rationale: the near-infrared signal, and with it the noise of the depth estimate, depends on the area of the hole.

    Set-up: an even wall under light with equal photons per wavelength from 680 to 790 nm, clear of the spectral edges
    of coating and sensor; da-mobile with its disc (both stops), and without any disc.

    Expectation: the ratio of electrons is alpha^2 = 0.46^2 in every channel, since the visible stop passes nothing in
    this band.

    Limit: relative error of 0.5 %.

    Source: sec. 3.2; the area of a disc.
    """
    rendering.activate()
    camera = rendering.changed(cameras.load_camera("da-mobile"), sensor=FRAME)
    wall = walls.wall(walls.sharp_light(HOLE_LIGHT_NM, 1 / grid.photons_per_joule()))
    whole = _rates(wall, rendering.changed(camera, stops=[{"name": "whole", "radius_ratio": 1.0}]))
    progress(0.5)
    ratio = _rates(wall, camera).mean(axis=(0, 1)) / whole.mean(axis=(0, 1))
    return Evidence(
        [
            Figure(name, float(value / HOLE_RATIO**2 - 1), "1", f"{name}: relative error against alpha^2")
            for name, value in zip(CHANNELS, ratio, strict=True)
        ]
    )


# --- absolute ------------------------------------------------------------------------------------


def absolute_electrons(progress: ShareDone) -> Evidence:
    """A wall of known illuminance gives the number of electrons that follows from the camera's data sheet.

    Rationale: exposure time, gain and noise of the simulation correspond to those of a real camera only if electrons
    are absolute.

    Set-up: a grey card under 500 lux of illuminant A fills the view. The camera has the lens of da-mobile and a coarse
    sensor of 48 x 36 pixels of 50 um, whose view is so wide that cos^4 falls to 0.77. The electrons are averaged over
    6 x 6 pixels in the centre and in a corner.

    Expectation: for each stop the irradiance is E = pi L (r/s)^2 cos^4 with L = rho E_wall / pi. E times pixel area,
    filters, quantum efficiency and photons per joule is integrated over wavelength by quadrature, with CODATA constants
    and Planck's law, and summed over both stops. The computation (``validation.references.radiometry``) shares no
    radiometry with the simulator.

    Limit: 1 % in every channel, in the centre and in the corner.

    Source: the Abbe lens (sine condition); CIE 015 for illuminance.
    """
    rendering.activate()
    camera = rendering.changed(cameras.load_camera("da-mobile"), sensor=RADIOMETRY_FRAME)
    rate = _rates(walls.wall("A", material="grey-card", lux=radiometry.WALL_LUX), camera)
    progress(0.5)
    figures = []
    for place, (rows, columns) in PLACES.items():
        y = (rows.start + rows.stop - rate.shape[0]) / 2
        x = (columns.start + columns.stop - rate.shape[1]) / 2
        for channel, name in enumerate(CHANNELS):
            expected = sum(
                radiometry.wall_electrons(camera, channel, x, y, ratio, side)
                for ratio, side in zip(STOP_RATIOS, ("open", "hole"), strict=True)
            )
            error = float(rate[rows, columns, channel].mean() / expected - 1)
            meaning = f"{name}, {place} of the picture: relative error of the expected {expected:.4g} e-/s"
            figures.append(Figure(f"{place}.{name}", error, "1", meaning))
    return Evidence(figures)


def _rates(wall: Any, camera: Camera) -> FloatArray:
    """Electrons per second through all stops, [h, w, channel]."""
    return rendering.stop_pictures(wall, camera, SPP, 1, diffraction="off", max_blur_px=0.0).sum(axis=0)
