"""Checks of a simulation's input: options, cameras that a variant cannot render, and empty or dark pictures.

Tested in tests/dasim/simulation/test_simulate.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError, kind_of
from dasim.base.suggestions import did_you_mean
from dasim.camera.noise import Exposure
from dasim.camera.pointspread import DIFFRACTION_MODELS
from dasim.camera.specification import Camera
from dasim.render import stock
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation.adaptive_sampling import NOISE_AT, NOISE_SHARE
from dasim.typing import FloatArray

MOST_SPP = 65_536
PERCENTILE = (1.0, 99.9)  # of the pixels, at which a target of noise may be meant


def check_options(
    spp: int | str | None,
    seed: int,
    diffraction: str | None,
    noise_share: float = NOISE_SHARE,
    noise_at: float = NOISE_AT,
) -> None:
    """Raise InputError for samples, a seed, a diffraction model or a target of noise that no variant allows."""
    whole = isinstance(spp, (int, np.integer)) and not isinstance(spp, bool)
    if spp not in (None, "auto") and not whole:
        raise InputError(f"spp is {spp!r}; it must be a whole number or 'auto'")
    if whole and not 1 <= int(cast(int, spp)) <= MOST_SPP:
        raise InputError(f"spp is {spp}; 1 to {MOST_SPP} samples per pixel are allowed")
    for name, value in (("noise_share", noise_share), ("noise_at", noise_at)):
        if not isinstance(value, (int, float, np.number)):
            raise InputError(f"{name}: must be a number, not {kind_of(value)}")
    if not 0.01 <= noise_share <= 10:
        raise InputError(f"noise_share is {noise_share:g}; 0.01 to 10 of the sensor's own noise is allowed")
    if not PERCENTILE[0] <= noise_at <= PERCENTILE[1]:
        allowed = f"{PERCENTILE[0]:g} to {PERCENTILE[1]:g}"
        raise InputError(f"noise_at is {noise_at:g}; a percentile of the pixels of {allowed} is allowed, 50 the median")
    check_seed(seed)
    if diffraction is not None and diffraction not in DIFFRACTION_MODELS:
        hint = did_you_mean(diffraction, DIFFRACTION_MODELS)
        raise InputError(f"diffraction '{diffraction}' is unknown; allowed are {', '.join(DIFFRACTION_MODELS)}{hint}")


def check_seed(seed: int) -> None:
    """Raise InputError for a seed that is no whole number from 0."""
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be 0 or a positive whole number")


def check_exposure(exposure: Exposure | None) -> None:
    """Raise InputError for an exposure of another type, such as a time."""
    if not isinstance(exposure, Exposure | None):
        raise InputError(
            f"exposure: must be a dasim.Exposure, not {kind_of(exposure)}; for a time, Exposure(time_s=...)"
        )


def check_camera(camera: Camera, variant: str) -> None:
    """Raise InputError if the variant cannot render through the camera's stops and lens."""
    if variant.startswith("scalar"):
        stock.check(camera)


def diffraction_model(name: str | None, variant: str) -> str:
    """The diffraction model of a variant, its default for None; raises InputError if the variant does not have it."""
    scalar = variant.startswith("scalar")
    if name is None:
        return "airy" if scalar else "wave"
    allowed = ("airy", "off") if scalar else ("wave", "off")
    if name not in allowed:
        raise InputError(f"diffraction '{name}' is not available in {variant}; allowed are {', '.join(allowed)}")
    return name


def check_in_view(scene: Scene | MitsubaScene, depth_m: FloatArray) -> None:
    """Raise InputError if the ray of no pixel hits a surface."""
    if np.isnan(depth_m).all():
        units = f"; unit_cm is {scene.unit_cm:g}" if isinstance(scene, MitsubaScene) else ""
        raise InputError(
            f"scene '{scene.name}': the camera looks at nothing; turn its view towards an object, or move one into it"
            + units
        )


def check_finite(
    scene: Scene | MitsubaScene, rate: NDArray[np.floating], objects_at: Callable[[NDArray[np.bool_]], list[str]]
) -> None:
    """Raise InputError if the light of a picture, [h, w, channel], is infinite or NaN.

    ``objects_at`` gives the names of the objects in some pixels, [h, w].
    """
    wrong = np.asarray(~np.isfinite(rate).all(axis=-1))
    if wrong.any():
        raise InputError(
            f"scene '{scene.name}': light is infinite or not a number in {np.count_nonzero(wrong)} of {wrong.size} "
            f"pixels, which look at {_listed(objects_at(wrong)) or 'the background'}; give materials, textures, lights "
            "and transforms finite values"
        )


def check_lit(scene: Scene | MitsubaScene, rate: FloatArray, names_in_view: list[str]) -> None:
    """Raise InputError if no light reaches the sensor; ``names_in_view`` are the objects in front of it."""
    if rate.max() <= 0:
        looks_at = _listed(names_in_view) or "a lamp from behind"
        raise InputError(
            f"scene '{scene.name}': no light reaches the sensor, which looks at {looks_at}; is "
            "a light hidden or turned away, the camera inside an object, or a light so small as to need more samples?"
        )


def _listed(names: list[str]) -> str:
    """The first three names."""
    return ", ".join(f"'{name}'" for name in names[:3]) + (" and others" if len(names) > 3 else "")
