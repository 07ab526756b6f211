"""Software and hardware that determine the pixels of a dataset."""

from __future__ import annotations

import platform
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dasim.render import backend

LIBRARIES = (  # that determine the bytes of pixels and files
    *("mitsuba", "drjit", "numpy", "scipy", "numba", "opencv-python-headless", "scikit-image"),
    *("trimesh", "OpenEXR", "pyarrow"),
)
NVIDIA = Path("/proc/driver/nvidia")  # information provided by NVIDIA's driver for Linux


@lru_cache(maxsize=1)
def environment(variant: str) -> dict[str, Any]:
    """Software and hardware that determine pixels: variant, LLVM, instruction set and libraries; with CUDA also the
    graphics cards and their driver.
    """
    from numpy._core._multiarray_umath import __cpu_features__ as features  # type: ignore[import-not-found]

    cards = {"gpu": _graphics_cards(NVIDIA)} if variant.startswith("cuda") else {}
    return {
        "variant": variant,
        "llvm": backend.choose(variant).llvm,
        "cpu": f"{platform.machine()} " + " ".join(sorted(name for name, on in features.items() if on)),
        **cards,
        "libraries": {name: _version(name) for name in ("dasim", *LIBRARIES)},
    }


def _graphics_cards(folder: Path) -> list[str]:
    """Models of the graphics cards and the version of their driver; empty where its folder does not exist (WSL)."""
    lines = [line for file in folder.glob("gpus/*/information") for line in file.read_text().splitlines()]
    models = {line.partition(":")[2].strip() for line in lines if line.startswith("Model:")}
    version = folder / "version"
    return [*sorted(models), *(version.read_text().splitlines()[:1] if version.is_file() else [])]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
