"""Claim on diffraction off the axis: small sources over the full frame against Huygens's principle."""

from __future__ import annotations

import numpy as np

import dasim
from dasim.camera import geometry, pointspread, radiometry
from dasim.camera import specification as cameras
from dasim.camera.pupil_pattern import pupil_pattern
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.spectra import grid, illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.huygens import Bench, intensity
from validation.references.paper import STOP_RATIOS
from validation.references.transfer import disc_transfer
from validation.reports.plots import CHANNEL_COLOURS, plot
from validation.scores.figures import Figure
from validation.subjects import rendering

# Field angle in degrees and direction in the picture, in degrees from x towards y.
PLACES = {"axis": (0.0, 0.0), "crop-corner": (8.5, 0.0), "frame-edge": (25.6, 90.0), "frame-corner": (31.0, 36.9)}
OWN_BLUR_PX = {"focus": 0.0, "blur": 4.0}  # of the channel's own stop
COMPARED = {"G": 0, "IR": 1}  # channels, with the stop that passes most of their light
FRAME_PX, MARGIN_PX = 32, 2
FINE = 3  # points of the reference per pixel and axis; its spatial frequencies end at 1.25 cycles per pixel
CELLS = (64, 40)  # across each stop, two per wave at the frame's corner
BAND_NM = 30.0
SOURCE_RADIUS_PX = 1.5
RADII_PX = np.arange(1.0, 15.5, 0.5)
SPP = 1024
WHITE = "white-paper"
WIDTH_NM = 730.0


def off_axis(progress: ShareDone, seed: int = 0) -> Evidence:
    """Small sources far from the axis have the encircled energy of Huygens's principle.

    Rationale: towards the corner of the frame, the stop is foreshortened and the light falls obliquely on the sensor,
    so diffraction patterns widen, more in the tangential than in the sagittal direction. With on-axis patterns,
    the infrared of a full frame would be too sharp.

    Set-up: a lit white disc of 1.5 px radius that faces the camera, before an empty background, at 0, 8.5, 25.6 and 31
    degrees from the axis of da-mobile (focus 40 cm): in the middle, in the corner of a crop of 512 x 384 pixels, at the
    edge and in the corner of the full frame. It is in focus, or nearer, with 4 px of blur in the channel's own stop.
    The picture is mean_e of dasim.simulate, 1,024 samples per pixel, in a window of 32 px about the source. The
    reference sums spherical waves from all points of the stop, with exact distances, for bands of 30 nm through both
    stops, and is convolved with source and pixel.

    Expectation: both have the same share of the frame's light within circles of 1 to 15 px radius about the centre, and
    within strips of the same half width in the tangential and the sagittal direction. The difference of the on-axis
    reference at the same position is reported beside it. Kernels of dasim.psf for the hole, in focus at 730 nm, have
    the full widths at half maximum of Huygens's integral, tangential and sagittal: 2.72 px on the axis, 2.81 and 2.75,
    3.70 and 3.02, 4.30 and 3.17 px.

    Limit: 0.03, as the largest difference over circles and strips, for G and IR; 0.02 px for widths.

    Source: Huygens's principle; Goodman, Introduction to Fourier Optics, ch. 3.
    """
    rendering.needs_wave()
    figures, curves = [], {}
    on_axis: dict[tuple[str, str], FloatArray] = {}
    cases = [(place, blur, channel) for place in PLACES for blur in OWN_BLUR_PX for channel in COMPARED]
    pictures: dict[tuple[str, float], FloatArray] = {}
    for number, (place, blur, channel) in enumerate(cases):
        camera, tangent = window(*PLACES[place])
        visible_px = OWN_BLUR_PX[blur] / STOP_RATIOS[COMPARED[channel]]
        depth_m = rendering.depth_m(camera, visible_px)
        if (place, visible_px) not in pictures:
            scene = source(camera, depth_m, tangent)
            mean_e = dasim.simulate(scene, camera, seed, spp=SPP).truth.mean_e
            pictures[place, visible_px] = np.asarray(mean_e, dtype=np.float64)
        rendered = shares(pictures[place, visible_px][..., CHANNELS.index(channel)], tangent)
        waves = reference(camera, depth_m, tangent, channel)
        expected = shares(waves, tangent)
        on_axis.setdefault((blur, channel), waves)
        unaware = shares(on_axis[blur, channel], tangent)
        key, what = f"{place}.{blur}.{channel}", f"{PLACES[place][0]:g} degrees, own blur {OWN_BLUR_PX[blur]:g} px"
        figures += [
            Figure(f"{key}.energy", _worst(rendered, expected), "1", f"{what}: largest difference of an energy"),
            Figure(f"{key}.axis", _worst(unaware, expected), "1", f"{what}: the same for the pattern of the axis"),
        ]
        curves[place, blur, channel] = rendered, expected
        progress((number + 1) / len(cases))
    for place, (angle_deg, _) in PLACES.items():
        for direction, width_px in zip(("tangential", "sagittal"), widths_px(angle_deg), strict=True):
            what = f"{angle_deg:g} degrees, hole in focus at {WIDTH_NM:g} nm: full {direction} width at half maximum"
            figures.append(Figure(f"fwhm.{place}.{direction}", width_px, "px", what))
    return Evidence(
        figures, [(f"Energy within circles (points: rendered), {name}", _plot(curves, name)) for name in PLACES]
    )


def window(angle_deg: float, turn_deg: float) -> tuple[Camera, FloatArray]:
    """A window of da-mobile's sensor about a field angle, and the angle's tangent as a vector in the picture."""
    camera = cameras.load_camera("da-mobile")
    tangent = np.tan(np.radians(angle_deg)) * np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])
    axis_px = FRAME_PX / 2 - tangent / rendering.pixel_at_m(camera, 1.0)
    size = {"width_px": FRAME_PX, "height_px": FRAME_PX, "principal_point_px": axis_px.tolist()}
    return rendering.changed(camera, sensor=size), tangent


def source(camera: Camera, depth_m: float, tangent: FloatArray) -> dasim.Scene:
    """A lit disc in the middle of the window."""
    radius_cm = SOURCE_RADIUS_PX * rendering.pixel_at_m(camera, depth_m) * 100
    place_cm = 100 * depth_m * np.array([*tangent, 1.0])
    disc = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": place_cm.tolist()}
    return rendering.make_scene([disc | {"material": WHITE}])


def reference(camera: Camera, depth_m: float, tangent: FloatArray, channel: str) -> FloatArray:
    """Light of the source in a channel by Huygens's principle, [FRAME_PX, FRAME_PX]."""
    lens, pitch_m = camera.lens, camera.sensor.pixel_pitch_um * 1e-6
    focal_m = lens.focal_length_mm * 1e-3
    image_m = 1 / (1 / focal_m - 1 / lens.focus_distance_m)
    count = (FRAME_PX + 2 * MARGIN_PX) * FINE
    offset_px = (np.arange(count) + 0.5) / FINE - count / FINE / 2
    angle_deg = float(np.degrees(np.arctan(np.hypot(*tangent))))
    total = np.zeros((count, count))
    for stop, ratio, cells in zip(camera.stops, STOP_RATIOS, CELLS, strict=True):
        response = radiometry.stop_response(camera, stop, angle_deg)[CHANNELS.index(channel)]
        weights, centres = _bands(response * illuminants.illuminant("D65") * library.reflectance(WHITE))
        radius_m = ratio * focal_m / lens.f_number / 2
        bench = Bench(radius_m, image_m, lens.focus_distance_m, depth_m, (float(tangent[0]), float(tangent[1])))
        total += np.tensordot(weights, intensity(bench, centres, offset_px * pitch_m, cells), axes=1)
    frequency = np.fft.fftfreq(count, 1 / FINE)
    spread = np.sinc(frequency[:, None]) * np.sinc(frequency[None, :])
    spread *= disc_transfer(2 * SOURCE_RADIUS_PX * np.hypot(frequency[:, None], frequency[None, :]))
    blurred = np.fft.ifft2(np.fft.fft2(total) * spread).real
    inner = slice(MARGIN_PX * FINE + FINE // 2, -MARGIN_PX * FINE, FINE)  # the pixels' centres
    return np.asarray(blurred[inner, inner])


def widths_px(angle_deg: float) -> tuple[float, float]:
    """Full widths at half maximum, tangential and sagittal, of the simulator's kernel of the hole in focus."""
    camera = cameras.load_camera("da-mobile")
    hole = camera.stops[1]
    field_px = np.tan(np.radians(angle_deg)) / rendering.pixel_at_m(camera, 1.0)
    oblique = geometry.foreshortening(camera, (float(field_px), 0.0))
    scale_px = WIDTH_NM * 1e-3 * pointspread.working_f_number(camera, 1.0) / camera.sensor.pixel_pitch_um
    place, middle = np.arange(-4.0, 4.0, 0.01), np.zeros(1)
    tangential = pupil_pattern(hole, 0.0, middle, place / scale_px, None, oblique)[0]
    sagittal = pupil_pattern(hole, 0.0, place / scale_px, middle, None, oblique)[:, 0]
    widths = [float(0.01 * (line > line.max() / 2).sum()) for line in (tangential, sagittal)]
    return widths[0], widths[1]


def _bands(signal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integrals over bands of BAND_NM that matter, and mean wavelengths."""
    index = ((grid.WAVELENGTH_NM - grid.WAVELENGTH_NM[0]) // BAND_NM).astype(int)
    weight, first = np.bincount(index, signal), np.bincount(index, signal * grid.WAVELENGTH_NM)
    used = weight > 0.003 * weight.max()
    return weight[used], first[used] / weight[used]


def shares(picture: FloatArray, tangent: FloatArray) -> FloatArray:
    """Shares of a frame's light within circles, and within tangential and sagittal strips, [3, radius]."""
    y, x = np.indices(picture.shape) + 0.5 - FRAME_PX / 2
    length = np.hypot(*tangent)
    along = tangent / length if length > 0 else np.array([1.0, 0.0])
    distances = (np.hypot(y, x), np.abs(along[0] * x + along[1] * y), np.abs(along[0] * y - along[1] * x))
    inside = [[picture[distance <= radius].sum() for radius in RADII_PX] for distance in distances]
    return np.array(inside) / picture.sum()


def _worst(one: FloatArray, other: FloatArray) -> float:
    return float(np.abs(one - other).max())


def _plot(curves: dict[tuple[str, str, str], tuple[FloatArray, FloatArray]], place: str) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        axes = np.atleast_1d(axes)
        for panel, blur in zip(axes, OWN_BLUR_PX, strict=True):
            for channel in COMPARED:
                rendered, expected = curves[place, blur, channel]
                panel.plot(RADII_PX, expected[0], color=CHANNEL_COLOURS[channel])
                panel.plot(RADII_PX, rendered[0], "o", ms=3, color=CHANNEL_COLOURS[channel], label=channel)
            panel.set(title=f"own blur {OWN_BLUR_PX[blur]:g} px", xlabel="radius in px", ylim=(0, 1.05))
        axes[0].legend()

    return plot(draw, columns=len(OWN_BLUR_PX), size=(3.4, 3.0))
