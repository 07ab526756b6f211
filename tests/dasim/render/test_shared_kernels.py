"""Kernels that random scenes share: none is compiled for one of them alone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import pytest

import dasim
from dasim.render import shared_kernels

SIZE_PX = (32, 24)
SPP = 2
SAME = """
import dasim
from dasim.render import shared_kernels
shared_kernels.FEW_SCENES = 99
camera = dasim.cropped(dasim.load_camera("da-mobile"), 32, 24)
scenes = [dasim.random_scene(0, number) for number in (2, 7, 8)]
def pictures():
    shots = [dasim.simulate(scene, dasim.focused(camera, scene), spp=2) for scene in scenes]
    return [getattr(shot.truth, name).tobytes() for shot in shots for name in ("mean_e", "sharp_e", "focus_e")]
before = pictures()
shared_kernels.hold()
assert pictures() == before
"""
FEWEST = 3  # rays through the lens, through a pinhole, and to the irradiance field


@pytest.fixture(scope="module")
def kernels_of(jit) -> Callable[[dasim.Scene], set[str]]:
    """Function that gives the hashes of a picture's kernels that have code of shapes, surfaces or lights."""
    camera = dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX)
    shared_kernels.hold()

    def hashes(scene: dasim.Scene) -> set[str]:
        with shared_kernels.recorded() as kernels:
            dasim.simulate(scene, dasim.focused(camera, scene), spp=SPP)
        return {kernel.name for kernel in kernels if kernel.has_plugins}

    return hashes


def test_the_plugins_are_held_from_the_third_scene_on(monkeypatch):
    """Expectation: two scenes, however often they are rendered, do without."""
    held = []
    monkeypatch.setattr(shared_kernels, "FEW_SCENES", 2)
    monkeypatch.setattr(shared_kernels, "_names", set())
    monkeypatch.setattr(shared_kernels, "hold", lambda: held.append(True))
    for name, times in (("one", 0), ("two", 0), ("one", 0), ("three", 1)):
        shared_kernels.hold_for_many(name)
        assert len(held) == times


@pytest.mark.slow
def test_the_plugins_that_are_held_change_no_bit(jit_variant):
    """Rationale: a scene has the same bytes as the first of a process and as its hundredth.

    Set-up: random scenes under a lamp, before metal and of several spectra, before and after.
    """
    assert subprocess.run([sys.executable, "-c", SAME], check=False).returncode == 0


@pytest.mark.slow
def test_two_random_scenes_have_the_same_kernels(kernels_of):
    """Set-up: a lamp before blends, layers and prints of two rules; a window before prints, a coat and glass.

    Expectation: the second needs no kernel that the first has not needed.
    """
    first, second = (kernels_of(dasim.random_scene(0, number)) for number in (2, 11))
    assert len(first) >= FEWEST
    assert second <= first


@pytest.mark.slow
def test_random_scenes_have_few_sets_of_kernels(kernels_of):
    """Set-up: lamps before metal and coats, two overcast skies; two scenes whose lamps have several spectra.

    Expectation: beside one scene under a lamp and one under a sky, and one of several spectra, none needs a kernel.
    """
    one, sky, several = (kernels_of(dasim.random_scene(0, number)) for number in (2, 0, 14))
    for number in (7, 10, 13):
        assert kernels_of(dasim.random_scene(0, number)) <= one | sky, f"random:0:{number}"
    assert kernels_of(dasim.random_scene(0, 29)) <= one | several


@pytest.mark.slow
def test_a_surface_that_random_scenes_lack_needs_other_kernels(kernels_of, make_scene):
    """Rationale: the comparison above can fail. Set-up: two plain discs, one under a smooth coat."""
    disc = {"name": "disc", "shape": "disc", "radius_cm": 5, "position_cm": (0, 0, 40)}
    gloss = {"kind": "coated", "base": "sand", "roughness": 0.0}
    matt = make_scene(disc | {"material": "sand"})
    glossy = make_scene(disc | {"material": "gloss"}, materials={"gloss": gloss})
    assert kernels_of(glossy) - kernels_of(matt)
