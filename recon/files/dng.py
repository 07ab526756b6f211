"""Captures as DNG (Adobe Digital Negative 1.4, a TIFF): the mosaic as it is, and developed linear colours.

The mosaic has the pattern of the colour filters, black and white level, noise profile, colour matrices and exposure.
Limits of the standard: it has no colour code for infrared, which is stored as white (code 6); its colour matrices map
from XYZ, which does not depend on infrared light; its noise profile has no term for PRNU; and it cannot describe two
apertures or blur levels. ``DNGPrivateData`` holds these: the camera as JSON, without scene and light.

The linear file has red, green and blue without infrared, which raw developers open, and infrared as a second page.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic
from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.radiometry import response
from dasim.camera.sensor import channels
from dasim.spectra import colour as colours
from dasim.typing import FloatArray
from dasim.values import Capture, Developed
from recon.picture import colour, mosaic
from recon.picture.develop import LIGHTS
from recon.picture.infrared import light_power

PRIVATE = b"dasim\0"  # start of DNGPrivateData
CFA, LINEAR_RAW = 32803, 34892  # photometric interpretations
FILTERS = {"R": 0, "G": 1, "B": 2, "IR": 6}  # codes of CFAPattern; 6 is white
ILLUMINANTS = {"D65": 21, "D55": 20, "A": 17, "energy-saving-3500K": 15}  # EXIF LightSource
OTHER_LIGHT = 255
LINEAR_BLACK_DN = 1024  # of the linear pages: values below zero, which noise has, are kept

Tag = tuple[int, int | str, int | None, Any, bool]  # of tifffile: code, type, count, value, written once
BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 10, 12


class Linear(NamedTuple):
    """Pages of a linear DNG: black is ``LINEAR_BLACK_DN``, and ``dn_per_e`` numbers stand for an electron."""

    rgb: NDArray[np.uint16]  # [h, w, 3]
    ir: NDArray[np.uint16] | None  # [h, w]
    dn_per_e: float


def write_dng(path: Path, capture: Capture) -> None:
    """Write the mosaic of a capture as a DNG, atomically; InputError where a channel has no code in DNG."""
    camera = capture.camera
    sensor, names = camera.sensor, channels(camera.sensor)
    if unknown := [name for name in names if name not in FILTERS]:
        raise InputError(f"camera '{camera.name}': DNG has no filter for channel {unknown[0]}; it has R, G, B and IR")
    pattern = [FILTERS[name] for row in sensor.mosaic for name in row]
    step_e = noise.electrons_per_dn(sensor, capture.gain)
    white = min(2**sensor.adc_bits - 1, sensor.black_level_dn + int(noise.saturation_e(sensor, capture.gain) / step_e))
    raw_e, saturated = mosaic.linearise(capture)
    signature = colour.signatures(camera, LIGHTS)
    neutral = signature[colour.choose_light(raw_e, saturated, camera, LIGHTS, signature)]
    tags = [
        *_about(capture),
        (33421, SHORT, 2, (len(sensor.mosaic), len(sensor.mosaic[0])), True),  # CFARepeatPatternDim
        (33422, BYTE, len(pattern), bytes(pattern), True),  # CFAPattern
        (50710, BYTE, len(names), bytes(FILTERS[name] for name in names), True),  # CFAPlaneColor
        (50711, SHORT, 1, 1, True),  # CFALayout: rectangular
        (50714, SHORT, 1, sensor.black_level_dn, True),  # BlackLevel
        (50717, SHORT, 1, white, True),  # WhiteLevel
        (51041, DOUBLE, 2, noise_profile(capture, white), True),  # NoiseProfile
        _matrix(50721, colours.fitted_from_xyz(response(camera), light_power("A"))),  # ColorMatrix1
        (50778, SHORT, 1, ILLUMINANTS["A"], True),  # CalibrationIlluminant1
        _matrix(50722, colours.fitted_from_xyz(response(camera), light_power("D65"))),  # ColorMatrix2
        (50779, SHORT, 1, ILLUMINANTS["D65"], True),  # CalibrationIlluminant2
        _rationals(50728, neutral / neutral.max()),  # AsShotNeutral
        _private(capture),
    ]
    _write(path, [(capture.raw_dn, CFA, 0, tags)])


def noise_profile(capture: Capture, white_dn: int) -> tuple[float, float]:
    """(S, O) of DNG's noise profile: the variance S x + O of a signal x from 0, black, to 1, ``white_dn``.

    It is that of one frame with its fixed pattern, without PRNU, whose variance rises with the square of x.
    """
    sensor = capture.camera.sensor
    full_e = (white_dn - sensor.black_level_dn) * noise.electrons_per_dn(sensor, capture.gain)
    variance = noise.variance(sensor, capture.exposure_s, capture.gain)
    return variance.linear / full_e, variance.constant / full_e**2


def write_linear_dng(path: Path, capture: Capture, developed: Developed) -> None:
    """Write the developed colours of a capture, linear and without infrared, as a DNG; infrared as its second page.

    Its colour matrix is that of the development for the light that white balance chose, so that the picture of a raw
    developer has the colours of :func:`recon.develop`.
    """
    pages = linear_pages(developed, noise.saturation_e(capture.camera.sensor, capture.gain))
    white = colours.white_xyz(light_power(developed.light))
    from_xyz = np.linalg.inv(developed.matrix) @ colours.to_srgb_matrix(white)
    neutral = np.linalg.solve(developed.matrix, np.ones(3))
    levels: list[Tag] = [
        (50714, SHORT, 3, (LINEAR_BLACK_DN,) * 3, True),
        (50717, SHORT, 3, (2**16 - 1,) * 3, True),
    ]
    tags = [
        *_about(capture),
        *levels,
        _matrix(50721, from_xyz / (from_xyz @ white).max()),
        (50778, SHORT, 1, ILLUMINANTS.get(developed.light, OTHER_LIGHT), True),
        _rationals(50728, neutral / neutral.max()),
    ]
    written = [(pages.rgb, LINEAR_RAW, 0, tags)]
    if pages.ir is not None:
        text = f"near-infrared, linear: {LINEAR_BLACK_DN} is black, {pages.dn_per_e:.6g} DN per electron, as in page 1"
        written.append((pages.ir, 1, 2, [(270, ASCII, None, text, True)]))  # a page of several, no raw picture
    _write(path, written)


def linear_pages(developed: Developed, saturation_e: float) -> Linear:
    """Numbers of the linear pages; their largest is that of ``saturation_e``, or of the brightest value above it."""
    parts = [developed.linear_e, *([] if developed.ir_e is None else [developed.ir_e])]
    dn_per_e = (2**16 - 1 - LINEAR_BLACK_DN) / max(saturation_e, *(float(part.max()) for part in parts))
    stored = [np.clip(np.rint(LINEAR_BLACK_DN + part * dn_per_e), 0, 2**16 - 1).astype(np.uint16) for part in parts]
    return Linear(stored[0], stored[1] if len(stored) > 1 else None, dn_per_e)


# --- tags ----------------------------------------------------------------------------------------


def _about(capture: Capture) -> list[Tag]:
    """Tags of both kinds of file: version, camera and exposure."""
    camera = capture.camera
    name = camera.name.encode("ascii", "replace").decode()
    return [
        (50706, BYTE, 4, bytes((1, 4, 0, 0)), True),  # DNGVersion
        (50707, BYTE, 4, bytes((1, 1, 0, 0)), True),  # DNGBackwardVersion
        (271, ASCII, None, "dasim", True),  # Make
        (272, ASCII, None, name, True),  # Model
        (50708, ASCII, None, f"dasim {name}", True),  # UniqueCameraModel
        (274, SHORT, 1, 1, True),  # Orientation: as it is
        _rationals(33434, [capture.exposure_s]),  # ExposureTime, seconds
        _rationals(33437, [camera.lens.f_number]),  # FNumber
        _rationals(37386, [camera.lens.focal_length_mm]),  # FocalLength, mm
        _rationals(37382, [camera.lens.focus_distance_m]),  # SubjectDistance, m
    ]


def _private(capture: Capture) -> Tag:
    """DNGPrivateData: what a reconstruction needs, and no truth."""
    data = {
        "camera": capture.camera.model_dump(mode="json"),
        "exposure_s": capture.exposure_s,
        "gain": capture.gain,
        "seed": capture.seed,
        "diffraction": capture.provenance.get("diffraction"),
    }
    content = PRIVATE + json.dumps(data).encode()
    return 50740, BYTE, len(content), content, True


def _rationals(code: int, values: Sequence[float] | FloatArray, kind: int = RATIONAL) -> Tag:
    parts = [part for value in values for part in _fraction(float(value))]
    return code, kind, len(values), tuple(parts), True


def _fraction(value: float) -> tuple[int, int]:
    """Numerator and denominator of 32 bits; values beyond them become the largest or smallest fraction."""
    most = 2**31 - 1
    near = Fraction(min(max(value, -most), most)).limit_denominator(max(int(most / max(1.0, math.ceil(abs(value)))), 1))
    return near.numerator, near.denominator


def _matrix(code: int, matrix: FloatArray) -> Tag:
    """A colour matrix [channel, 3], with four decimals as in most cameras' files or better."""
    return _rationals(code, np.round(matrix, 6).ravel(), SRATIONAL)


def _write(path: Path, pages: Sequence[tuple[NDArray[np.uint16], int, int, list[Tag]]]) -> None:
    import tifffile

    buffer = io.BytesIO()
    with tifffile.TiffWriter(buffer, byteorder="<") as file:
        for image, photometric, kind, tags in pages:
            file.write(
                image,
                photometric=photometric,
                subfiletype=kind,
                extratags=tags,
                metadata=None,
                software="dasim",
                contiguous=False,
                planarconfig="contig" if image.ndim == 3 else None,
            )
    atomic.write(path, buffer.getvalue())
