"""What the page shows of a reconstruction and of a capture, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.specification import Camera
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.values import Capture, Developed, PsfBank, Reconstruction, Truth
from recon.depth.peak import REFERENCE_ERROR
from recon.files.reconstruction import grey
from recon.levels import dioptres_per_level
from recon.settings import Settings, preset_name
from recon.views.surface import JUMP_SHARE, distortion_per_px, intrinsic_matrix
from validation.reports.view.focal_stack import Slice
from validation.reports.view.packing import lossless, packed_map
from validation.scores import pictures
from validation.scores.margin import framed, has_margin, is_inside

TRUTHS = {"truth": "Truth, through a pinhole", "truth-focus": "Truth, in focus with diffraction"}


@dataclass(frozen=True, repr=False)
class Picture:
    """A picture with the name by which the page knows it, and the one it shows."""

    id: str
    label: str
    image: NDArray[Any]  # [h, w] or [h, w, 3], display values 0..1


@dataclass(frozen=True, repr=False)
class Contents:
    """All that a page shows; parts that a folder does not have are empty."""

    title: str
    camera: Camera
    facts: dict[str, str]
    notes: tuple[str, ...] = ()
    pictures: list[Picture] = field(default_factory=list)
    channels: list[Picture] = field(default_factory=list)
    stack: Sequence[Slice] = ()
    maps: dict[str, Any] = field(default_factory=dict)  # packed, see ``packed_map``
    sd: dict[str, float] | None = None  # how a confidence becomes a standard deviation
    mosaic: dict[str, Any] | None = None

    def plain(self) -> dict[str, Any]:
        """Everything but the pictures, for JSON."""
        sensor, lens = self.camera.sensor, self.camera.lens
        return {
            "title": self.title,
            "size_px": [sensor.width_px, sensor.height_px],
            "facts": list(self.facts.items()),
            "notes": list(self.notes),
            "f_number": lens.f_number,
            "intrinsic_px": intrinsic_matrix(self.camera).tolist(),
            "distortion_per_px": list(distortion_per_px(self.camera)),
            "jump_share": JUMP_SHARE,
            "maps": self.maps,
            "sd": self.sd,
            "mosaic": self.mosaic,
        }


def of_reconstruction(
    result: Reconstruction, bank: PsfBank, stack: Sequence[Slice], capture: Capture | None, truth: Truth | None
) -> Contents:
    """Contents of a reconstruction with its focal stack, and of its capture where that is known."""
    shown = _of_camera(result.camera, capture, truth)
    exposed: dict[str, NDArray[Any]] = {"captured": result.rgb, "all-in-focus": result.sharp_rgb}
    if truth is not None and _shows_pictures(result.camera, truth):
        exposed |= {name: image for name, image in pictures.displayed(result, truth).items() if name in TRUTHS}
    labels = {"captured": "Captured", "all-in-focus": "All in focus"} | TRUTHS
    maps = {"depth": _vergence(result.depth_m), "confidence": packed_map(result.confidence)}
    facts = {"Light, by white balance": result.light, "Depth by": result.method or _made(result.settings)}
    return replace(
        shown,
        title=f"Reconstruction: {shown.title}",
        facts=shown.facts | facts,
        notes=result.notes,
        pictures=[Picture(name, labels[name], image) for name, image in exposed.items()],
        channels=_channels(result.linear_e, result.ir_e),
        stack=stack,
        maps=maps | shown.maps,
        # A confidence c stands for sd = s sqrt(1 / c - 1) in levels: recon.depth.peak.confidence_of.
        sd={"at_half": REFERENCE_ERROR, "dioptres_per_level": dioptres_per_level(bank.depth_m)},
    )


def of_capture(capture: Capture, developed: Developed, truth: Truth | None) -> Contents:
    """Contents of a capture without a reconstruction: its colours, its mosaic, and the truth where there is one."""
    shown = _of_camera(capture.camera, capture, truth)
    seen = [Picture("captured", "Captured", developed.rgb)]
    if truth is not None and _shows_pictures(capture.camera, truth):
        exact = {"truth": truth.sharp_e, "truth-focus": truth.focus_e}
        scale = exposure_scale(developed.linear_e, developed.matrix)
        for name, image_e in exact.items():
            if image_e is not None:
                linear = pictures.infrared_free(image_e, capture.camera, developed.light).astype(np.float32)
                seen.append(Picture(name, TRUTHS[name], to_srgb(linear, developed.matrix, scale)))
    return replace(
        shown,
        title=f"Capture: {shown.title}",
        facts=shown.facts | {"Light, by white balance": developed.light},
        notes=("No reconstruction: no refocusing and no estimated depth. 'dasim recon' makes one.",),
        pictures=seen,
        channels=_channels(developed.linear_e, developed.ir_e),
    )


def _true_maps(camera: Camera, truth: Truth | None) -> dict[str, Any]:
    """The true depth in a camera's frame, NaN in a margin that the truth lacks; nothing where there is none."""
    frame = camera.sensor.height_px, camera.sensor.width_px
    if truth is None or not truth.has("depth_m") or not is_inside(truth.depth_m.shape, frame):
        return {}
    return {"true_depth": _vergence(framed(truth.depth_m, frame))}


def _shows_pictures(camera: Camera, truth: Truth) -> bool:
    """Whether a truth has pictures of a camera's whole frame; that of a dataset may lack them, or a margin."""
    return truth.has("sharp_e", "depth_m") and not has_margin(camera, truth)


def _made(settings: dict[str, Any]) -> str:
    """Preset of the settings of a reconstruction, or its score where they are no preset's."""
    preset = preset_name(Settings.model_validate(settings))
    return f"preset {preset}" if preset else f"score {settings.get('score', 'unknown')}"


def check_same(result: Reconstruction, capture: Capture, where: str) -> None:
    """Raise InputError if a capture cannot be the one that was reconstructed."""
    if capture.camera != result.camera:
        raise InputError(
            f"--capture {where}: camera '{capture.camera.name}' focused at {capture.camera.lens.focus_distance_m:g} m "
            f"is not that of the reconstruction, '{result.camera.name}' focused at "
            f"{result.camera.lens.focus_distance_m:g} m, or differs in a detail; give the capture it was made from"
        )


def _of_camera(camera: Camera, capture: Capture | None, truth: Truth | None) -> Contents:
    """What both kinds of page show: facts, the mosaic and the true depth."""
    lens, sensor = camera.lens, camera.sensor
    scene = None if capture is None else capture.provenance.get("scene")
    name = scene.get("name") if isinstance(scene, dict) else None
    facts = {"Scene": str(name)} if name else {}
    facts |= {
        "Camera": f"{camera.name}: {lens.focal_length_mm:g} mm f/{lens.f_number:g}, focus {lens.focus_distance_m:g} m",
        "Frame": f"{sensor.width_px} x {sensor.height_px} pixels of {sensor.pixel_pitch_um:g} um",
    }
    if capture is not None:
        facts["Exposure"] = f"{capture.exposure_s * 1e3:.1f} ms, gain {capture.gain:g}"
    return Contents(
        title=str(name or camera.name),
        camera=camera,
        facts=facts,
        maps=_true_maps(camera, truth),
        mosaic=None if capture is None else _mosaic(capture),
    )


def _mosaic(capture: Capture) -> dict[str, Any]:
    sensor, gain = capture.camera.sensor, capture.gain
    per_dn = noise.electrons_per_dn(sensor, gain)
    return {
        "data": lossless(capture.raw_dn),
        "pattern": [list(row) for row in sensor.mosaic],
        "black_dn": sensor.black_level_dn,
        "e_per_dn": per_dn,
        "full_dn": sensor.black_level_dn + noise.saturation_e(sensor, gain) / per_dn,
    }


def _vergence(depth_m: NDArray[Any]) -> dict[str, Any]:
    """A depth map in metres, [h, w], packed in dioptres."""
    known = np.isfinite(depth_m) & (depth_m > 0)
    return packed_map(np.where(known, 1 / np.where(known, depth_m, 1.0).astype(np.float64), np.nan))


def _channels(linear_e: NDArray[Any], ir_e: NDArray[Any] | None) -> list[Picture]:
    planes = {name: linear_e[..., i] for i, name in enumerate("RGB")} | ({} if ir_e is None else {"IR": ir_e})
    return [Picture(name, name, grey(np.maximum(plane, 0))) for name, plane in planes.items()]
