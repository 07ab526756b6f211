"""Claims of wave optics: edges and small sources, and what the approximation ``airy`` costs."""

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

# The hole's own blur is 0.46 of these: the last, 8 px, is where geometry is most wrong about the near-infrared.
SFR_BLUR_PX = (0.0, 2.0, 5.0, 10.0, 17.4, -5.0)
SFR_CYCLES_PX = np.linspace(0.05, 0.4, 15)
EDGE_DEG = 5.0
EDGE_SIZE_PX = (128, 64)
EDGE_SPP, EDGE_SEEDS = 784, 4
MTF_STEP = 1 / 512  # cycles a pixel: a period of 512 px, four frames
MTF_END = 1.8  # cycles a pixel: beyond the diffraction limit of 400 nm at f/2.8

ENERGY_BLUR_PX = (3.0, 8.0, 17.4)
ENERGY_CHANNELS = ("G", "IR")
ENERGY_FRAME_PX = 72
ENERGY_RADII_PX = np.arange(1.5, 24.0, 0.5)
ENERGY_SPP, ENERGY_SEEDS = 1024, 4
SOURCE_RADIUS_PX = 2.0
FINE = 4  # places a pixel and axis at which the kernel is spread over the source


def wave_sfr(progress: ShareDone) -> Evidence:
    """Path-traced slanted edges have the frequency response of wave optics, from focus to a blur of 17 px.

    Rationale: the near-infrared picture is decided by diffraction; a product of blur disc and Airy pattern would
    be off by 0.24 in its frequency response.

    Set-up: white paper beside black ink at one depth, their edge turned by 5 degrees, in even light; visible blurs
    of 0, 2, 5, 10 and 17.4 px before the focus and 5 px behind it (focus 40 cm, da-mobile). The mean electrons of
    both stops, divided by cos^4, 128 x 64 px, mean of 4 seeds of 784 samples, measured as ISO 12233 measures a chart.

    Expectation: the SFR at 0.05 to 0.4 cycles a pixel is |OTF| of the defocused pupil by Hopkins's integral, summed
    over stops and wavelengths by their electrons, times that of the pixel's square; its line spread gets the standard's
    window as the measured one does. No kernel, table or ray of the simulator takes part; the responses do.

    Limit: 0.02, the largest difference over depths and frequencies, for each channel.

    Source: ISO 12233 (e-SFR); Hopkins 1955; Goodman, Introduction to Fourier Optics, ch. 6.
    """
    rendering.needs_wave()
    width, height = EDGE_SIZE_PX
    camera = cameras.cropped(cameras.load_camera("da-mobile"), width, height)
    measured = np.empty((EDGE_SEEDS, len(SFR_BLUR_PX), 4, len(SFR_CYCLES_PX)))
    mean, expected = np.empty(measured.shape[1:]), np.empty(measured.shape[1:])
    for index, blur in enumerate(SFR_BLUR_PX):
        scene = edge_scene(camera, blur)
        pictures = []
        for seed in range(EDGE_SEEDS):
            stops = rendering.stop_pictures(
                scene, camera, EDGE_SPP, seed, diffraction="wave", max_blur_px=abs(blur) + 1
            )
            pictures.append(stops.sum(axis=0) / cos4(camera)[..., None])
            progress((index + (seed + 1) / EDGE_SEEDS) / len(SFR_BLUR_PX))
        for channel in range(4):
            for seed, picture in enumerate(pictures):
                measured[seed, index, channel] = slanted_edge_sfr(picture[..., channel], SFR_CYCLES_PX, blur_px=blur)
            picture = np.mean(pictures, axis=0)[..., channel]
            mean[index, channel] = slanted_edge_sfr(picture, SFR_CYCLES_PX, blur_px=blur)
        mtf = wave_mtf(camera, blur, edge_contrast(), np.arange(0, MTF_END, MTF_STEP), EDGE_DEG)
        slope = np.tan(np.radians(EDGE_DEG))
        expected[index] = windowed_response(mtf, MTF_STEP, (height, width), slope, SFR_CYCLES_PX)
    error = mean - expected
    figures = []
    for channel, name in enumerate(CHANNELS):
        at = np.unravel_index(np.abs(error[:, channel]).argmax(), error[:, channel].shape)
        what = f"{name}: largest difference between SFR and wave optics over 6 depths, 0.05 to 0.4 cycles a pixel"
        what += f" (at {SFR_BLUR_PX[at[0]]:g} px of blur, {SFR_CYCLES_PX[at[1]]:.3g} cycles a pixel)"
        figures.append(Figure(name, float(np.abs(error[:, channel]).max()), "1", what))
    noise = measured.std(axis=0, ddof=1).max() / np.sqrt(EDGE_SEEDS)
    figures.append(Figure("noise", float(noise), "1", "largest standard error of an SFR value, from the seeds"))
    caption = "SFR of rendered edges (points) and wave optics (lines), blur of"
    pictures = [
        (f"{caption} {', '.join(f'{SFR_BLUR_PX[i]:g}' for i in part)} px", _sfr_plot(part, mean, expected))
        for part in np.array_split(range(len(SFR_BLUR_PX)), 2)
    ]
    return Evidence(figures, pictures)


def edge_scene(camera: Camera, blur_px: float) -> dasim.Scene:
    """White paper left of the frame's middle and black ink right of it, turned by ``EDGE_DEG``, at one depth."""
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
    """Spectrum of the edge's step: the light on white paper less that on black ink."""
    step = library.reflectance("white-paper") - library.reflectance("carbon-black")
    return illuminants.illuminant("D65") * step


def cos4(camera: Camera) -> FloatArray:
    """Natural vignetting of the frame, [h, w], from the lens's data."""
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
            panel.set(title=f"visible blur {SFR_BLUR_PX[index]:g} px", xlabel="cycles a pixel", ylim=(0, 1))
        np.atleast_1d(axes)[0].legend()

    return plot(draw, columns=len(part), size=(3.4, 3.0))


# --- small sources -------------------------------------------------------------------------------


def wave_energy(progress: ShareDone) -> Evidence:
    """Path-traced small sources spread their light as ``dasim.psf`` says.

    Rationale: reconstruction is calibrated with ``dasim.psf``; renders must have the same kernels, tails included.

    Set-up: a lit white disc of 2 px radius before nothing, on the axis, at visible blurs of 3, 8 and 17.4 px before
    the focus (40 cm, da-mobile), both stops, mean of 4 seeds of 1,024 samples; ``dasim.psf`` at quarter-pixel
    places, summed over the source.

    Expectation: light within circles of 1.5 to 23.5 px radius about the centre, as a share of that in a frame of 72 px.

    Limit: 0.03, the largest difference over depths and radii, for G and IR.

    Source: the kernel is |FT of the defocused pupil|^2; Goodman, Introduction to Fourier Optics, ch. 6.
    """
    rendering.needs_wave()
    camera = cameras.cropped(cameras.load_camera("da-mobile"), ENERGY_FRAME_PX, ENERGY_FRAME_PX)
    found = np.empty((ENERGY_SEEDS, len(ENERGY_BLUR_PX), 2, len(ENERGY_RADII_PX)))
    expected = np.empty(found.shape[1:])
    for index, blur in enumerate(ENERGY_BLUR_PX):
        depth = rendering.depth_m(camera, blur)
        radius_cm = SOURCE_RADIUS_PX * rendering.pixel_at_m(camera, depth) * 100
        disc = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": [0, 0, depth * 100]}
        scene = rendering.make_scene([disc | {"material": "white-paper"}])
        for seed in range(ENERGY_SEEDS):
            stops = rendering.stop_pictures(scene, camera, ENERGY_SPP, seed, diffraction="wave", max_blur_px=blur + 1)
            for place, channel in enumerate(ENERGY_CHANNELS):
                found[seed, index, place] = encircled(stops.sum(axis=0)[..., CHANNELS.index(channel)])
            progress((index + (seed + 1) / (ENERGY_SEEDS + 1)) / len(ENERGY_BLUR_PX))
        for place, channel in enumerate(ENERGY_CHANNELS):
            expected[index, place] = encircled(_spread_source(camera, depth, channel))
    error = found.mean(axis=0) - expected
    figures = []
    for place, channel in enumerate(ENERGY_CHANNELS):
        at = np.unravel_index(np.abs(error[:, place]).argmax(), error[:, place].shape)
        what = f"{channel}: largest difference of encircled energy over 3 depths and all radii"
        what += f" (at {ENERGY_BLUR_PX[at[0]]:g} px of blur, radius {ENERGY_RADII_PX[at[1]]:g} px)"
        figures.append(Figure(channel, float(np.abs(error[:, place]).max()), "1", what))
    noise = found.std(axis=0, ddof=1).max() / np.sqrt(ENERGY_SEEDS)
    figures.append(Figure("noise", float(noise), "1", "largest standard error of an encircled energy, from the seeds"))
    return Evidence(
        figures, [("Encircled energy: rendered (points) and dasim.psf (lines)", _energy_plot(found, expected))]
    )


def encircled(picture: FloatArray) -> FloatArray:
    """Share of a square frame's light within ``ENERGY_RADII_PX`` about its centre."""
    y, x = np.indices(picture.shape) + 0.5
    distance = np.hypot(y - picture.shape[0] / 2, x - picture.shape[1] / 2)
    return np.array([picture[distance <= radius].sum() for radius in ENERGY_RADII_PX]) / picture.sum()


def _spread_source(camera: Camera, depth_m: float, channel: str) -> FloatArray:
    """``dasim.psf`` summed over the source's disc, [frame, frame]; the frame's centre lies between pixels."""
    cells = np.arange(-SOURCE_RADIUS_PX, SOURCE_RADIUS_PX, 1 / FINE) + 0.5 / FINE
    half = ENERGY_FRAME_PX // 2
    size = ENERGY_FRAME_PX + 2 * int(np.ceil(SOURCE_RADIUS_PX)) + 3
    middle = size // 2
    kernels: dict[tuple[float, float], FloatArray] = {}
    total = np.zeros((ENERGY_FRAME_PX, ENERGY_FRAME_PX))
    for y, x in itertools.product(cells, cells):
        if np.hypot(y, x) > SOURCE_RADIUS_PX:
            continue
        # The frame's centre is the corner that pixels half - 1 and half share.
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
    """A centred stop's kernel at an offset, from the one at the positive, ordered offset by mirrors."""
    small, large = sorted(abs(value) for value in offset)
    key = (round(small, 6), round(large, 6))
    if key not in kernels:
        kernels[key] = dasim.psf(camera, depth_m, channel, "D65", offset_px=(small, large), size=size)
    kernel = kernels[key] if abs(offset[0]) <= abs(offset[1]) else kernels[key].T
    return kernel[:: 1 if offset[0] > 0 else -1, :: 1 if offset[1] > 0 else -1]


def _energy_plot(found: FloatArray, expected: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for index, panel in enumerate(axes):
            for place, channel in enumerate(ENERGY_CHANNELS):
                colour = CHANNEL_COLOURS[channel]
                panel.plot(ENERGY_RADII_PX, expected[index, place], color=colour)
                panel.plot(ENERGY_RADII_PX, found[:, index, place].mean(axis=0), "o", ms=3, color=colour, label=channel)
            panel.set(title=f"visible blur {ENERGY_BLUR_PX[index]:g} px", xlabel="radius in px", ylim=(0, 1.05))
        axes[0].legend()

    return plot(draw, columns=len(ENERGY_BLUR_PX), size=(3.4, 3.0))


# --- the approximation of scalar_spectral --------------------------------------------------------


def airy_table(progress: ShareDone) -> Evidence:
    """What the approximation ``airy`` (blur disc convolved with the in-focus Airy pattern) is off by, at every level.

    Rationale: ``scalar_spectral`` renders ``airy``; who uses it should know by how much it is wrong.

    Set-up: the radial kernels of both models (``camera.pointspread``) for da-mobile under D65, the 29 blur levels,
    four channels.

    Expectation: for each level and channel the largest difference of encircled energy over all radii, and of MTF
    (with the pixel, along a row) over 0.02 to 0.5 cycles a pixel. Reported, without a limit.

    Source: both models as in ``dasim.camera.pointspread``; the defocused pupil of Goodman, ch. 6.
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
    return Evidence(figures, tables=[("Largest error of 'airy' by level and channel", head, rows)])
