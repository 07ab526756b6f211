"""Claims on wave optics: rendered edges and small sources, and the error of the approximation ``airy``."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.camera import geometry, pointspread
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.sfr import slanted_edge_sfr, windowed_response
from validation.references.transfer import wave_mtf
from validation.reports.plots import CHANNEL_COLOURS, plot
from validation.scores.figures import Figure
from validation.subjects import rendering

# Visible blur diameters. The hole's blur is 0.46 of them: 8 px at 17.4 px, where geometric optics errs most in IR.
SFR_BLUR_PX = (0.0, 2.0, 5.0, 10.0, 17.4, -5.0)
SFR_CYCLES_PX = np.linspace(0.05, 0.4, 15)
EDGE_DEG = 5.0
EDGE_SIZE_PX = (128, 64)
EDGE_SPP, EDGE_SEEDS = 784, 4
MTF_STEP = 1 / 512  # cycles per pixel: a period of 512 px, four times the frame's width
MTF_END = 1.8  # cycles per pixel: beyond the diffraction limit of 400 nm at f/2.8

ENERGY_BLUR_PX = (3.0, 8.0, 17.4)
ENERGY_CHANNELS = ("G", "IR")
ENERGY_FRAME_PX = 72
ENERGY_RADII_PX = np.arange(1.5, 24.0, 0.5)
ENERGY_SPP, ENERGY_SEEDS = 1024, 4
SOURCE_RADIUS_PX = 2.0
FINE = 4  # points per pixel and axis over which the PSF is summed to cover the source


def wave_sfr(progress: ShareDone) -> Evidence:
    """Path-traced slanted edges have the frequency response of wave optics, from focus to a blur diameter of 17 px.

    Rationale: diffraction dominates the near-infrared picture. The usual approximation, a blur disc convolved with the
    in-focus Airy pattern, would be wrong by up to 0.24 in frequency response.

    Set-up: white paper beside black ink at one depth in even light, with the edge between them turned by 5 degrees.
    da-mobile is focused at 40 cm; the visible blur diameter is 0, 2, 5, 10 and 17.4 px in front of the focal plane and
    5 px behind it. The picture is the mean of 4 captures of 784 samples per pixel (``mean_e`` of ``dasim.simulate``),
    divided by cos^4, 128 x 64 px. Its spatial frequency response (SFR) is measured as ISO 12233 measures a chart.

    Expectation: at 0.05 to 0.4 cycles per pixel the SFR equals |OTF| of the defocused pupil by Hopkins's integral,
    averaged over stops and wavelengths with their electrons as weights, times the transfer function of the square
    pixel. The line spread function of the prediction is multiplied by the standard's window in the same way as that of
    the measurement. The prediction uses the camera's responses, but no PSF, table or ray of the simulator.

    Limit: 0.02, as the largest difference over depths and frequencies, for each channel.

    Source: ISO 12233 (e-SFR); Hopkins 1955; Goodman, Introduction to Fourier Optics, ch. 6.
    """
    rendering.needs_wave()
    width, height = EDGE_SIZE_PX
    camera = cameras.cropped(cameras.load_camera("da-mobile"), width, height)
    measured = np.empty((EDGE_SEEDS, len(SFR_BLUR_PX), 4, len(SFR_CYCLES_PX)))
    mean, expected = np.empty(measured.shape[1:]), np.empty(measured.shape[1:])
    for index, blur in enumerate(SFR_BLUR_PX):
        scene = edge_scene(camera, blur)
        captures = []
        for seed in range(EDGE_SEEDS):
            rate = rendering.capture_rate(scene, camera, EDGE_SPP, seed, diffraction="wave")
            captures.append(rate / cos4(camera)[..., None])
            progress((index + (seed + 1) / EDGE_SEEDS) / len(SFR_BLUR_PX))
        for channel in range(4):
            for seed, picture in enumerate(captures):
                measured[seed, index, channel] = slanted_edge_sfr(picture[..., channel], SFR_CYCLES_PX, blur_px=blur)
            picture = np.mean(captures, axis=0)[..., channel]
            mean[index, channel] = slanted_edge_sfr(picture, SFR_CYCLES_PX, blur_px=blur)
        mtf = wave_mtf(camera, blur, edge_contrast(), np.arange(0, MTF_END, MTF_STEP), EDGE_DEG)
        slope = np.tan(np.radians(EDGE_DEG))
        expected[index] = windowed_response(mtf, MTF_STEP, (height, width), slope, SFR_CYCLES_PX)
    error = mean - expected
    figures = []
    for channel, name in enumerate(CHANNELS):
        at = np.unravel_index(np.abs(error[:, channel]).argmax(), error[:, channel].shape)
        what = f"{name}: largest difference between SFR and wave optics over 6 depths, 0.05 to 0.4 cycles per pixel"
        what += f" (at {SFR_BLUR_PX[at[0]]:g} px of blur, {SFR_CYCLES_PX[at[1]]:.3g} cycles per pixel)"
        figures.append(Figure(name, float(np.abs(error[:, channel]).max()), "1", what))
    noise = measured.std(axis=0, ddof=1).max() / np.sqrt(EDGE_SEEDS)
    text = "largest standard error of an SFR value, from the scatter over seeds"
    figures.append(Figure("noise", float(noise), "1", text))
    caption = "SFR of rendered edges (points) and by wave optics (lines), visible blur"
    pictures = [
        (f"{caption} {', '.join(f'{SFR_BLUR_PX[i]:g}' for i in part)} px", _sfr_plot(part, mean, expected))
        for part in np.array_split(range(len(SFR_BLUR_PX)), 2)
    ]
    return Evidence(figures, pictures)


def edge_scene(camera: Camera, blur_px: float) -> dasim.Scene:
    """A scene with a slanted edge: white paper left of the frame's centre and black ink right of it, at one depth.

    The edge is turned by ``EDGE_DEG``. The depth is the one whose signed visible blur diameter is ``blur_px``.
    """
    depth = rendering.depth_m(camera, blur_px)
    size_cm = 600 * rendering.pixel_at_m(camera, depth) * 100
    turn = np.radians(EDGE_DEG)
    shift = np.array([np.cos(turn), np.sin(turn)]) * size_cm / 2
    sheet = {"shape": "plane", "size_cm": [size_cm, size_cm], "rotation_deg": [0, 0, EDGE_DEG]}
    objects = [
        sheet | {"name": name, "material": name, "position_cm": [*(sign * shift), depth * 100]}
        for name, sign in (("white-paper", -1), ("carbon-black", 1))
    ]
    return rendering.make_scene(objects, rendering.EVEN_LIGHT)


def edge_contrast() -> FloatArray:
    """Spectrum of the step across the edge: light reflected by white paper minus light reflected by black ink."""
    step = library.reflectance("white-paper") - library.reflectance("carbon-black")
    return illuminants.illuminant("D65") * step


def cos4(camera: Camera) -> FloatArray:
    """Natural vignetting cos^4 of the off-axis angle at each pixel, [h, w], from the lens's data sheet."""
    lens, sensor = camera.lens, camera.sensor
    image_px = 1 / (1 / (lens.focal_length_mm * 1e-3) - 1 / lens.focus_distance_m) / (sensor.pixel_pitch_um * 1e-6)
    y, x = np.indices((sensor.height_px, sensor.width_px)) + 0.5
    return (1 + ((x - sensor.width_px / 2) ** 2 + (y - sensor.height_px / 2) ** 2) / image_px**2) ** -2.0


def _sfr_plot(part: NDArray[np.int_], mean: FloatArray, expected: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, index in zip(np.atleast_1d(axes), part, strict=True):
            for channel, name in enumerate(CHANNELS):
                colour = CHANNEL_COLOURS[name]
                panel.plot(SFR_CYCLES_PX, expected[index, channel], color=colour)
                panel.plot(SFR_CYCLES_PX, mean[index, channel], "o", ms=3, color=colour, label=name)
            panel.set(title=f"visible blur {SFR_BLUR_PX[index]:g} px", xlabel="cycles per pixel", ylim=(0, 1))
        np.atleast_1d(axes)[0].legend()

    return plot(draw, columns=len(part), size=(3.4, 3.0))


# --- small sources -------------------------------------------------------------------------------


def wave_energy(progress: ShareDone) -> Evidence:
    """Path-traced small sources have the encircled energy of the point spread function ``dasim.psf``.

    Rationale: calibration pictures are made with ``dasim.psf``, so renders must have the same PSFs, tails included.

    Set-up: a lit white disc of 2 px radius on the optical axis before an empty background, at visible blur diameters
    of 3, 8 and 17.4 px in front of the focal plane (40 cm, da-mobile). The render is the sum of both stops, as the mean
    of 4 seeds of 1,024 samples per pixel. The prediction is ``dasim.psf`` at quarter-pixel positions, summed over the
    source.

    Expectation: both have the same light within circles of 1.5 to 23.5 px radius about the centre, as a share of the
    light in a frame of 72 px.

    Limit: 0.03, as the largest difference over depths and radii, for G and IR.

    Source: the PSF is |FT of the defocused pupil|^2; Goodman, Introduction to Fourier Optics, ch. 6.
    """
    rendering.needs_wave()
    camera = cameras.cropped(cameras.load_camera("da-mobile"), ENERGY_FRAME_PX, ENERGY_FRAME_PX)
    rendered = np.empty((ENERGY_SEEDS, len(ENERGY_BLUR_PX), 2, len(ENERGY_RADII_PX)))
    expected = np.empty(rendered.shape[1:])
    for index, blur in enumerate(ENERGY_BLUR_PX):
        depth = rendering.depth_m(camera, blur)
        radius_cm = SOURCE_RADIUS_PX * rendering.pixel_at_m(camera, depth) * 100
        disc = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": [0, 0, depth * 100]}
        scene = rendering.make_scene([disc | {"material": "white-paper"}])
        for seed in range(ENERGY_SEEDS):
            stops = rendering.stop_pictures(scene, camera, ENERGY_SPP, seed, diffraction="wave", max_blur_px=blur + 1)
            for place, channel in enumerate(ENERGY_CHANNELS):
                rendered[seed, index, place] = encircled(stops.sum(axis=0)[..., CHANNELS.index(channel)])
            progress((index + (seed + 1) / (ENERGY_SEEDS + 1)) / len(ENERGY_BLUR_PX))
        for place, channel in enumerate(ENERGY_CHANNELS):
            expected[index, place] = encircled(_spread_source(camera, depth, channel))
    error = rendered.mean(axis=0) - expected
    figures = []
    for place, channel in enumerate(ENERGY_CHANNELS):
        at = np.unravel_index(np.abs(error[:, place]).argmax(), error[:, place].shape)
        what = f"{channel}: largest difference of encircled energy over 3 depths and all radii"
        what += f" (at {ENERGY_BLUR_PX[at[0]]:g} px of blur, radius {ENERGY_RADII_PX[at[1]]:g} px)"
        figures.append(Figure(channel, float(np.abs(error[:, place]).max()), "1", what))
    noise = rendered.std(axis=0, ddof=1).max() / np.sqrt(ENERGY_SEEDS)
    text = "largest standard error of an encircled energy, from the scatter over seeds"
    figures.append(Figure("noise", float(noise), "1", text))
    caption = "Encircled energy, rendered (points) and by dasim.psf (lines)"
    return Evidence(figures, [(caption, _energy_plot(rendered, expected))])


def encircled(picture: FloatArray) -> FloatArray:
    """Share of a square frame's light within each of ``ENERGY_RADII_PX`` about its centre, [radius]."""
    y, x = np.indices(picture.shape) + 0.5
    distance = np.hypot(y - picture.shape[0] / 2, x - picture.shape[1] / 2)
    return np.array([picture[distance <= radius].sum() for radius in ENERGY_RADII_PX]) / picture.sum()


def _spread_source(camera: Camera, depth_m: float, channel: str) -> FloatArray:
    """``dasim.psf`` summed over the source's disc, [ENERGY_FRAME_PX, ENERGY_FRAME_PX].

    The frame has an even number of pixels, so its centre is the corner at which four pixels meet.
    """
    cells = np.arange(-SOURCE_RADIUS_PX, SOURCE_RADIUS_PX, 1 / FINE) + 0.5 / FINE
    half = ENERGY_FRAME_PX // 2
    size = ENERGY_FRAME_PX + 2 * int(np.ceil(SOURCE_RADIUS_PX)) + 3
    middle = size // 2
    kernels: dict[tuple[float, float], FloatArray] = {}
    total = np.zeros((ENERGY_FRAME_PX, ENERGY_FRAME_PX))
    for y, x in itertools.product(cells, cells):
        if np.hypot(y, x) > SOURCE_RADIUS_PX:
            continue
        # The frame's centre is the corner shared by the pixels half - 1 and half.
        row, column = int(np.floor(y)), int(np.floor(x))
        offset = (y - row - 0.5, x - column - 0.5)
        kernel = _at_offset(camera, depth_m, channel, offset, size, kernels)
        top, left = middle - half - row, middle - half - column
        total += kernel[top : top + ENERGY_FRAME_PX, left : left + ENERGY_FRAME_PX]
    return total


def _at_offset(
    camera: Camera,
    depth_m: float,
    channel: str,
    offset: tuple[float, float],
    size: int,
    kernels: dict[tuple[float, float], FloatArray],
) -> FloatArray:
    """The PSF [size, size] of a point at a sub-pixel offset (y, x) from a pixel's centre.

    The stops are centred discs, so the PSF for any offset is a mirror image of the one for sorted, positive offsets,
    which ``kernels`` caches.
    """
    small, large = sorted(abs(value) for value in offset)
    key = (round(small, 6), round(large, 6))
    if key not in kernels:
        kernels[key] = dasim.psf(camera, depth_m, channel, "D65", offset_px=(small, large), size=size)
    kernel = kernels[key] if abs(offset[0]) <= abs(offset[1]) else kernels[key].T
    return kernel[:: 1 if offset[0] > 0 else -1, :: 1 if offset[1] > 0 else -1]


def _energy_plot(rendered: FloatArray, expected: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for index, panel in enumerate(axes):
            for place, channel in enumerate(ENERGY_CHANNELS):
                colour = CHANNEL_COLOURS[channel]
                panel.plot(ENERGY_RADII_PX, expected[index, place], color=colour)
                mean = rendered[:, index, place].mean(axis=0)
                panel.plot(ENERGY_RADII_PX, mean, "o", ms=3, color=colour, label=channel)
            panel.set(title=f"visible blur {ENERGY_BLUR_PX[index]:g} px", xlabel="radius in px", ylim=(0, 1.05))
        axes[0].legend()

    return plot(draw, columns=len(ENERGY_BLUR_PX), size=(3.4, 3.0))


# --- the approximation of scalar_spectral --------------------------------------------------------


def airy_table(progress: ShareDone) -> Evidence:
    """The error of the approximation ``airy`` (blur disc convolved with the in-focus Airy pattern) at every blur level.

    Rationale: renders with the variant ``scalar_spectral`` use this approximation, and its users should know its error.

    Set-up: the radial PSFs of both models (``dasim.camera.pointspread``) for da-mobile under D65, 29 blur levels, four
    channels.

    Expectation: none; the error is reported without a limit. For each level and channel it is the largest difference
    between approximation and wave optics, in encircled energy over all radii and in MTF (pixel included, along a row)
    over 0.02 to 0.5 cycles per pixel.

    Source: both models as in ``dasim.camera.pointspread``; the defocused pupil of Goodman, Introduction to Fourier
    Optics, ch. 6.
    """
    camera = cameras.load_camera("da-mobile")
    energy, mtf = pointspread.airy_errors(camera, "D65")
    progress(1.0)
    figures = []
    for name, errors in (("energy", energy), ("mtf", mtf)):
        what = {"energy": "encircled energy", "mtf": "MTF"}[name]
        for channel, letter in enumerate(CHANNELS):
            level = int(errors[:, channel].argmax())
            meaning = f"{letter}: largest error of {what} over all levels (at level {level})"
            figures.append(Figure(f"{name}.{letter}", float(errors[level, channel]), "1", meaning))
    head = ["level", "visible blur in px", *(f"{what} {name}" for what in ("energy", "MTF") for name in CHANNELS)]
    blurs = geometry.level_blur_px(camera)
    rows = [
        [str(level), f"{blurs[level]:.2f}", *(f"{value:.3f}" for value in (*energy[level], *mtf[level]))]
        for level in range(len(blurs))
    ]
    return Evidence(figures, tables=[("Largest error of 'airy' for each level and channel", head, rows)])
