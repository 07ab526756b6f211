"""Claim on lights of different spectra: interpolated irradiance against traced light."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import dasim
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import mixed_room, rendering

BLOCK_PX = 8

MITSUBA = "mitsuba-F11"
CASES = (*mixed_room.LIGHTS, MITSUBA)

_XML = """<scene version="3.0.0">
  <sensor type="perspective"/>
  <bsdf type="diffuse" id="paper"><spectrum name="reflectance" value="0.8"/></bsdf>
  <bsdf type="diffuse" id="wood"><spectrum name="reflectance" value="400:0.2, 550:0.45, 830:0.75"/></bsdf>
  <bsdf type="diffuse" id="cloth"><spectrum name="reflectance" value="400:0.05, 580:0.06, 640:0.5, 830:0.7"/></bsdf>
  <bsdf type="diffuse" id="leaf"><spectrum name="reflectance" value="400:0.05, 550:0.15, 680:0.06, 740:0.5, 830:0.5"/>
  </bsdf>
  <shape type="rectangle" id="wall"><ref id="wood"/><transform name="to_world">
    <scale value="0.45"/><rotate y="1" angle="180"/><translate z="0.45"/></transform></shape>
  <shape type="rectangle" id="floor"><ref id="cloth"/><transform name="to_world">
    <scale value="0.45"/><rotate x="1" angle="-90"/><translate y="-0.12" z="0.3"/></transform></shape>
  <shape type="sphere" id="ball"><ref id="leaf"/><point name="center" x="0.07" y="-0.06" z="0.34"/>
    <float name="radius" value="0.05"/></shape>
  <shape type="rectangle" id="ceiling"><ref id="paper"/><transform name="to_world">
    <scale value="0.45"/><rotate x="1" angle="90"/><translate y="0.4" z="0.3"/></transform></shape>
  <shape type="rectangle" id="lamp"><transform name="to_world">
    <scale value="0.03"/><rotate x="1" angle="-90"/><translate y="0.15" z="0.3"/></transform>
    <emitter type="area"><spectrum name="radiance" value="F11"/></emitter></shape>
</scene>
"""


def mixed_lights(progress: ShareDone) -> Evidence:
    """Lights of different spectra give the pictures that tracing all light gives.

    Rationale: irradiance from domes and from other surfaces is interpolated over wavelength relative to the spectrum of
    its source. If one spectrum served for all sources, the spectral lines of a lamp would appear in the light of a
    dome: with a D65 dome and an F11 lamp, colours would be off by a tenth.

    Set-up: a table before a wall below a ceiling, with a ball and a card, in four lights: a D65 dome with an F11 lamp
    that shines at the ceiling, an energy-saving dome with a D65 lamp, a D65 dome with an A lamp, and daylight, whose
    sun and sky differ; and a similar Mitsuba scene, whose only lamp has the F11 spectrum of the CIE's table at 5 nm.
    The camera is da-mobile with 96 x 72 coarse pixels, diffraction off. Eight captures of 256 samples per pixel
    (``mean_e`` of ``dasim.simulate``), because most of their noise is that of the irradiance field, which each capture
    samples anew: 0.19 % of the mean of red under the F11 lamp, whatever the number of samples. Four renders of 1,024
    samples without any interpolation.

    Expectation: means over blocks of 8 x 8 pixels agree within rendering noise. The noise is estimated from the
    scatter of the pictures, and its variance is subtracted from the mean square difference.

    Limit: 0.5 % for the root mean square of the blocks' relative differences, 0.2 % for the mean of the picture.

    Source: path tracing of the same scene.
    """
    if rendering.activate().startswith("scalar"):
        raise rendering.NotRun("only scalar_spectral works here, which traces all light; install LLVM 17 or newer")
    camera = mixed_room.camera("da-mobile")
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(CASES):
            figures += _figures(name, _scene(name, Path(folder)), camera)
            progress((number + 1) / len(CASES))
    return Evidence(figures)


def _scene(name: str, folder: Path) -> Scene | MitsubaScene:
    """The scene of a case; the Mitsuba scene is a file in ``folder``."""
    if name != MITSUBA:
        return rendering.make_scene(mixed_room.OBJECTS, mixed_room.LIGHTS[name])
    (folder / "lamp.xml").write_text(_XML.replace("F11", _f11()))
    return dasim.load_scene(folder / "lamp.xml")


def _f11() -> str:
    """CIE F11 as Mitsuba's files have spectra, constant from the table's end at 780 nm."""
    import colour

    table = colour.SDS_ILLUMINANTS["FL11"]
    pairs = [*zip(table.wavelengths, table.values, strict=True), (830.0, table.values[-1])]
    return ", ".join(f"{nm:g}:{value:g}" for nm, value in pairs)


def _figures(name: str, scene: Scene | MitsubaScene, camera: Camera) -> list[Figure]:
    """Differences of a scene's captures from its traced pictures."""
    (ours, ours_noise), (traced, traced_noise) = map(_mean, mixed_room.pictures(scene, camera))
    difference = ours / traced - 1
    noise = (ours_noise**2 + traced_noise**2) / traced**2
    figures = []
    for channel, colour in enumerate(channels(camera.sensor)):
        square, error = float(np.mean(difference[..., channel] ** 2)), float(np.mean(noise[..., channel]))
        rms = max(square - error, 0.0) ** 0.5
        mean = float(ours[..., channel].mean() / traced[..., channel].mean() - 1)
        rms_text = f"{name}, {colour}: RMS relative difference of block means, noise variance subtracted"
        figures.append(Figure(f"{name}.rms.{colour}", rms, "1", rms_text))
        noise_text = f"{name}, {colour}: RMS noise of that difference"
        figures.append(Figure(f"{name}.noise.{colour}", error**0.5, "1", noise_text))
        mean_text = f"{name}, {colour}: relative difference of the picture's mean"
        figures.append(Figure(f"{name}.mean.{colour}", mean, "1", mean_text))
    return figures


def _mean(pictures: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Mean of pictures over square blocks of ``BLOCK_PX``, and its standard error, [block, block, channel]."""
    blocks = np.stack([rendering.block_means(picture, BLOCK_PX) for picture in pictures])
    return blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
