"""Claims of light: what smaller apertures cost, crosstalk of near-infrared, the hole's share, absolute electrons.

All are pictures of an even wall, where blur does not show and only light counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.camera import noise, specification
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

# Paper, below eq. (1): the mosaic's pixels that see each aperture, and its radius.
REDUCTIONS = {
    "dual-aperture": ("da-mobile", [(1, 0.46)]),
    "chakrabarti-zickler": ("chakrabarti-zickler", [(2, 0.59)]),
    "bando": ("bando", [(1, 0.5), (2, 0.5), (1, 0.5)]),
}
BANDS_NM = {"B": (400.0, 496.0), "G": (496.0, 590.0), "R": (590.0, 650.0), "IR": (650.0, 810.0)}  # the stops' own
GUARD_NM = 8.0  # a box response keeps this far from a stop's edge, so that no light is lost in the edge
SHARP_NM = 3.0  # 10-90 %; the wavelength grid has steps of 2 nm
BOX_PEAK = 0.9
LOSS_LIGHTS = ("D65", "A")

EQ8_GLASS_NM = 630.0  # below the band, so that all near-infrared passes the hole, which eq. (8) takes for granted
HOLE_LIGHT_NM = (680.0, 790.0)  # inside the coating's and the sensor's edges
REAL_LIGHTS = ("D65", "D55", "A")

RADIOMETRY_FRAME = {"width_px": 48, "height_px": 36, "pixel_pitch_um": 50.0}  # wide: cos^4 is 0.77 in the corner
PLACES = {"middle": (slice(15, 21), slice(21, 27)), "corner": (slice(0, 6), slice(0, 6))}


# --- light loss ----------------------------------------------------------------------------------


def light_loss(progress: ShareDone) -> Evidence:
    """Smaller apertures cost the light that eq. (1) says.

    Rationale: how little light is lost is what the paper holds against earlier cameras with coded apertures.

    Set-up: an even wall under D65; the dual aperture, Chakrabarti-Zickler's green stop and Bando's three displaced
    discs. Eq. (1) assumes equal signals, disjoint colours and no crosstalk, so the responses are boxes in the stops'
    bands, 8 nm inside their edges, of heights that give equal electrons; edges 3 nm wide. Rendered with the
    stops and with the whole lens open for all light; the loss is 1 - ratio of the means over the mosaic. The same
    cameras with their bundled responses and 8 nm edges, under D65 and A, are reported.

    Expectation: sum of n_k (1 - alpha_k^2) / 4: 19.7 %, 32.6 % and 75 %.

    Limit: 0.5 percentage points.

    Source: eq. (1) and the figures below it.
    """
    if rendering.activate().startswith("scalar"):
        raise NotRun("only scalar_spectral works here, which has no displaced discs; install LLVM 17 or newer")
    lit = {light: walls.wall(light) for light in LOSS_LIGHTS}
    figures = []
    for number, (name, (bundled, reductions)) in enumerate(REDUCTIONS.items()):
        camera = rendering.changed(cameras.load_camera(bundled), sensor=FRAME)
        expected = sum(count * (1 - alpha**2) for count, alpha in reductions) / 4
        loss, uneven = _loss(lit["D65"], _ideal(camera))
        figures.append(Figure(name, loss, "1", f"light lost, ideal responses; eq. (1) says {expected:.4f}"))
        figures.append(Figure(f"{name}.uneven", uneven, "1", "largest difference of the channels without stops"))
        for light in LOSS_LIGHTS:
            real, _ = _loss(lit[light], camera)
            figures.append(Figure(f"{name}.real-{light}", real, "1", f"light lost under {light}, bundled responses"))
        progress((number + 1) / len(REDUCTIONS))
    return Evidence(figures)


def _loss(wall: Any, camera: Camera) -> tuple[float, float]:
    """Share of light lost against the open lens, and the largest relative difference of the open lens's channels."""
    whole = _rates(wall, rendering.changed(camera, stops=[{"name": "whole", "radius_ratio": 1.0}]))
    stopped = _rates(wall, camera)
    channels = whole.mean(axis=(0, 1))
    loss = 1 - noise.mosaic(stopped, camera).mean() / noise.mosaic(whole, camera).mean()
    return float(loss), float(np.ptp(channels) / channels.mean())


def _ideal(camera: Camera) -> Camera:
    """The camera with disjoint box responses that give equal electrons from the wall under D65, and sharp edges."""
    nm = grid.WAVELENGTH_NM
    light = illuminants.illuminant("D65") * library.reflectance("white-paper") * grid.photons_per_joule()
    boxes = {}
    for name in cameras.channels(camera.sensor):
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
    """Near-infrared reaches R, G and B in the ratios of eq. (8).

    Rationale: the reconstruction takes near-infrared off R, G and B with these coefficients, from curves alone.

    Set-up: an even wall, flat in the band, under light of equal photons from 650 to 810 nm that ends within 0.001 nm.
    The disc's coating changes over at 650 nm, in the band, where the open lens still passes up to five times the
    hole's light; eq. (8) knows no disc, so for the limited figures the change-over is moved down to 630 nm. The
    sensor's filter counts to the response. Reported beside: da-mobile as built, under equal photons and under
    D65, D55 and A cut to the same band.

    Expectation: electrons of R, G and B over those of IR are the ratios of their areas over 650-810 nm.

    Limit: 1 % of each coefficient.

    Source: eq. (8).
    """
    rendering.activate()
    as_built = rendering.changed(cameras.load_camera("da-mobile"), sensor=FRAME)
    below = {"open": [(400.0, EQ8_GLASS_NM)], "hole": [(EQ8_GLASS_NM, 830.0)]}
    moved = rendering.changed(
        as_built, stops=[stop.model_dump() | {"passes_nm": below[stop.name]} for stop in as_built.stops]
    )
    expected = specification.crosstalk(as_built.sensor)
    equal = walls.sharp_light(grid.NEAR_INFRARED_NM, 1 / grid.photons_per_joule())
    runs: list[tuple[str, Camera, dict[str, Any], str]] = [
        ("", moved, equal, "equal photons, all through the hole"),
        ("as-built.", as_built, equal, "da-mobile as built, equal photons"),
    ]
    for light in REAL_LIGHTS:
        curve = walls.sharp_light(grid.NEAR_INFRARED_NM, illuminants.illuminant(light))
        runs.append((f"{light}.", as_built, curve, f"da-mobile as built, {light} cut to 650-810 nm"))
    figures = []
    for number, (prefix, camera, spectrum, what) in enumerate(runs):
        signal = _rates(walls.wall(spectrum), camera).mean(axis=(0, 1))
        for name, ratio, coefficient in zip("RGB", signal[:3] / signal[3], expected, strict=True):
            meaning = f"{what}: {name} over IR is {ratio:.4f}, off eq. (8)'s {coefficient:.4f} by this share"
            figures.append(Figure(f"{prefix}{name}", float(ratio / coefficient - 1), "1", meaning))
        progress((number + 1) / len(runs))
    return Evidence(figures)


def hole_alpha_squared(progress: ShareDone) -> Evidence:
    """The hole passes the square of its radius of the near-infrared light.

    Rationale: the near-infrared signal, and with it the noise of depth, stands and falls with the hole's area.

    Set-up: an even wall under light of equal photons from 680 to 790 nm, inside the coating's and the sensor's edges;
    da-mobile with its disc (both stops), and without any disc.

    Expectation: the ratio of electrons is alpha^2 = 0.46^2 in every channel, since the visible stop passes nothing.

    Limit: 0.5 % of it.

    Source: sec. 3.2: the area of a disc.
    """
    rendering.activate()
    camera = rendering.changed(cameras.load_camera("da-mobile"), sensor=FRAME)
    wall = walls.wall(walls.sharp_light(HOLE_LIGHT_NM, 1 / grid.photons_per_joule()))
    whole = _rates(wall, rendering.changed(camera, stops=[{"name": "whole", "radius_ratio": 1.0}]))
    progress(0.5)
    ratio = _rates(wall, camera).mean(axis=(0, 1)) / whole.mean(axis=(0, 1))
    return Evidence(
        [
            Figure(name, float(value / HOLE_RATIO**2 - 1), "1", f"{name}: ratio over alpha^2, less 1")
            for name, value in zip(CHANNELS, ratio, strict=True)
        ]
    )


# --- absolute ------------------------------------------------------------------------------------


def absolute_electrons(progress: ShareDone) -> Evidence:
    """A wall of known lux gives the electrons that follow from the data sheet.

    Rationale: exposure time, gain and noise mean what they mean on a camera only if electrons are absolute.

    Set-up: a grey card that fills the view under 500 lux of illuminant A; the lens of da-mobile before a coarse
    sensor of 48 x 36 pixels of 50 um, which sees so widely that cos^4 falls to 0.77. Mean of 6 x 6 pixels.

    Expectation: E = pi L (r/s)^2 cos^4 with L = rho E_wall / pi for each stop, times pixel, filters, quantum
    efficiency and photons a joule, integrated over wavelength by quadrature with CODATA constants and Planck's law,
    written out apart from the simulator (validation/radiometry.py). Both stops together.

    Limit: 1 % in every channel, in the middle and the corner.

    Source: the Abbe lens (sine condition); CIE 015 for the lux.
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
            meaning = f"{name}, {place} of the picture: relative error; {expected:.4g} e-/s are right"
            figures.append(Figure(f"{place}.{name}", error, "1", meaning))
    return Evidence(figures)


def _rates(wall: Any, camera: Camera) -> FloatArray:
    """Electrons a second through all stops, [h, w, channel]."""
    return rendering.stop_pictures(wall, camera, SPP, 1, diffraction="off", max_blur_px=0.0).sum(axis=0)
