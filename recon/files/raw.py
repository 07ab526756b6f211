"""Raw mosaics from real cameras: DNG, 16-bit PNG, TIFF and NPY files, and packed pixels without a header.

Black level, bit depth, full well, noise and mosaic are those of the camera's TOML file; a DNG of dasim holds its
camera. The picture's top left pixel is the first of ``mosaic``. The size of the picture overrides that of the sensor,
except for packed pixels, which have no header.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import parse
from dasim.camera.noise import Exposure
from dasim.camera.sensor import Sensor
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture
from dasim.values import Capture
from recon.files import dng_reading

UInt16Array = NDArray[np.uint16]

# Files without a header: bits per pixel, pixels per group, bytes per group. MIPI CSI-2, sec. "RAW10", "RAW12".
PACKED = {"raw10": (10, 4, 5), "raw12": (12, 2, 3), "raw16": (16, 1, 2)}
LEFT_ALIGNED = "left-aligned"  # PNG, TIFF or NPY with values shifted to the most significant of 16 bits
FORMATS = (*PACKED, LEFT_ALIGNED)
MOST_ROW_PADDING = 256  # largest padding of a row by a driver, bytes
ONE_NUMBER = "a raw mosaic has one number per pixel, [rows, columns]"
DEFAULT_EXPOSURE_S = 0.01  # for an unknown exposure time, on which the dark signal alone depends


def load_input(
    path: Path,
    camera: Camera | None = None,
    *,
    kind: str | None = None,
    exposure_s: float | None = None,
    gain: float | None = None,
) -> Capture:
    """A capture from its folder, from a DNG of dasim, or from a raw file and a camera (see :func:`load_raw`)."""
    options = {"--camera": camera, "--format": kind, "--exposure": exposure_s, "--gain": gain}
    if path.is_file() and (camera is not None or path.suffix.lower() == ".dng"):
        return load_raw(path, camera, kind=kind, exposure_s=exposure_s, gain=gain)
    if path.is_file():
        raise InputError(
            f"capture {path}: is a file; give its camera with --camera (see 'dasim list cameras', or a TOML file), "
            "or give the folder of a capture"
        )
    capture = load_capture(path)
    extra = [name for name, value in options.items() if value is not None]
    if extra:
        raise InputError(f"{extra[0]}: capture {path} is a folder that contains it; leave it out")
    return capture


def load_raw(
    path: Path,
    camera: Camera | None,
    *,
    kind: str | None = None,
    exposure_s: float | None = None,
    gain: float | None = None,
) -> Capture:
    """A capture from a raw mosaic file.

    Args:
        path: the file.
        camera: gives black level, bit depth, full well, noise and mosaic; None for that of a DNG of dasim.
        kind: one of ``FORMATS``: ``raw10``, ``raw12`` (MIPI packing) and ``raw16`` (little-endian) for files without a
            header, ``left-aligned`` for values shifted to the most significant of 16 bits. By default DNG, PNG, TIFF or
            NPY, by the suffix.
        exposure_s: exposure time, seconds; by default that of a DNG.
        gain: analogue gain, a factor on the camera's; by default that of a DNG that dasim wrote.
    """
    if kind is not None and kind not in FORMATS:
        raise InputError(f"--format '{kind}' is unknown; allowed are {', '.join(FORMATS)}{did_you_mean(kind, FORMATS)}")
    if not path.is_file():
        raise InputError(f"raw picture {path}: no such file")
    if path.suffix.lower() == ".dng" and kind is None:
        return _from_dng(path, camera, exposure_s, gain)
    if camera is None:
        raise InputError(f"raw picture {path}: holds no camera; give it with --camera")
    exposure = _exposure(exposure_s, gain)
    if kind in PACKED:
        raw = _unpacked(path, camera, kind)
    else:
        raw = _numbers(_decoded(path), path, camera, left_aligned=kind == LEFT_ALIGNED)
    return _capture(path, raw, camera, exposure)


def _from_dng(path: Path, camera: Camera | None, exposure_s: float | None, gain: float | None) -> Capture:
    """A capture from a DNG; options that are given take precedence over its tags."""
    found = dng_reading.read_mosaic(path)
    own = found.private
    used = camera or (own.camera if own else None)
    if used is None:
        raise InputError(f"raw picture {path}: is not a DNG that dasim wrote; give its camera with --camera")
    dng_reading.check_fits(found, used, f"raw picture {path}")
    stated_s, stated_gain = (own.exposure_s, own.gain) if own else (found.exposure_s, None)
    exposure = _exposure(
        stated_s if exposure_s is None else exposure_s,
        stated_gain if gain is None else gain,
        "--exposure or --gain" if exposure_s is not None or gain is not None else f"raw picture {path}: its exposure",
    )
    numbers = dng_reading.with_saturation(_numbers(found.raw, path, used, left_aligned=False), found, used)
    capture = _capture(path, numbers, used, exposure)
    if camera is not None or own is None:
        return capture
    return replace(capture, provenance={"diffraction": own.diffraction or "wave"})


def _exposure(exposure_s: float | None, gain: float | None, where: str = "--exposure or --gain") -> Exposure:
    stated = {"time_s": DEFAULT_EXPOSURE_S if exposure_s is None else exposure_s, "gain": 1.0 if gain is None else gain}
    return parse(Exposure, stated, where)


def _capture(path: Path, raw: UInt16Array, camera: Camera, exposure: Exposure) -> Capture:
    """The capture of raw numbers [h, w], whose size overrides that of the camera."""
    height, width = raw.shape
    changed = camera.sensor.model_dump() | {"width_px": width, "height_px": height}
    if (width, height) != (camera.sensor.width_px, camera.sensor.height_px) and camera.sensor.principal_point_px:
        raise InputError(
            f"raw picture {path}: {width}x{height} pixels, but camera '{camera.name}' has its principal_point_px in a "
            f"frame of {camera.sensor.width_px}x{camera.sensor.height_px}; correct both for pictures of this size"
        )
    sensor = parse(Sensor, changed, f"raw picture {path} with camera '{camera.name}'")
    if raw.max() < sensor.black_level_dn:
        raise InputError(
            f"raw picture {path}: all pixels are below the black level of {sensor.black_level_dn} DN of camera "
            f"'{camera.name}' (largest {raw.max()}); correct black_level_dn, or give a picture that is not black-level "
            "corrected"
        )
    assert exposure.time_s is not None
    return Capture(
        raw_dn=raw,
        camera=camera.model_copy(update={"sensor": sensor}),
        exposure_s=exposure.time_s,
        gain=exposure.gain,
        seed=0,
        provenance={"raw_file": path.name},
    )


def _decoded(path: Path) -> NDArray:
    """Unprocessed values of a PNG, TIFF or NPY file."""
    suffix = path.suffix.lower()
    if suffix not in (".png", ".tif", ".tiff", ".npy"):
        raise InputError(
            f"raw picture {path}: '{suffix}' files are not supported; give .dng, .png, .tif or .npy, or for packed "
            f"pixels --format {'|'.join(PACKED)}"
        )
    try:
        if suffix == ".npy":
            return untrusted.array(path, f"raw picture {path}")
        if suffix == ".png":
            return untrusted.picture(path, f"raw picture {path}", cv2.IMREAD_UNCHANGED)
        return _tiff(path, f"raw picture {path}")
    except InputError:
        raise
    except Exception as error:  # each library raises exceptions of its own
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"raw picture {path}: cannot be read ({text})") from None


def _tiff(path: Path, where: str) -> NDArray:
    """Unprocessed values of a TIFF file with one picture, or with smaller ones after it."""
    import tifffile

    untrusted.check_file(path, where)
    with untrusted.quiet(), tifffile.TiffFile(path) as file:
        page = file.pages.first
        for size_px in ((page.imagewidth, page.imagelength), (page.tilewidth, page.tilelength)):
            untrusted.check_pixels(size_px, where)
        if len(page.shape) != 2:
            raise InputError(f"{where}: has the shape {page.shape}; {ONE_NUMBER}")
        if _second(file) == page.shape:
            raise InputError(f"{where}: holds several pictures; {ONE_NUMBER}")
        if page.compression == tifffile.COMPRESSION.NONE:
            return np.asarray(page.asarray())
    # tifffile alone reads no LZW and no predictors; OpenCV does
    return untrusted.picture(path, where, cv2.IMREAD_UNCHANGED)


def _second(file: Any) -> tuple[int, ...] | None:
    """Shape of the second picture of a TIFF file, if it has one; the others are skipped: they may form a loop."""
    try:
        return tuple(file.pages[1].shape)
    except IndexError:
        return None


def _numbers(image: NDArray, path: Path, camera: Camera, *, left_aligned: bool) -> UInt16Array:
    """Raw values within the camera's bit depth; raises InputError for others."""
    bits = camera.sensor.adc_bits
    if image.ndim != 2:
        raise InputError(f"raw picture {path}: has the shape {image.shape}; {ONE_NUMBER}")
    if image.dtype.kind == "f":
        if not np.isfinite(image).all():
            raise InputError(
                f"raw picture {path}: has NaN or infinite values; give whole numbers from 0 to {2**bits - 1}"
            )
        if (image != np.rint(image)).any():
            raise InputError(f"raw picture {path}: has fractions; give whole numbers from 0 to {2**bits - 1}")
    elif image.dtype.kind not in "ui":
        raise InputError(f"raw picture {path}: holds {image.dtype}; give 16-bit whole numbers")
    if image.dtype.itemsize == 1 and bits > 8:
        raise InputError(
            f"raw picture {path}: has 8 bits, camera '{camera.name}' has {bits}; save 16-bit raw values, "
            "or give the right camera"
        )
    low, high = (image.min(), image.max()) if image.size else (0, 0)
    shift = 16 - bits
    if left_aligned and high < 2**16 and low >= 0:
        image = image.astype(np.uint16)
        if np.any(image & np.uint16(2**shift - 1)):
            raise InputError(
                f"raw picture {path}: is not left-aligned for the {bits} bits of camera '{camera.name}': "
                f"the lowest {shift} bits are in use; leave --format out or correct adc_bits"
            )
        return image >> np.uint16(shift)
    if low < 0 or high >= 2**bits:
        aligned = 0 <= low and high < 2**16 and not np.any(image.astype(np.uint16) & np.uint16(2**shift - 1))
        hint = (
            f"its values are left-aligned: add --format {LEFT_ALIGNED}" if aligned else "correct adc_bits of the camera"
        )
        raise InputError(
            f"raw picture {path}: has values of {low:g} to {high:g}, camera '{camera.name}' has {bits} bits, "
            f"0 to {2**bits - 1}; {hint}"
        )
    return image.astype(np.uint16)


def _unpacked(path: Path, camera: Camera, kind: str) -> UInt16Array:
    """Raw values of a file without a header, [h, w]; each row may have some bytes of padding."""
    bits, group, group_bytes = PACKED[kind]
    sensor = camera.sensor
    height, width = sensor.height_px, sensor.width_px
    if kind != "raw16" and sensor.adc_bits != bits:
        raise InputError(
            f"--format {kind} has {bits} bits, camera '{camera.name}' has {sensor.adc_bits}; correct one of them"
        )
    if width % group:
        raise InputError(
            f"--format {kind}: the width of {width} px is not a multiple of {group}; correct the camera's width_px"
        )
    row = width // group * group_bytes
    data = np.fromfile(path, np.uint8)
    stride = data.size // height
    if data.size % height or not row <= stride <= row + MOST_ROW_PADDING:
        raise InputError(
            f"raw picture {path}: has {data.size} bytes, {width} x {height} pixels of {kind} have {row * height} "
            f"(or up to {MOST_ROW_PADDING} more per row); correct width_px and height_px of camera '{camera.name}'"
        )
    parts = data.reshape(height, stride)[:, :row].reshape(height, width // group, group_bytes).astype(np.uint16)
    if kind == "raw10":  # four bytes of high bits, then one with four pairs of low bits, the first pixel in the lowest
        values = parts[..., :4] << 2 | parts[..., 4:] >> np.array([0, 2, 4, 6], np.uint16) & 3
    elif kind == "raw12":  # two bytes of high bits, then one with two low halves
        values = parts[..., :2] << 4 | parts[..., 2:] >> np.array([0, 4], np.uint16) & 15
    else:
        values = parts[..., :1] | parts[..., 1:] << 8
    return _numbers(values.reshape(height, width), path, camera, left_aligned=False)
