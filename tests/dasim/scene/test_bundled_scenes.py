"""The pictorial scenes that are bundled: depths in view, focus, and what shows in the near-infrared."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import dasim
from dasim.camera import depth_blur, geometry, radiometry
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.materials.surfaces import Diffuse, Mixture
from dasim.render import truth
from dasim.scene import object_materials
from dasim.scene import specification as scenes
from dasim.scene.loading import load_scene
from dasim.spectra import grid

CROP, WHOLE = (64, 48, 8 * 1.7), (128, 96, 16 * 1.7)  # pixels and pitch in um: 512 x 384 and all of da-mobile
RANGES_CM = {  # the nearest depth in the central crop may lie a little within the range
    "flowers": (20, 80),
    "adam": (20, 80),
    "desk": (5, 40),
    "disks": (5, 10),
    "fence": (25, 150),
}
FOCUS_CM = {"flowers": 80, "adam": 80, "desk": 40, "disks": 12, "fence": 150}
WITHIN = 0.10  # of the near end: a leaf is no ruler


@pytest.fixture(scope="module")
def view(loaded, wide):
    @cache
    def make(name: str, pixels: tuple[int, int, float]):
        scene = load_scene(name)
        camera = wide(*pixels, scene.focus_cm * 1e-2)
        return scene, camera, truth.geometry(loaded(scene), camera)

    return make


@pytest.mark.parametrize("name", sorted(RANGES_CM))
def test_depths_in_view_span_the_range_and_the_focus_is_at_its_end(name, view):
    near, far = RANGES_CM[name]
    scene, _, maps = view(name, CROP)
    depth_cm = maps.depth_m * 100
    assert np.isfinite(depth_cm).all()
    assert near * (1 - WITHIN) <= depth_cm.min() <= near * (1 + WITHIN)
    assert depth_cm.max() == pytest.approx(far, rel=0.01)
    assert scene.focus_cm == FOCUS_CM[name]
    assert scene.description


@pytest.mark.parametrize("name", ["flowers", "adam", "disks", "fence"])
def test_the_whole_sensor_is_filled(name, view):
    _, _, maps = view(name, WHOLE)
    assert np.isfinite(maps.depth_m).mean() > 0.99
    assert np.nanmax(maps.depth_m) * 100 == pytest.approx(RANGES_CM[name][1], rel=0.01)


def _shares(name, view) -> dict[str, float]:
    """Share of the central crop that each object fills."""
    scene, _, maps = view(name, CROP)
    return {item.name: float((maps.object_id == number).mean()) for number, item in enumerate(scene.objects, start=1)}


def test_adam_is_in_the_middle_before_a_wall_in_focus(view):
    shares = _shares("adam", view)
    assert 0.05 < shares["skin"] and 0.15 < sum(shares[part] for part in ("skin", "hair", "shirt")) < 0.5
    scene, _, maps = view("adam", CROP)
    numbers = {item.name: number for number, item in enumerate(scene.objects, start=1)}
    wall = np.isin(maps.object_id, [numbers[part] for part in ("wall", "poster", "picture")])
    assert wall.mean() > 0.3
    full = cameras.refocused(cameras.load_camera("da-mobile"), scene.focus_cm * 1e-2)
    blur_px = geometry.blur_px(full, maps.depth_m)
    assert np.abs(blur_px[wall]).max() < 0.1
    assert blur_px[maps.object_id == numbers["skin"]].min() > 5
    assert {light.illuminant for light in scene.lights} == {"energy-saving-3500K"}


def test_fence_is_thin_and_its_boundaries_are_many(view, loaded):
    shares = _shares("fence", view)
    assert shares["wires"] > 0.05 and shares["wall"] + shares["lawn"] > 0.4
    scene, _, _ = view("fence", CROP)
    camera = cameras.cropped(cameras.refocused(cameras.load_camera("da-mobile"), 1.5), 512, 384)
    maps = truth.geometry(loaded(scene), camera)
    assert depth_blur.boundary(depth_blur.signed_blur_px(maps.depth_m, camera)).mean() > 0.3
    # A wire is about as wide as its blur.
    wire_px = 0.1e-2 * geometry.image_distance_m(camera) / (0.25 * 1.7e-6)
    assert 0.5 < geometry.blur_px(camera, 0.25) / wire_px < 2


def _mean_reflectance(surface) -> np.ndarray:
    """Mean over a surface's area, its weights taken as independent."""
    if isinstance(surface, Mixture):
        share = float(surface.weight.mean())
        return (1 - share) * _mean_reflectance(surface.first) + share * _mean_reflectance(surface.second)
    assert isinstance(surface, Diffuse)
    return surface.reflectance


@pytest.mark.parametrize("name", ["leaf-near", "leaf-low", "daisy-stem", "meadow"])
def test_leaves_are_dark_in_red_and_bright_in_the_near_infrared(name):
    scene = load_scene("flowers")
    item = next(item for item in scene.objects if item.name == name)
    curve = _mean_reflectance(object_materials.surface_of(item, scene))
    red, infrared = (curve[np.abs(grid.WAVELENGTH_NM - middle) <= 15].mean() for middle in (670, 780))
    assert red < 0.12
    assert infrared > 3.5 * red


@pytest.mark.parametrize("name", ["daisy", "poppy", "dahlia", "violet"])
def test_petals_of_all_colours_are_bright_in_the_near_infrared(name):
    scene = load_scene("flowers")
    item = next(item for item in scene.objects if item.name == name)
    curve = _mean_reflectance(object_materials.surface_of(item, scene))
    assert curve[grid.WAVELENGTH_NM >= 720].min() > 0.4


# --- the disks, rendered -------------------------------------------------------------------------

RENDERED = 0.04  # light falls off between a disk and the paper beside it, and 32 samples are noisy


@pytest.fixture(scope="module")
def disks(wide, renderer):
    scene = load_scene("disks")
    camera = wide(*CROP, 0.12)
    shot = dasim.simulate(scene, camera, seed=0, spp=32)
    return scene, camera, shot.truth


def _contrast(disks, sheet: str, ink: str) -> np.ndarray:
    """1 - disk / paper around it of R, G, B and IR, sharp."""
    scene, _, maps = disks
    numbers = {item.name: number for number, item in enumerate(scene.objects, start=1)}
    disk = maps.object_id == numbers[f"{sheet}-{ink}"]
    rows, columns = np.nonzero(disk)
    around = np.zeros_like(disk)
    around[rows.min() - 1 : rows.max() + 2, columns.min() - 1 : columns.max() + 2] = True
    around &= maps.object_id == numbers[f"{sheet}-sheet"]
    inside = disk.copy()
    for axis in (0, 1):  # without its rim, which holds paper too
        inside &= np.roll(disk, 1, axis) & np.roll(disk, -1, axis)
        around &= ~np.roll(disk, 1, axis) & ~np.roll(disk, -1, axis)
    channels = [maps.channels.index(name) for name in ("R", "G", "B", "IR")]
    return 1 - (maps.sharp_e[inside].mean(axis=0) / maps.sharp_e[around].mean(axis=0))[channels]


@pytest.mark.parametrize("sheet", ["near", "far"])
def test_yellow_disks_vanish_in_the_near_infrared_and_black_ones_do_not(disks, sheet):
    red, green, blue, infrared = 0, 1, 2, 3
    yellow, magenta, cyan, black = (_contrast(disks, sheet, ink) for ink in ("yellow", "magenta", "cyan", "black"))
    assert abs(yellow[infrared]) < RENDERED and yellow[blue] > 0.5
    assert abs(magenta[infrared]) < RENDERED and magenta[green] > 0.5
    assert 0.1 < cyan[infrared] < 0.5 < cyan[red] + 0.15
    assert black.min() > 0.85


def test_disk_contrasts_are_those_of_the_inks_spectra(disks):
    """As rendered and by the integral of light, reflectance and response, which knows nothing of the renderer."""
    from dasim.materials.library import reflectance

    scene, camera, _ = disks
    weight = radiometry.response(camera) * scenes.light_spectrum(scene)
    paper = reflectance("white-paper")
    for ink in ("cyan", "magenta", "yellow"):
        expected = 1 - (weight @ reflectance(f"ink-{ink}")) / (weight @ paper)
        order = [sensors.channels(camera.sensor).index(name) for name in ("R", "G", "B", "IR")]
        assert np.allclose(_contrast(disks, "far", ink), expected[order], atol=RENDERED)
