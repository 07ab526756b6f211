"""Metrics of one's own: functions of an estimated depth map and the truth.

Tested in tests/validation/test_methods.py.
"""

from __future__ import annotations

import functools
import numbers
from collections.abc import Callable, Mapping, Sequence

from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.base.loading import load_function
from dasim.typing import FloatArray
from dasim.values import Truth
from validation.scores.figures import Figure

Metric = Callable[[FloatArray, Truth], float | Mapping[str, float]]
"""From a depth map [h, w] in metres, NaN where there is no estimate, and the truth, to a number or named numbers."""


def load_metrics(given: Sequence[str]) -> list[Metric]:
    """Metrics as a user names them: ``package.module:function``, ``file.py:function``, or NAME=FUNCTION."""
    found: list[Metric] = []
    for text in given:
        name, equals, source = text.partition("=")
        if not equals or ":" in name:
            name, source = "", text
        metric = load_function(source, "metric")
        if name:
            if not name.replace("-", "_").isidentifier():
                raise InputError(f"metric '{text}': '{name}' is no name; allowed are letters, digits, - and _")
            metric = functools.partial(metric)
            metric.__name__ = name  # type: ignore[attr-defined]
        if metric_name(metric) in map(metric_name, found):
            raise InputError(
                f"metric '{text}': two metrics have the name '{metric_name(metric)}'; give one as NAME={text}"
            )
        found.append(metric)
    return found


def metric_name(metric: Metric) -> str:
    """Name of the function, which its figures carry."""
    return str(getattr(metric, "__name__", type(metric).__name__))


def metric_figures(depth_map: str, depth_m: NDArray, truth: Truth, metrics: Sequence[Metric]) -> list[Figure]:
    """MAP.METRIC, or MAP.METRIC-KEY where a metric gives several numbers; InputError where it fails."""
    figures: list[Figure] = []
    for metric in metrics:
        name = metric_name(metric)
        try:
            found = metric(depth_m, truth)
        except Exception as error:
            raise InputError(
                f"metric '{name}': stopped by {type(error).__name__}: {' '.join(str(error).split())}"
            ) from error
        named = (
            {f"{name}-{key}": value for key, value in found.items()} if isinstance(found, Mapping) else {name: found}
        )
        for key, value in named.items():
            if not isinstance(value, numbers.Real):
                raise InputError(
                    f"metric '{name}': gives {type(value).__name__}; a number, or a dict of numbers, is needed"
                )
            meaning = (metric.__doc__ or "your metric").strip().split("\n")[0].rstrip(".")
            figures.append(Figure(f"{depth_map}.{key}", float(value), "1", meaning))
    return figures
