"""Reconstructions on disk: PNG pictures, an EXR file with all numbers, and the settings.

Tested in tests/dasim/cli/test_recon.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic, untrusted
from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import parse
from dasim.camera.specification import Camera
from dasim.files.exr import write_exr
from dasim.files.folders import new_folder, software_versions
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.values import Developed, Reconstruction
from recon.picture import colour, infrared
from recon.settings import Settings, preset_name
from recon.views import anaglyph, maps, surface

RECON_SCHEMA = 1
EXTRAS = ("anaglyph", "stereo", "ply", "glb")
STRONGEST_SHIFT = 0.02  # largest shift between the eyes, relative to the width; comfortable on a screen
_RGB = ("R", "G", "B")
_COLOURS = ("rgb", "sharp_rgb", "linear_e", "sharp_e")
_PLANES = ("ir_e", "level_raw", "level", "confidence")


def check_extras(extras: Sequence[str]) -> None:
    """Raise InputError for an unknown extra picture."""
    for name in extras:
        if name not in EXTRAS:
            raise InputError(f"--also '{name}' is unknown; allowed are {', '.join(EXTRAS)}{did_you_mean(name, EXTRAS)}")


def save_reconstruction(
    path: Path, result: Reconstruction, extras: Sequence[str] = (), *, raw_dn: NDArray[Any] | None = None
) -> tuple[str, ...]:
    """Write ``rgb.png``, ``sharp.png``, ``ir.png``, ``recon.exr`` (``Z`` is the depth in metres) and ``meta.json``.

    To look at: ``depth.png`` with its scale in cm, ``confidence.png``, and of the capture's ``raw_dn`` [h, w]
    ``mosaic.png``, each pixel in the colour of its filter.
    ``extras`` from ``EXTRAS`` adds ``anaglyph.png``, ``stereo.png`` (the left eye's picture on the left),
    ``surface.ply`` or ``surface.glb``, all from the all-in-focus picture. Where no surface is known well enough, it is
    left out, and a note in ``meta.json`` says so.

    Returns the notes of ``meta.json``: those of the result, and what was left out. Raises InputError for an unknown
    extra.
    """
    check_extras(extras)
    parts = [_part("depth", {"Z": result.depth_m})]
    parts += [_part(name, {name: getattr(result, name)}) for name in _PLANES]
    parts += [_part(name, {c: getattr(result, name)[..., i] for i, c in enumerate(_RGB)}) for name in _COLOURS]
    about = _about(result) | {"bank": result.bank}
    about |= {"method": result.method, "side": result.side}
    with new_folder(path, "reconstruction") as folder:
        write_picture(folder / "rgb.png", result.rgb)
        write_picture(folder / "sharp.png", result.sharp_rgb)
        write_picture(folder / "ir.png", grey(result.ir_e))
        write_picture(folder / "depth.png", maps.depth_picture(result.depth_m) / 255)
        write_picture(folder / "confidence.png", maps.confidence_picture(result.confidence) / 255)
        if raw_dn is not None:
            write_picture(folder / "mosaic.png", maps.coloured_mosaic(raw_dn, result.camera.sensor))
        write_exr(folder / "recon.exr", parts)
        notes = (*result.notes, *_write_extras(folder, result, extras))
        about |= {"notes": list(notes)}
        (folder / "meta.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    return notes


def _write_extras(folder: Path, result: Reconstruction, extras: Sequence[str]) -> list[str]:
    """Write the requested extra files; returns notes on those left out."""
    notes = []
    picture, depth_m = result.sharp_rgb, result.depth_m
    if {"anaglyph", "stereo"} & set(extras):
        left, right = anaglyph.pair(picture, depth_m, STRONGEST_SHIFT * picture.shape[1])
        if "anaglyph" in extras:
            write_picture(folder / "anaglyph.png", anaglyph.anaglyph(left, right))
        if "stereo" in extras:
            write_picture(folder / "stereo.png", anaglyph.side_by_side(left, right))
    for suffix in {"ply", "glb"} & set(extras):
        distortion = surface.distortion_per_px(result.camera)
        intrinsic = surface.intrinsic_matrix(result.camera)
        mesh = surface.surface(
            picture, depth_m, intrinsic, confidence=result.confidence, distortion_per_px=distortion,
            smallest_piece=surface.SMALLEST_PIECE,
        )  # fmt: skip
        if len(mesh.triangle):
            surface.save_surface(folder / f"surface.{suffix}", mesh)
        else:
            notes.append(f"surface.{suffix} was left out: no neighbouring pixels have a confident depth")
    return notes


def save_picture(path: Path, picture: Developed, *, raw_dn: NDArray[Any] | None = None) -> None:
    """Write a developed picture without depth: ``rgb.png``, ``recon.exr`` and ``meta.json``; ``mosaic.png`` of the
    capture's ``raw_dn`` [h, w], each pixel in the colour of its filter.
    """
    colours = {"rgb": picture.rgb, "linear_e": picture.linear_e}
    parts = [_part(name, {c: image[..., i] for i, c in enumerate(_RGB)}) for name, image in colours.items()]
    if picture.ir_e is not None:
        parts.append(_part("ir_e", {"ir_e": picture.ir_e}))
    about = _about(picture) | {"picture_only": True}
    with new_folder(path, "reconstruction") as folder:
        write_picture(folder / "rgb.png", picture.rgb)
        if picture.ir_e is not None:
            write_picture(folder / "ir.png", grey(picture.ir_e))
        if raw_dn is not None:
            write_picture(folder / "mosaic.png", maps.coloured_mosaic(raw_dn, picture.camera.sensor))
        write_exr(folder / "recon.exr", parts)
        (folder / "meta.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def load_reconstruction(path: Path) -> Reconstruction:
    """Read a reconstruction folder; raises InputError if it is missing, damaged or of another kind."""
    import OpenEXR

    path = Path(path)
    for name in ("meta.json", "recon.exr"):
        if not (path / name).is_file():
            raise InputError(f"reconstruction {path}: has no {name}; make one with 'dasim recon CAPTURE --out DIR'")
    try:
        about = untrusted.json_object(path / "meta.json", str(path / "meta.json"))
        untrusted.check_exr(path / "recon.exr", str(path / "recon.exr"))
        if about.get("picture_only"):
            raise InputError(
                f"reconstruction {path}: is a colour picture with no depth, because its camera has no infrared pixels"
            )
        with untrusted.quiet(), OpenEXR.File(str(path / "recon.exr"), separate_channels=True) as file:
            parts = {p.name(): {k: c.pixels for k, c in p.channels.items()} for p in file.parts}
        arrays = {name: parts[name][name] for name in _PLANES}
        arrays |= {name: np.stack([parts[name][c] for c in _RGB], axis=-1) for name in _COLOURS}
        return Reconstruction(
            **arrays,
            depth_m=parts["depth"]["Z"],
            camera=parse(Camera, about["camera"], f"{path / 'meta.json'}: camera"),
            light=about["light"],
            settings=parse(Settings, about["settings"], f"{path / 'meta.json'}: settings").model_dump(),
            timings_s=about["timings_s"],
            bank=about.get("bank", {}),
            notes=tuple(about.get("notes", ())),
            method=about.get("method"),
            side=about.get("side", "assumed"),
        )
    except InputError:
        raise
    except Exception as error:  # missing keys, JSON errors and those of the EXR library
        raise InputError(
            f"reconstruction {path}: is damaged ({type(error).__name__}: {error}); "
            "make one with 'dasim recon CAPTURE --out DIR'"
        ) from None


def _about(result: Reconstruction | Developed) -> dict[str, Any]:
    """Entries of ``meta.json`` that both kinds of result have."""
    return {
        "schema": RECON_SCHEMA,
        "camera": result.camera.model_dump(mode="json"),
        "light": result.light,
        "preset": _preset(result.settings),
        "settings": result.settings,
        "timings_s": result.timings_s,
        "software": software_versions(),
    }


def _preset(settings: dict[str, Any]) -> str | None:
    return preset_name(Settings.model_validate(settings))


def displayed(linear_e: NDArray[Any], result: Reconstruction) -> NDArray[np.float32]:
    """Display values 0..1 of linear camera colours [h, w, 3], with the colour matrix and exposure of ``result.rgb``."""
    separation = infrared.separation(result.camera, result.light, Settings(**result.settings))
    matrix = colour.colour_matrix(result.camera, result.light, separation)
    return to_srgb(np.asarray(linear_e, np.float32), matrix, exposure_scale(result.linear_e, matrix))


def grey(image: NDArray[Any]) -> NDArray[np.float64]:
    """Display values 0..1 of a linear picture [h, w], with its 99.5th percentile as white and gamma 2.2."""
    white = float(np.percentile(image, 99.5))
    return np.clip(image / white, 0, 1) ** (1 / 2.2) if white > 0 else np.zeros(image.shape)


def write_picture(path: Path, image: NDArray[Any]) -> None:
    """Write an 8-bit PNG of display values 0..1, [h, w] or [h, w, 3]."""
    encoded = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    done, data = cv2.imencode(".png", encoded[..., ::-1] if encoded.ndim == 3 else encoded)
    if not done:
        raise OSError(f"{path}: the PNG encoder failed")
    atomic.write(path, data.tobytes())


def _part(name: str, channels: dict[str, NDArray[Any]]) -> Any:
    import OpenEXR

    header = {"name": name, "type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    return OpenEXR.Part(header, {k: np.ascontiguousarray(v, dtype=np.float32) for k, v in channels.items()})
