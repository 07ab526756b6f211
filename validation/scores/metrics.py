"""A user's metrics: functions of an estimated depth map and the truth.

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


def load_metrics(names: Sequence[str]) -> list[Metric]:
    """Metrics from a user's list: ``package.module:function``, ``file.py:function``, or NAME=FUNCTION."""
    metrics: list[Metric] = []
    for text in names:
        name, equals, source = text.partition("=")
        if not equals or ":" in name:
            name, source = "", text
        metric = load_function(source, "metric")
        if name:
            if not name.replace("-", "_").isidentifier():
                raise InputError(f"metric '{text}': '{name}' is not a valid name; allowed are letters, digits, - and _")
            metric = functools.partial(metric)
            metric.__name__ = name  # type: ignore[attr-defined]
        if metric_name(metric) in map(metric_name, metrics):
            raise InputError(
                f"metric '{text}': two metrics have the name '{metric_name(metric)}'; give one as NAME={text}"
            )
        metrics.append(metric)
    return metrics


def metric_name(metric: Metric) -> str:
    """Name of the metric, used in the ids of its figures."""
    return str(getattr(metric, "__name__", type(metric).__name__))


def metric_figures(depth_map: str, depth_m: NDArray, truth: Truth, metrics: Sequence[Metric]) -> list[Figure]:
    """Figures MAP.METRIC, or MAP.METRIC-KEY if a metric returns several numbers; raises InputError if
    a metric fails.
    """
    figures: list[Figure] = []
    for metric in metrics:
        name = metric_name(metric)
        try:
            values = metric(depth_m, truth)
        except (Exception, SystemExit) as error:
            raise InputError(
                f"metric '{name}': stopped by {type(error).__name__}: {' '.join(str(error).split())}"
            ) from error
        named = (
            {f"{name}-{key}": value for key, value in values.items()} if isinstance(values, Mapping) else {name: values}
        )
        for key, value in named.items():
            if not isinstance(value, numbers.Real):
                raise InputError(
                    f"metric '{name}': gives {type(value).__name__}; it must be a number, or a dict of numbers"
                )
            meaning = (metric.__doc__ or "your metric").strip().split("\n")[0].rstrip(".")
            figures.append(Figure(f"{depth_map}.{key}", float(value), "1", meaning))
    return figures
