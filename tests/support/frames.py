"""Random scenes in frames of any size; ``python -m tests.support.frames --seeds 1000`` draws many, 0.1 s each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import dasim
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.scene import checks

CAMERAS = ("da-mobile", "da-8mm")
SIZES = ((8, 8), (16, 12), (48, 36), (8, 200), (200, 8))


def problems(camera: str, size: tuple[int, int], seeds: range) -> Iterator[str]:
    """What is wrong with the scenes of some seeds in a frame: textures that repeat too often, a floor on the lens."""
    view = cameras.cropped(cameras.load_camera(camera), *size)
    for index in seeds:
        try:
            scene = dasim.random_scene(1, index, camera=view)
            checks.check_clear(scene, geometry.aperture_m(dasim.focused(view, scene)) / 2)
        except InputError as error:
            yield f"{camera}, {size[0]}x{size[1]}, random:1:{index}: {error}"


def main() -> int:
    """Draw the scenes that the arguments name; status 1 where some are not valid."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="of each camera and size")
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    found = 0
    for camera in CAMERAS:
        for size in SIZES:
            for problem in problems(camera, size, range(chosen.first, chosen.first + chosen.seeds)):
                found += 1
                print(problem)
            print(f"{camera}, {size[0]}x{size[1]}: {chosen.seeds} seeds, {found} problems so far", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
