"""Settings of the reconstruction, and the bundled presets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification, parse_toml

Alpha = Annotated[float, Field(ge=0, le=10)]  # near-infrared of a colour over that of infrared pixels


class Settings(Specification):
    """Settings of :func:`recon.reconstruct`; its own defaults are the preset ``PAPER``."""

    # sec. 4.1
    denoise: bool = Field(default=True, description="nonlocal means of the colour planes")
    denoise_bandwidth: float = Field(default=3.0, gt=0, le=100, description="tau of eq. (4), in noise variances")
    denoise_patch_sigma_px: float = Field(default=1.0, gt=0, le=10, description="rho of eq. (5), plane pixels")

    # sec. 4.4
    infrared_removal: Literal["coefficients", "matrix"] = Field(
        default="coefficients", description="eq. (7), or a full 4x4 crosstalk matrix"
    )
    crosstalk: tuple[Alpha, Alpha, Alpha] | None = Field(
        default=None,
        description="measured alpha of eq. (8) for R, G, B; by default from the response curves; with "
        "infrared_removal = 'matrix' for depth alone",
    )

    # sec. 5.2
    window_px: int = Field(default=31, ge=5, le=201, description="delta of eq. (11), side of the patch")
    window: Literal["gaussian", "box"] = "gaussian"
    alike: bool = Field(
        default=False, description="weight the samples of a patch by similarity of colour; for the score bands"
    )
    gradient: Literal["sum", "both"] = Field(
        default="both", description="eq. (11): NCC of the sum of the two derivatives, or of both derivatives jointly"
    )
    cutoff_cycles_px: float = Field(default=0.16, ge=0.02, le=0.25, description="upper limit of the frequency band")
    score: Literal["ncc", "likelihood", "bands", "colour-line", "joint"] = Field(
        default="ncc",
        description="score of a level: eq. (11), likelihood, transfer in bands, Chakrabarti and Zickler's, or joint: "
        "of all of a channel's spectrum, joined over surfaces before a level is chosen",
    )
    windows: Literal["all", "large"] = Field(
        default="all", description="of the score joint: two sizes and the score bands, or the large ones alone"
    )
    prior_factor: float = Field(default=1.0, gt=0, le=1e4, description="factor on the measured beta of eq. (9)")
    diagonals: Literal["right", "published"] = Field(
        default="right", description="diagonal gradients of the colour line: orthogonal, or as in the published code"
    )
    edge_snr: float = Field(default=0.5, ge=0, le=1000, description="least gradient energy over noise at an edge")
    fallback: bool = Field(default=True, description="red, then blue, where infrared has no edge (sec. 5.3)")
    saturated_share: float = Field(
        default=0.05, ge=0, le=1, description="largest share of saturated pixels in a window with an estimate"
    )
    least_confidence: float = Field(
        default=0.0, ge=0, lt=1, description="least confidence of a raw level, 0..1; below it, no estimate"
    )
    regularise_bandwidth: float = Field(default=60.0, gt=0, le=1e4, description="tau of eq. (14), in noise variances")

    # sec. 5.4
    sharpen_prior: Literal["gradients", "network"] = Field(
        default="gradients", description="all-in-focus picture: eq. (15)-(17), or Wiener filters and a network"
    )
    sharpen_networks: int = Field(
        default=2, ge=1, le=2, description="networks whose all-in-focus pictures are averaged; 1 is faster"
    )
    sharpen_consistency: bool = Field(
        default=True, description="what the captured picture says beyond the networks' is added; without it is faster"
    )
    sharpen_steps: int = Field(default=3, ge=1, le=40, description="iterations of half-quadratic splitting")
    sharpen_strength: float = Field(
        default=6.0, gt=0, le=100, description="weight of the data in eq. (15); 1 is that of the noise"
    )
    sharpen_guide: bool = Field(
        default=True, description="prior of eq. (16) about the gradients of sharp infrared, then of the mean colour"
    )


PAPER = Settings()
PRESETS = {
    "paper": PAPER,
    "likelihood": Settings(score="likelihood"),
    "best": Settings(score="joint", window_px=35, alike=True, least_confidence=0.6, sharpen_prior="network"),
    "fast": Settings(
        score="joint",
        windows="large",
        least_confidence=0.6,
        sharpen_prior="network",
        sharpen_networks=1,
        sharpen_consistency=False,
    ),
    "bands": Settings(score="bands", window_px=35, alike=True, edge_snr=0.0, fallback=False, least_confidence=0.6),
    "chakrabarti-zickler": Settings(score="colour-line"),
}
DESCRIPTIONS = {
    "paper": "normalised cross-correlation of green and near-infrared, as in the paper",
    "likelihood": "the paper's windows and bank; levels scored by likelihood",
    "best": "joint likelihood of green and near-infrared in windows of two sizes and the score bands, joined over "
    "surfaces by two networks",
    "fast": "as best in large windows only, without the score bands and the depth networks, and with one picture "
    "network: less accurate, 2.5 times as fast",
    "bands": "transfer from near-infrared to red and green in bands of frequency, in patches that follow the surface",
    "chakrabarti-zickler": "colour lines, the closest prior work, with the same bank and windows",
}


DEFAULT_PRESET = "best"  # has the smallest errors on scenes that nothing was chosen on
DEFAULT = PRESETS[DEFAULT_PRESET]


def preset(name: str) -> Settings:
    """The settings of a preset; raises InputError for an unknown name."""
    if name not in PRESETS:
        raise InputError(f"preset '{name}' is unknown; allowed are {', '.join(PRESETS)}{did_you_mean(name, PRESETS)}")
    return PRESETS[name]


def select(name: str | None, file: Path | None) -> Settings:
    """The settings of a preset or of a TOML file; ``DEFAULT`` where neither is given."""
    if name is not None and file is not None:
        raise InputError("--preset and --settings exclude each other; give one of them")
    return parse_toml(Settings, file) if file is not None else preset(name or DEFAULT_PRESET)


def preset_name(settings: Settings) -> str | None:
    """Name of the preset with these settings, None if no preset has them."""
    return next((name for name, candidate in PRESETS.items() if candidate == settings), None)


def to_toml(settings: Settings) -> str:
    """The settings in TOML, each with its description; :func:`dasim.base.toml.parse_toml` reads them.

    A setting without a value becomes a comment.
    """
    lines = [f"# Settings of 'dasim recon --settings FILE'; preset: {preset_name(settings) or 'none'}"]
    for name, field in Settings.model_fields.items():
        value = getattr(settings, name)
        line = f"{name} = {_toml_value(value)}" if value is not None else f"# {name} = (by default)"
        lines.append(f"{line}  # {field.description}" if field.description else line)
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    return json.dumps(value)  # strings, numbers and booleans have the same syntax in JSON and TOML
