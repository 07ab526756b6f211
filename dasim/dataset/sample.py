"""One sample of a dataset: simulation, description, and packing as the files of a capture."""

from __future__ import annotations

import base64
import hashlib
import json
import tempfile
import time
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dasim.base.fingerprint import fingerprint
from dasim.camera.geometry import intrinsic_matrix
from dasim.dataset.draws import Draft, capture_and_view, draft
from dasim.dataset.environment import environment
from dasim.dataset.specification import DatasetSpec, noise_model
from dasim.files.captures import capture_meta
from dasim.files.png import write_png16
from dasim.files.truth import write_truth
from dasim.render import backend
from dasim.scene.classes import CLASSES
from dasim.scene.specification import Scene, world_to_camera
from dasim.simulation.exposure import SensorLight, Shot, bracketed, frame_seed, photograph
from dasim.simulation.simulate import sensor_light
from dasim.values import Capture, Truth

ROW = "row.json"  # its row of the index, stored with the files until the index is written
DIGITS = 9  # of a sample's name
THUMBNAIL_PX, THUMBNAIL_QUALITY = 96, 80
DEPTH_EDGES_M = np.geomspace(0.03, 100.0, 41)
BLUR_EDGES_PX = np.linspace(-20.0, 60.0, 41)  # as for depth, the first and the last bin hold what is beyond


@dataclass(frozen=True)
class Job:
    """Specification, output, and the environment and code (:func:`provenance`) that all workers must have."""

    spec: DatasetSpec
    out: str
    environment: dict[str, Any]


@dataclass(frozen=True)
class PackedSample:
    """Files of a sample (bytes by name), and its row of the index."""

    files: dict[str, bytes]
    row: dict[str, Any]
    seconds: float  # in total
    render_s: float  # of ``seconds``, in the renderer


def frame_name(number: int) -> str:
    """File of a frame of a sample, from 0."""
    return f"raw-{number}.png" if number else "raw.png"


def file_names(spec: DatasetSpec) -> tuple[str, ...]:
    """Files of a sample in their order; meta.json is last: its presence marks a complete capture."""
    return (*map(frame_name, range(spec.frames.count)), "truth.exr", "meta.json")


def key(index: int) -> str:
    """Name of a sample: its index with leading zeros."""
    return f"{index:0{DIGITS}d}"


@lru_cache(maxsize=1)
def provenance(variant: str) -> dict[str, Any]:
    """Everything besides the specification that determines pixels: the environment, and a fingerprint of the code.

    The fingerprint covers bundled scenes, cameras and tables too.
    """
    return environment(variant) | {"code": fingerprint(make, variant=variant)}


def make(spec: DatasetSpec, index: int, variant: str) -> PackedSample:
    """Simulate and pack sample ``index``; the result depends on the specification, the index and the variant only."""
    start = time.perf_counter()
    plan = draft(spec, index)
    render_start = time.perf_counter()
    light = sensor_light(
        plan.scene,
        plan.camera,
        plan.seed,
        spp=spec.spp,
        noise_share=spec.noise_share,
        noise_at=spec.noise_at,
        independent_mean=spec.truth.independent_mean,
        exposure=plan.exposure,
        diffraction=spec.diffraction,
        variant=variant,
    )
    factors = [factor for factor in spec.frames.bracket for _ in range(spec.frames.burst)]
    shot = _exposed(spec, plan, light, 0, factors[0])
    others = (_exposed(spec, plan, light, number, factor) for number, factor in enumerate(factors[1:], 1))
    captures, truth = [shot.capture, *(other.capture for other in others)], shot.truth
    render_s = time.perf_counter() - render_start
    files = _files(spec, plan, captures, truth)
    row = _row(plan, captures, truth, files) | view_of(spec, plan)
    del light, shot, captures, truth, plan
    backend.release_memory()
    return PackedSample(files, row, time.perf_counter() - start, render_s)


def one_thread() -> None:
    """Render on one thread in this process: processes share the computer, and the order of sums is fixed."""
    backend.use_threads(1)
    cv2.setNumThreads(1)


def activate(variant: str) -> None:
    """Activate a Mitsuba variant in this process, on one thread."""
    backend.activate(backend.choose(variant))
    one_thread()


def _exposed(spec: DatasetSpec, plan: Draft, light: SensorLight, number: int, factor: float) -> Shot:
    """Frame ``number`` of a sample, at ``factor`` times its exposure time."""
    exposure = bracketed(light, plan.exposure, factor)
    return photograph(light, exposure, frame_seed(plan.seed, number), noise_model(spec))


def _files(spec: DatasetSpec, plan: Draft, frames: list[Capture], truth: Truth) -> dict[str, bytes]:
    """Files of a sample, as bytes by name: its frames, and the truth of the first."""
    margin = spec.truth.margin_px
    *pictures, exact, about = file_names(spec)
    with tempfile.TemporaryDirectory(prefix="dasim-") as name:
        folder = Path(name)
        scale = 2 ** (16 - frames[0].camera.sensor.adc_bits) if spec.raw_scale == "full" else 1
        for file, frame in zip(pictures, frames, strict=True):
            write_png16(folder / file, frame.raw_dn * np.uint16(scale))
        write_truth(folder / exact, inner(truth, margin), spec.truth.keep, half=spec.truth.half)
        files = {file: (folder / file).read_bytes() for file in (*pictures, exact)}
    meta = capture_meta(frames[0]) | {
        "raw_scale": scale,
        "sample": {
            "dataset": spec.name,
            "version": spec.version,
            "index": plan.index,
            "split": plan.split,
            "scene": plan.scene_key,
            **({} if plan.kind is None else {"kind": plan.kind}),
            "drawn": plan.drawn,
            **view_of(spec, plan),
            "truth": {"keep": spec.truth.keep, "half": spec.truth.half, "offset_px": [margin, margin]},
            "frames": [_frame(file, frame) for file, frame in zip(pictures, frames, strict=True)],
        },
        "file_bytes": {file: len(content) for file, content in files.items()},
    }
    return files | {about: json_bytes(meta)}


def _frame(file: str, frame: Capture) -> dict[str, Any]:
    """Entry of ``meta.json`` on a frame; its mean electrons are the truth's times the ratio of exposure times."""
    return {
        "file": file,
        "exposure_s": frame.exposure_s,
        "gain": frame.gain,
        "seed": frame.seed,
        "saturated_pixels": frame.provenance["saturated_pixels"],
        "rendering_noise_share": frame.provenance.get("rendering_noise_share", {}),
    }


def inner(truth: Truth, margin_px: int) -> Truth:
    """The truth without a margin of ``margin_px`` pixels along every edge."""
    if margin_px == 0:
        return truth
    part = slice(margin_px, -margin_px)
    arrays: dict[str, Any] = {f.name: getattr(truth, f.name) for f in fields(truth)}
    parts: dict[str, Any] = {name: a[part, part] for name, a in arrays.items() if isinstance(a, np.ndarray)}
    return replace(truth, **parts)


def _row(plan: Draft, frames: list[Capture], truth: Truth, files: dict[str, bytes]) -> dict[str, Any]:
    """Row of the index: parameters and statistics of the first frame, checksums and a thumbnail."""
    capture = frames[0]
    body = capture.camera.sensor
    depth_m = truth.depth_m[truth.valid]
    shares = capture.provenance.get("rendering_noise_share", {})
    depth = np.percentile(depth_m, (0, 5, 50, 95, 100))
    return {
        "index": plan.index,
        "key": key(plan.index),
        "split": plan.split,
        "scene": plan.scene_key,
        **({} if plan.kind is None else {"kind": plan.kind}),
        "camera": capture.camera.name,
        "f_number": capture.camera.lens.f_number,
        "focal_length_mm": capture.camera.lens.focal_length_mm,
        "focus_m": capture.camera.lens.focus_distance_m,
        "illuminant": capture.illuminant,
        "exposure_s": capture.exposure_s,
        "gain": capture.gain,
        "seed": capture.seed,
        "frames": len(frames),
        "drawn": json.dumps(plan.drawn),
        "spp": json.dumps(capture.provenance["spp"]),
        "noise_share": max(shares["50"].values()) if shares else None,
        "noise_share_p95": max(shares["95"].values()) if shares else None,
        "saturated_share": capture.provenance["saturated_pixels"] / capture.raw_dn.size,
        "mean_dn": float(capture.raw_dn.mean()) - body.black_level_dn,
        "valid_share": float(truth.valid.mean()),
        "boundary_share": float(truth.boundary.mean()),
        "class_share": class_shares(truth),
        **{f"depth_{name}_m": float(v) for name, v in zip(("min", "p05", "p50", "p95", "max"), depth, strict=True)},
        "far_side_share": float(np.mean(truth.level[truth.valid] < -0.5)),
        "depth_histogram": histogram(depth_m, DEPTH_EDGES_M).tolist(),
        "blur_histogram": histogram(truth.blur_px[truth.valid], BLUR_EDGES_PX).tolist(),
        "sha256": {file: hashlib.sha256(content).hexdigest() for file, content in files.items()},
        "bytes": sum(map(len, files.values())),
        "thumbnail": base64.b64encode(_thumbnail(truth.sharp_srgb)).decode(),
    }


def histogram(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of values in each bin; those beyond the edges count in the first and in the last bin."""
    return np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]


def view_of(spec: DatasetSpec, plan: Draft) -> dict[str, Any]:
    """What is known of a sample's view, for ``meta.json`` and the index.

    ``capture``, ``view``, ``pose`` and ``rig_camera`` say which capture of which view it is; the matrices are those of
    OpenCV: ``intrinsic_matrix_px`` [3, 3] for pixel centres at +0.5, and ``world_to_camera`` [4, 4] from scene
    coordinates in metres into camera axes, None for a Mitsuba scene.
    """
    capture, view = capture_and_view(spec, plan.index)
    scene = plan.scene
    return {
        "capture": capture,
        "view": view,
        "pose": view // len(spec.views.rig),
        "rig_camera": spec.views.camera_of(view).name,
        "intrinsic_matrix_px": intrinsic_matrix(plan.camera).tolist(),
        "world_to_camera": world_to_camera(scene).tolist() if isinstance(scene, Scene) else None,
    }


def class_shares(truth: Truth) -> dict[str, float]:
    """Share 0..1 of the pixels that show each class of ``CLASSES``; what is left shows no object."""
    assert truth.class_id is not None  # of a truth that was just rendered
    counts = np.bincount(truth.class_id.ravel(), minlength=len(CLASSES) + 1)[1:]
    return {name: float(count / truth.class_id.size) for name, count in zip(CLASSES, counts, strict=True)}


def _thumbnail(srgb: np.ndarray) -> bytes:
    """JPEG of a picture [h, w, 3] in sRGB 0..1, scaled to a width of ``THUMBNAIL_PX``."""
    size = (THUMBNAIL_PX, max(round(THUMBNAIL_PX * srgb.shape[0] / srgb.shape[1]), 1))
    small = cv2.resize(np.ascontiguousarray(srgb[..., ::-1]), size, interpolation=cv2.INTER_AREA)
    small = np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, THUMBNAIL_QUALITY])
    return bytes(data.tobytes())


def json_bytes(value: Any) -> bytes:
    """A plain value as JSON; equal values give equal bytes."""
    return (json.dumps(value, indent=1) + "\n").encode()
