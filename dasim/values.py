"""The values that flow between simulator, reconstruction and scores.

Images are [y, x] or [y, x, channel]; channels are in the order of ``camera.channels`` (R, G, B, IR).
Pixel centres are at +0.5, x to the right, y down, z forward, lengths in metres. Values that hold images compare by
identity, and may be keys of a dict.

Tested in tests/dasim/files/test_captures.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.typing import Float32Array

Side = Literal["assumed", "estimated"]

# Fields of a truth by the part of truth.exr that holds them, as datasets name it in truth.keep.
TRUTH_PARTS = {
    "depth": ("depth_m",),
    "normal": ("normal",),
    "blur": ("blur_px", "level"),
    "labels": ("object_id", "material_id", "valid", "boundary"),
    "mean_e": ("mean_e",),
    "mean_e_variance": ("mean_e_variance",),
    "sharp_e": ("sharp_e",),
    "focus_e": ("focus_e",),
    "sharp_srgb": ("sharp_srgb",),
}


@dataclass(frozen=True, repr=False, eq=False)
class Capture:
    """One raw picture, the camera and the exposure."""

    raw_dn: NDArray[np.uint16]  # [h, w], black level included
    camera: Camera
    exposure_s: float
    gain: float
    seed: int
    illuminant: str | None = None  # name of the scene's main light; for scores, never for estimates
    provenance: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        exposure = f"{self.exposure_s:g} s, gain {self.gain:g}, seed {self.seed}"
        return f"Capture({_size(self.raw_dn)}, {_name(self.camera)}, {exposure}, light {self.illuminant or 'unknown'})"


@dataclass(frozen=True, repr=False, eq=False)
class Truth:
    """Ground truth of a simulated capture, per pixel; ``depth_m`` is NaN where no surface is hit.

    A truth may lack parts (:meth:`of_parts`). Reading a field that is not there raises InputError, which names the part
    and the setting that writes it.
    """

    depth_m: Float32Array  # [h, w] z from the lens plane at the pixel's centre, never range
    valid: NDArray[np.bool_]  # [h, w] a surface was hit
    normal: Float32Array  # [h, w, 3] unit, camera axes, towards the camera
    object_id: NDArray[np.uint32]  # [h, w] 0 is nothing, then ``objects`` in order
    material_id: NDArray[np.uint32]  # [h, w] 0 is nothing, then ``materials`` in order
    blur_px: Float32Array  # [h, w] signed visible blur diameter, positive nearer than the focus
    level: Float32Array  # [h, w] signed blur level: ``blur_px`` over that of level 1, 1 / (1 - alpha) px by default
    boundary: NDArray[np.bool_]  # [h, w] the blur disc crosses a depth discontinuity within the frame
    channels: tuple[str, ...]  # names of the last axis below
    mean_e: Float32Array  # [h, w, channel] mean electrons of every channel as the lens sees it, with rendering noise
    sharp_e: Float32Array  # [h, w, channel] the same through a pinhole of the same light
    sharp_srgb: Float32Array  # [h, w, 3] 0..1, through a pinhole onto a Bayer sensor without near-infrared
    objects: tuple[str, ...] = ()  # names
    materials: tuple[str, ...] = ()
    mean_e_variance: Float32Array | None = None  # [h, w, channel] of ``mean_e`` by rendering noise; None: unknown
    class_id: NDArray[np.uint32] | None = None  # [h, w] 0 is nothing, then ``dasim.CLASSES``; None in older files
    focus_e: Float32Array | None = None  # [h, w, channel] the geometry of ``sharp_e``, with diffraction in focus

    @classmethod
    def of_parts(cls, values: Mapping[str, Any], where: str = "truth") -> Truth:
        """A truth with some of its fields; ``where`` begins the messages about those that it lacks."""
        truth = object.__new__(cls)
        for name, value in values.items():
            object.__setattr__(truth, name, value)
        object.__setattr__(truth, "_where", where)
        return truth

    def has(self, *names: str) -> bool:
        """Whether all these fields are there."""
        return all(vars(self).get(name) is not None for name in names)

    def require(self, *names: str) -> None:
        """Raise InputError, with all parts that are missing, unless all these fields are there."""
        parts = [part for part, own in TRUTH_PARTS.items() if any(n in own and not self.has(n) for n in names)]
        if parts:
            where = vars(self).get("_where", "truth")
            listed = ", ".join(f'"{part}"' for part in parts)
            raise InputError(
                f"{where}: lacks {', '.join(parts)}, needed here; a dataset writes parts of the truth that its "
                f"specification lists: truth.keep = [..., {listed}]"
            )

    if not TYPE_CHECKING:  # a checker of types would take any name for a field

        def __getattr__(self, name: str) -> Any:
            """Called for a field that is not there."""
            if any(name in own for own in TRUTH_PARTS.values()):
                self.require(name)
            raise AttributeError(name)

    def scaled(self, factor: float, rounded: Callable[[NDArray[np.float64]], Float32Array] | None = None) -> Truth:
        """The truth of the same view with ``factor`` times the electrons: another exposure time, or light level.

        The parts that it has are scaled, and ``rounded``, by default to single precision.
        """
        rounded = rounded or (lambda image: image.astype(np.float32))
        powers = {"mean_e": 1, "sharp_e": 1, "focus_e": 1, "mean_e_variance": 2}
        scaled: dict[str, Any] = {
            name: rounded(getattr(self, name) * np.float64(factor) ** power)
            for name, power in powers.items()
            if self.has(name)
        }
        return Truth.of_parts({**vars(self), **scaled}, vars(self).get("_where", "truth"))

    def __repr__(self) -> str:
        if not self.has("depth_m"):
            return f"Truth(without depth, {len(self.objects)} objects)"
        depths = _range(self.depth_m)
        channels = " ".join(vars(self).get("channels", ())) or "unknown"
        return f"Truth({_size(self.depth_m)}, {depths}, {len(self.objects)} objects, channels {channels})"


@dataclass(frozen=True, eq=False)
class PointPicture:
    """Frames of a point source for calibration: one light, level and position.

    The source moves by ``shift_px`` (y, x) whole pixels between pictures; its subpixel position is unknown and has to
    be measured. If ``shift_px`` is None, the source is at any position, the same in all pictures of one ``position``.
    """

    frames_dn: NDArray[np.uint16]  # [frame, h, w]
    light: str
    level: int  # negative behind the focus
    depth_m: float
    blur_px: float  # visible blur diameter at this depth, negative behind the focus
    shift_px: tuple[int, int] | None
    exposure_s: float
    gain: float = 1.0  # analogue
    position: str = ""


@dataclass(frozen=True)
class PointPictures:
    """Simulated pictures of a point source for the calibration of a camera, generated anew at each iteration."""

    camera: Camera
    lights: tuple[str, ...]
    diffraction: str  # wave, airy or off
    field_px: tuple[float, float]  # (x, y) of the source's image from the optical axis
    count: int  # of pictures
    fingerprint: (
        str | None
    )  # hash of everything that determines the pictures; None: unknown, so that banks are not cached
    make: Callable[[], Iterator[PointPicture]] = field(repr=False, compare=False)

    def __iter__(self) -> Iterator[PointPicture]:
        return self.make()

    def __len__(self) -> int:
        return self.count


@dataclass(frozen=True, repr=False, eq=False)
class LevelsBehind:
    """Measured point-spread functions behind the focus; level 0 is the focus, level k lies at the signed level -k."""

    kernel: Float32Array  # [light, level, channel, y, x], as those of the bank
    depth_m: Float32Array  # [level], rising
    blur_px: Float32Array  # [level] signed visible blur diameter, 0 and below


@dataclass(frozen=True, repr=False, eq=False)
class PsfBank:
    """Measured point-spread functions of a camera at one focus."""

    kernel: Float32Array  # [light, level, channel, y, x], odd size, each of unit sum, centred
    lights: tuple[str, ...]
    signature: Float32Array  # [light, channel] electrons of a white source on the axis, relative to green
    depth_m: Float32Array  # [level]
    blur_px: Float32Array  # [level] visible blur diameter
    camera: Camera
    diffraction: str  # how the pictures were made: wave, airy, off, or measured
    field_px: tuple[float, float] = (0.0, 0.0)  # (x, y) from the optical axis, where the kernels were measured
    behind: LevelsBehind | None = None  # where axial colour tells the sides of the focus apart

    def __repr__(self) -> str:
        levels = f"{len(self.depth_m)} levels, {_range(self.depth_m)}"
        levels += f", {len(self.behind.depth_m) - 1} behind the focus" if self.behind else ""
        kernels = f"lights {', '.join(self.lights)}, kernels of {self.kernel.shape[-1]} px, {self.diffraction}"
        return f"PsfBank({_name(self.camera)}, {levels}, {kernels})"


@dataclass(frozen=True, repr=False, eq=False)
class DepthEstimate:
    """What a depth method estimates from a capture: the blur level or the depth of every pixel, NaN where unknown.

    Give exactly one of ``level`` and ``depth_m``, each of the raw frame's shape; InputError for anything else.
    """

    # [h, w] blur level of the bank, fractional; 0 in focus, larger nearer, negative behind the focus
    level: NDArray[np.floating] | None = None
    depth_m: NDArray[np.floating] | None = None  # [h, w] z from the lens plane in metres, never range
    sd: NDArray[np.floating] | None = None  # [h, w] standard deviation, in levels or metres as the map; None: unknown
    joined: bool = False  # whether the map is already regularised; it is not regularised again, unless it has gaps
    side: Side = "assumed"  # of the focus: everything is assumed to be nearer, or the picture determines the side
    align_steps: bool = False  # whether its depth discontinuities are to be moved to edges of the all-in-focus picture

    def __post_init__(self) -> None:
        """Raise InputError for an invalid estimate."""
        if (self.level is None) == (self.depth_m is None):
            given = "neither" if self.level is None else "both"
            raise InputError(f"depth estimate: {given} of level and depth_m given; give one of them")
        if self.side not in get_args(Side):
            raise InputError(f"depth estimate: side is {self.side!r}; allowed are {', '.join(get_args(Side))}")
        name = "depth_m" if self.level is None else "level"
        estimate = _map(getattr(self, name), name)
        if np.isinf(estimate).any():
            raise InputError(f"depth estimate: {name} holds infinite values; NaN marks pixels without an estimate")
        if self.depth_m is not None and np.any(self.depth_m <= 0):
            raise InputError(
                f"depth estimate: depth_m goes down to {np.nanmin(self.depth_m):g} m; depths are metres above 0, "
                "NaN where there is no estimate"
            )
        if self.sd is None:
            return
        if _map(self.sd, "sd").shape != estimate.shape:
            raise InputError(
                f"depth estimate: sd has the shape {self.sd.shape}, {name} has {estimate.shape}; they must be equal"
            )
        if not np.all(self.sd[np.isfinite(estimate)] >= 0):
            raise InputError(
                f"depth estimate: sd is NaN or negative where {name} has a value; standard deviations are 0 or more"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self._map.shape
        return height, width

    @property
    def coverage(self) -> float:
        """Share 0..1 of the pixels that have an estimate."""
        return float(np.isfinite(self._map).mean())

    def __repr__(self) -> str:
        values = _range(self._map) if self.level is None else _range(self._map, "level", "")
        sd = "unknown sd" if self.sd is None else "sd"
        return f"DepthEstimate({_size(self._map)}, {values}, coverage {self.coverage:.1%}, {sd}, side {self.side})"

    @property
    def _map(self) -> NDArray[np.floating]:
        found = self.depth_m if self.level is None else self.level
        assert found is not None  # checked when made
        return found


def _map(image: Any, name: str) -> NDArray[np.floating]:
    """The image, if it is a floating-point NumPy array [h, w]; InputError otherwise."""
    if not isinstance(image, np.ndarray):
        raise InputError(f"depth estimate: {name} is of type {type(image).__name__}; give a NumPy array [h, w]")
    if image.dtype.kind != "f" or image.ndim != 2 or not image.size:
        raise InputError(
            f"depth estimate: {name} is an array of {image.dtype} of shape {image.shape}; give floating-point numbers "
            "of shape [h, w]"
        )
    return image


@dataclass(frozen=True, repr=False, eq=False)
class Reconstruction:
    """The result of a reconstruction; pictures and maps have the size of the raw frame.

    ``level_raw`` is NaN where there is no estimate; ``level``, ``depth_m`` and ``confidence`` cover every pixel.
    """

    rgb: Float32Array  # [h, w, 3] sRGB 0..1, the picture as taken
    sharp_rgb: Float32Array  # [h, w, 3] sRGB 0..1, all in focus
    linear_e: Float32Array  # [h, w, 3] linear colours as the axis records them, infrared removed, electrons
    sharp_e: Float32Array  # [h, w, 3] the same, all in focus
    ir_e: Float32Array  # [h, w] infrared, electrons
    level_raw: Float32Array  # [h, w] eq. (12), NaN where there is no edge
    level: Float32Array  # [h, w] eq. (13), everywhere; negative behind the focus
    depth_m: Float32Array  # [h, w] z from the lens plane, metres, from ``level``
    confidence: Float32Array  # [h, w] 0..1
    camera: Camera
    light: str  # the bank's light, chosen by white balance
    settings: dict[str, Any]
    timings_s: dict[str, float]
    bank: dict[str, Any] = field(default_factory=dict)  # identity of the bank, see dasim.files.banks.bank_identity
    notes: tuple[str, ...] = ()  # what a user should know of this result
    method: str | None = None  # name of the depth method, where ``settings`` did not choose it
    side: Side = "assumed"  # of the focus, see ``DepthEstimate``

    def __repr__(self) -> str:
        made = f"method {self.method}" if self.method else f"score {self.settings.get('score', 'unknown')}"
        depths = _range(self.depth_m)
        return f"Reconstruction({_size(self.level)}, {_name(self.camera)}, {depths}, light {self.light}, {made})"


@dataclass(frozen=True, repr=False, eq=False)
class Developed:
    """The colour picture of a capture alone, without depth."""

    rgb: Float32Array  # [h, w, 3] sRGB 0..1
    linear_e: Float32Array  # [h, w, 3] linear colours as the axis records them, infrared removed, electrons
    ir_e: Float32Array | None  # [h, w] infrared, electrons; None for a mosaic without
    matrix: NDArray[np.float64]  # [3, 3] from ``linear_e`` to linear sRGB, white-balanced
    camera: Camera
    light: str  # chosen by white balance
    settings: dict[str, Any]
    timings_s: dict[str, float]

    def __repr__(self) -> str:
        return f"Developed({_size(self.rgb)}, {_name(self.camera)}, light {self.light})"


def _size(image: NDArray[Any]) -> str:
    """Width and height of an image [h, w, ...]."""
    return f"{image.shape[1]} x {image.shape[0]} px"


def _name(camera: Camera) -> str:
    """Name and focus of a camera."""
    return f"{camera.name} focused at {camera.lens.focus_distance_m:g} m"


def _range(values: NDArray[Any], name: str = "depth", unit: str = " m") -> str:
    """Smallest and largest finite value."""
    known = values[np.isfinite(values)]
    return f"{name} {known.min():.3g} to {known.max():.3g}{unit}" if known.size else f"no {name}"
