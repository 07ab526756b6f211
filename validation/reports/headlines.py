"""The figures of the demo that a reader sees first, with their limits, in words.

Tested in tests/validation/reports/test_headlines.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from validation.gates.claim import Claim
from validation.gates.limits import bounds


class Headline(NamedTuple):
    """A figure with its name, value and limit in words."""

    claim: Claim
    title: str
    value: str
    limit: str  # empty without one


class _Words(NamedTuple):
    """Name of a figure, and its unit after ``value * factor`` with some decimals."""

    title: str
    factor: float
    decimals: int
    unit: str


_FIGURES = {
    "raw.all.coverage": _Words("pixels with an estimate of depth, before regularisation", 100, 0, " %"),
    "raw.all.level-median": _Words("median depth error where estimated; a level is 1.85 px of blur", 1, 2, " levels"),
    "raw.all.level-ratio": _Words("median error relative to the best constant depth map", 100, 0, " %"),
    "regularised.all.abs-rel": _Words("mean error of the depth map, relative to the distance", 100, 0, " %"),
    "regularised.error-surer-half": _Words("mean depth error, half with the higher confidence", 1, 2, " levels"),
    "all-in-focus.blurred.psnr-gain": _Words("gain of the all-in-focus picture where it was blurred", 1, 1, " dB"),
    "all-in-focus.blurred.ssim": _Words("SSIM of the all-in-focus picture, blurred regions", 1, 2, ""),
    "all-in-focus.blurred.ciede2000": _Words("mean colour error there, CIEDE2000", 1, 1, ""),
}  # fmt: skip
IDS = tuple(_FIGURES)


def headlines(claims: Sequence[Claim]) -> list[Headline]:
    """The headline figures among the demo's claims, in a fixed order."""
    by_id = {claim.id.partition(".")[2]: claim for claim in claims}
    return [
        Headline(by_id[name], words.title, _value(by_id[name].value, words), _limit(by_id[name].limit, words))
        for name, words in _FIGURES.items()
        if name in by_id
    ]


def _value(value: float, words: _Words) -> str:
    return f"{words.factor * value:.{words.decimals}f}{words.unit}" if math.isfinite(value) else "not measured"


def _limit(limit: str | None, words: _Words) -> str:
    """A limit such as ``<= 0.5`` in words, in the unit of the value."""
    if limit is None:
        return ""
    low, high = (f"{words.factor * end:g}" for end in bounds(limit))
    unit = words.unit.removesuffix("s") if "1" in (low, high) else words.unit
    strict = limit.lstrip()[:2].strip() in ("<", ">")
    if low == "-inf":
        return f"{'less than' if strict else 'at most'} {high}{unit}"
    if high == "inf":
        return f"{'more than' if strict else 'at least'} {low}{unit}"
    return f"from {low} to {high}{words.unit}"
