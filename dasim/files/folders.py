"""Values on disk: capture folders, ground truth as multi-part EXR, PSF banks; nothing half-written, nothing lost."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from dasim.base.errors import InputError
from dasim.base.toml import Specification, parse
from dasim.camera.specification import Camera, channels, depth_of_blur_m, intrinsic_matrix, level_blur_px
from dasim.values import Capture, PsfBank, Truth

CAPTURE_SCHEMA = 3
BANK_SCHEMA = 2
KERNEL_SUM_TOLERANCE = 1e-3


def level_table(camera: Camera) -> list[dict[str, float]]:
    """Level, visible blur and depth of the camera's blur levels, for ``meta.json``."""
    blurs = level_blur_px(camera)
    depths = depth_of_blur_m(camera, blurs)
    return [
        {"level": k, "blur_px": float(b), "depth_m": float(d)}
        for k, (b, d) in enumerate(zip(blurs, depths, strict=True))
    ]


def software_versions() -> dict[str, str]:
    """Versions of what decides the pixels of a capture."""
    found = {}
    for name in ("dasim", "mitsuba", "drjit", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


# --- folders -------------------------------------------------------------------------------------

# What each kind of result folder holds; the first is the file that marks it.
RESULT_FILES = {
    "capture": ("meta.json", "raw.png", "truth.exr"),
    "reconstruction": (
        *("meta.json", "recon.exr", "rgb.png", "sharp.png", "ir.png"),
        *("anaglyph.png", "stereo.png", "surface.ply", "surface.glb"),
    ),
    "EMVA 1288 measurement": ("meta.json", "descriptor.txt", "frames"),
    "calibration pictures": ("meta.json", "captures.csv", "pictures"),
    "demo": ("results.json", "report.html", "overview.jpg", "capture", "recon"),
    "validation": ("results.json", "report.html", "junit.xml"),
    "study": ("results.json", "report.html", "table.csv", "masks"),
}


@contextmanager
def new_folder(path: Path, kind: str) -> Iterator[Path]:
    """A temporary folder that becomes ``path`` when the block ends well, and vanishes when it does not.

    An earlier result of the same ``kind`` (of ``RESULT_FILES``) at ``path`` is replaced as a whole; a folder
    that holds anything else is refused with InputError.
    """
    check_output(path, kind)
    path = Path(path).resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.partial-", dir=path.parent))
    try:
        yield temporary
        temporary.chmod(0o755)
        if path.exists():
            retired = temporary.with_name(temporary.name.replace("partial", "old"))
            os.rename(path, retired)
            os.rename(temporary, path)
            shutil.rmtree(retired)
        else:
            os.rename(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        retired = temporary.with_name(temporary.name.replace("partial", "old"))
        if retired.exists() and not path.exists():  # stopped between the two renames
            os.rename(retired, path)


def check_output(path: Path, kind: str) -> None:
    """Refuse an output folder that holds anything but an earlier result of this kind; before any work starts."""
    shown, path = path, Path(path).resolve()
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output '{shown}': is the working folder or above it; name a new folder")
    if path.exists() and not path.is_dir():
        raise InputError(f"output {shown}: is a file, a folder is needed")
    if path.is_dir():
        entries = {entry.name for entry in path.iterdir()}
        files = RESULT_FILES[kind]
        if entries and not (entries <= set(files) and _marked(path / files[0])):
            strange = ", ".join(sorted(entries - set(files))[:3]) or files[0]
            raise InputError(
                f"output {shown}: exists and holds what dasim did not write for a {kind} ({strange}); "
                "choose another folder"
            )
    parent = path if path.is_dir() else path.parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(f"output {shown}: {parent} is not a folder that can be written to")


def _marked(file: Path) -> bool:
    """Whether a result's JSON file is dasim's own: it names the version that wrote it."""
    try:
        return "dasim" in json.loads(file.read_text(encoding="utf-8"))["software"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


# --- captures ------------------------------------------------------------------------------------


def save_capture(path: Path, capture: Capture, truth: Truth | None) -> None:
    """Write a capture folder: ``raw.png`` (16 bits), ``truth.exr`` (multi-part) and ``meta.json``."""
    with new_folder(path, "capture") as folder:
        write_png16(folder / "raw.png", capture.raw_dn)
        if truth is not None:
            write_truth(folder / "truth.exr", truth)
        meta = capture_meta(capture) | {
            "software": software_versions(),
            "file_bytes": {file.name: file.stat().st_size for file in sorted(folder.iterdir())},
        }
        (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def capture_meta(capture: Capture) -> dict[str, Any]:
    """What ``meta.json`` says of a capture, apart from its files and the software."""
    return {
        "schema": CAPTURE_SCHEMA,
        "camera": capture.camera.model_dump(mode="json"),
        "intrinsic_matrix_px": intrinsic_matrix(capture.camera).tolist(),
        "levels": level_table(capture.camera),
        "exposure_s": capture.exposure_s,
        "gain": capture.gain,
        "seed": capture.seed,
        "illuminant": capture.illuminant,
        "provenance": capture.provenance,
    }


def load_capture(path: Path) -> Capture:
    """Read a capture folder; InputError where a file is missing, cut short or does not fit the others."""
    path = Path(path)
    meta = _read_meta(path)
    about = parse(_CaptureMeta, meta, str(path / "meta.json"))
    for name in {"raw.png", *meta.get("file_bytes", {})}:
        _check_whole(path / name, meta)
    raw = read_png16(path / "raw.png")
    camera = about.camera
    capture = Capture(
        raw_dn=raw,
        camera=camera,
        exposure_s=about.exposure_s,
        gain=about.gain,
        seed=about.seed,
        illuminant=about.illuminant,
        provenance=about.provenance,
    )
    sensor = camera.sensor
    if raw.shape != (sensor.height_px, sensor.width_px):
        raise InputError(
            f"{path / 'raw.png'}: is {raw.shape[1]} x {raw.shape[0]} pixels, "
            f"meta.json says {sensor.width_px} x {sensor.height_px}"
        )
    return capture


def load_truth(path: Path) -> Truth:
    """Read the ground truth of a capture folder; InputError where it is missing or cut short."""
    path = Path(path)
    _check_whole(path / "truth.exr", _read_meta(path))
    return read_truth(path / "truth.exr")


class _CaptureMeta(Specification):
    """The keys of ``meta.json`` that a capture is made of; the others are for people."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    camera: Camera
    exposure_s: float = Field(gt=0)
    gain: float = Field(gt=0)
    seed: int = Field(ge=0)
    illuminant: str | None
    provenance: dict[str, Any]


def _check_whole(file: Path, meta: dict[str, Any]) -> None:
    """InputError where a file of a capture is missing, or shorter or longer than it was written."""
    if not file.is_file():
        raise InputError(f"{file}: is missing; a capture holds raw.png, truth.exr and meta.json")
    sizes = meta.get("file_bytes")
    written = sizes.get(file.name) if isinstance(sizes, dict) else None
    if written is not None and file.stat().st_size != written:
        raise InputError(f"{file}: has {file.stat().st_size} bytes of {written}; it is cut short or was changed")


def _read_meta(path: Path) -> dict[str, Any]:
    if path.is_file():
        raise InputError(f"capture {path}: is a file; give the folder that holds raw.png, truth.exr and meta.json")
    if not path.is_dir():
        raise InputError(f"capture {path}: no such folder (a capture holds raw.png, truth.exr and meta.json)")
    file = path / "meta.json"
    try:
        meta = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{file}: is missing; a capture holds raw.png, truth.exr and meta.json") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error})") from None
    if not isinstance(meta, dict) or meta.get("schema") != CAPTURE_SCHEMA:
        raise InputError(f"{file}: is no capture of schema {CAPTURE_SCHEMA}")
    return meta


def write_png16(path: Path, image: NDArray[np.uint16]) -> None:
    """Write a 16-bit grey PNG."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image, dtype=np.uint16))
    if not done:
        raise OSError(f"{path}: the PNG encoder failed")
    path.write_bytes(data.tobytes())


def read_png16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit grey PNG whole; InputError where it is missing, cut short or of another kind."""
    if not path.is_file():
        raise InputError(f"{path}: is missing")
    data = path.read_bytes()
    # The decoder fills what a cut file lacks with zeros, so the end of the file is checked first.
    if b"IEND" not in data[-16:]:
        raise InputError(f"{path}: is no PNG, or is cut short")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"{path}: is no 16-bit grey PNG")
    return image.astype(np.uint16, copy=False)


# --- ground truth as multi-part EXR --------------------------------------------------------------

_XYZ = ("X", "Y", "Z")
NAMES = "objectAndMaterialNames"  # header of the first part, JSON: numbers 1, 2, ... of the part ``labels``
CHANNEL_ORDER = "channelOrder"  # header of the first part: EXR itself keeps channels in alphabetical order


TRUTH_PARTS = ("depth", "normal", "blur", "labels", "mean_e", "sharp_e", "sharp_srgb")


def write_truth(path: Path, truth: Truth, keep: Sequence[str] = TRUTH_PARTS, *, half: bool = False) -> None:
    """Write the ground truth as a multi-part EXR; ``Z`` of the part ``depth`` is the depth in metres.

    ``keep`` chooses of ``TRUTH_PARTS``. With ``half`` all but depth and labels are 16-bit floats, of 11 bits.
    """
    import OpenEXR

    kind = np.float16 if half else np.float32
    most = np.finfo(kind).max
    arrays: dict[str, dict[str, np.ndarray]] = {
        "depth": {"Z": truth.depth_m},
        "normal": {axis: truth.normal[..., i] for i, axis in enumerate(_XYZ)},
        "blur": {"blur_px": truth.blur_px, "level": truth.level},
        "labels": {
            "object_id": truth.object_id,
            "material_id": truth.material_id,
            "valid": truth.valid.astype(np.uint32),
            "boundary": truth.boundary.astype(np.uint32),
        },
        "mean_e": {name: truth.mean_e[..., i] for i, name in enumerate(truth.channels)},
        "sharp_e": {name: truth.sharp_e[..., i] for i, name in enumerate(truth.channels)},
        "sharp_srgb": {name: truth.sharp_srgb[..., i] for i, name in enumerate("RGB")},
    }
    parts = []
    for name in keep:
        channels = arrays[name]
        if name not in ("depth", "labels"):
            channels = {key: np.clip(value, -most, most).astype(kind) for key, value in channels.items()}
        header = {"name": name, "type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        parts.append(OpenEXR.Part(header, {key: np.ascontiguousarray(value) for key, value in channels.items()}))
    parts[0].header[CHANNEL_ORDER] = ",".join(truth.channels)
    parts[0].header[NAMES] = json.dumps({"objects": truth.objects, "materials": truth.materials})
    OpenEXR.File(parts).write(str(path))


def read_truth(path: Path) -> Truth:
    """Read a ground-truth EXR; InputError where it is missing, cut short or lacks a part."""
    found = read_truth_parts(path)
    missing = [field.name for field in fields(Truth) if field.name not in found]
    if missing:
        raise InputError(f"{path}: lacks {', '.join(missing)}; a truth file with all its parts is needed")
    return Truth(**found)


def read_truth_parts(path: Path) -> dict[str, Any]:
    """What a ground-truth EXR has of :class:`Truth`'s fields, by name; InputError where it cannot be read."""
    import OpenEXR

    if not path.is_file():
        raise InputError(f"{path}: is missing")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = {p.name(): {k: c.pixels for k, c in p.channels.items()} for p in file.parts}
            names = tuple(file.parts[0].header[CHANNEL_ORDER].split(","))
            labelled = json.loads(file.parts[0].header[NAMES])
        found: dict[str, Any] = {"channels": names}
        found |= {key: tuple(labelled[key]) for key in ("objects", "materials")}
        if "depth" in parts:
            found["depth_m"] = parts["depth"]["Z"]
        if "blur" in parts:
            found |= {key: _single(parts["blur"][key]) for key in ("blur_px", "level")}
        if "labels" in parts:
            found |= {key: parts["labels"][key] for key in ("object_id", "material_id")}
            found |= {key: parts["labels"][key].astype(bool) for key in ("valid", "boundary")}
        for part, order in (("normal", _XYZ), ("mean_e", names), ("sharp_e", names), ("sharp_srgb", "RGB")):
            if part in parts:
                found[part] = np.stack([_single(parts[part][name]) for name in order], axis=-1)
        return found
    except KeyError as error:
        raise InputError(f"{path}: lacks {error}; a truth file of dasim is needed") from None
    except Exception as error:  # the library raises bare RuntimeError and others for damaged files
        raise InputError(f"{path}: cannot be read, or is cut short ({error})") from None


def _single(channel: np.ndarray) -> np.ndarray:
    """Half floats as single ones, which numpy computes with."""
    return channel.astype(np.float32, copy=False)


# --- PSF banks -----------------------------------------------------------------------------------


def bank_identity(bank: PsfBank) -> dict[str, Any]:
    """Which bank it is, as plain data: SHA-256 of its arrays, camera, focus, lights, levels."""
    digest = hashlib.sha256()
    for array in (bank.kernel, bank.signature, bank.depth_m, bank.blur_px):
        digest.update(np.ascontiguousarray(array, np.float32).tobytes())
    return {
        "sha256": digest.hexdigest(),
        "camera": bank.camera.name,
        "focus_distance_m": bank.camera.lens.focus_distance_m,
        "lights": list(bank.lights),
        "levels": len(bank.depth_m),
        "depths_m": [float(bank.depth_m.min()), float(bank.depth_m.max())],
        "diffraction": bank.diffraction,
    }


def save_bank(path: Path, bank: PsfBank) -> None:
    """Write a PSF bank as one compressed ``.npz``, under a temporary name first."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {
        "schema": BANK_SCHEMA,
        "lights": bank.lights,
        "diffraction": bank.diffraction,
        "camera": bank.camera.model_dump(mode="json"),
    }
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(
                file,
                about=np.array(json.dumps(about)),
                kernel=bank.kernel,
                signature=bank.signature,
                depth_m=bank.depth_m,
                blur_px=bank.blur_px,
            )
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def load_bank(path: Path) -> PsfBank:
    """Read a PSF bank; InputError where the file is missing, damaged or no bank."""
    path = Path(path)
    if not path.is_file():
        what = "is a folder, a bank is one .npz file" if path.is_dir() else "no such file"
        raise InputError(f"bank {path}: {what}; make one with 'dasim calibrate'")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            about = dict(json.loads(str(data["about"])))
            arrays = {key: data[key] for key in ("kernel", "signature", "depth_m", "blur_px")}
    except Exception as error:  # zip, npy and json errors of a damaged file are of many types
        raise InputError(
            f"bank {path}: is no bank, or is damaged ({type(error).__name__}); make one with 'dasim calibrate'"
        ) from None
    if about.get("schema") != BANK_SCHEMA:
        raise InputError(f"bank {path}: is no bank of schema {BANK_SCHEMA}; make a new one with 'dasim calibrate'")
    camera = parse(Camera, about.get("camera"), f"bank {path}: camera")
    lights, diffraction = tuple(about.get("lights", ())), str(about.get("diffraction", "measured"))
    kernel, levels = arrays["kernel"], len(np.atleast_1d(arrays["depth_m"]))
    count = len(channels(camera.sensor))
    shapes = {"signature": (len(lights), count), "depth_m": (levels,), "blur_px": (levels,)}
    square = kernel.ndim == 5 and kernel.shape[3] == kernel.shape[4] and kernel.shape[3] % 2 == 1
    if not square or kernel.shape[:3] != (len(lights), levels, count) or 0 in kernel.shape:
        raise InputError(f"bank {path}: its kernels do not fit its lights, levels and channels")
    if any(arrays[name].shape != shape for name, shape in shapes.items()):
        raise InputError(f"bank {path}: its tables do not fit its lights and levels")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError(f"bank {path}: has values that are not finite")
    if np.abs(kernel.sum(axis=(3, 4)) - 1).max() > KERNEL_SUM_TOLERANCE or (arrays["depth_m"] <= 0).any():
        raise InputError(f"bank {path}: its kernels are not of unit sum, or its depths not above 0")
    return PsfBank(lights=lights, diffraction=diffraction, camera=camera, **arrays)
