"""Lights: level, spectrum and direction of each kind, on a white diffuser that is rendered."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.materials.library import reflectance
from dasim.scene import loading, panorama
from dasim.scene import specification as scenes
from dasim.scene.lights import direction
from dasim.scene.specification import Scene
from dasim.spectra import grid, illuminants

LEVEL = 0.01  # the level that a light is sold with
AT_NM = (450.0, 550.0, 700.0, 800.0)  # of one ray; 800 nm lies beyond what RGB and the CIE's tables reach
MATERIAL = "white-paper"
RAYS, SCALAR_RAYS = 1 << 18, 1 << 14  # noise of a mean below 0.3 and 0.7 %

UP, LEFT, AHEAD, BACK = (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
ASKEW = tuple(np.array([30, -20, -30]) / np.linalg.norm([30, -20, -30]))  # towards the lamp
KINDS: dict[str, tuple[dict, tuple[float, float, float]]] = {  # the light, and where its diffuser faces
    "dome": ({"illuminant": "A"}, LEFT),
    "lamp": ({"illuminant": "D65", "position_cm": [30, -20, -30], "target_cm": [0, 0, 0], "radius_cm": 10}, ASKEW),
    "panel": ({"illuminant": "F11", "position_cm": [0, -40, 0], "target_cm": [0, 0, 0], "size_cm": [60, 30]}, UP),
    "bulb": ({"illuminant": "LED-B1", "position_cm": [0, 0, -20], "target_cm": [0, 0, 0], "radius_cm": 6}, BACK),
    "sun": ({"illuminant": "sun-30deg", "elevation_deg": 30, "azimuth_deg": 70}, tuple(direction(30, 70))),
    "sky": ({"illuminant": "sky-30deg"}, UP),
    "overcast": ({"kind": "sky", "illuminant": "D75", "distribution": "overcast"}, UP),
    "clear": ({"kind": "sky", "illuminant": "D75", "distribution": "clear", "sun_azimuth_deg": 30}, UP),
    "daylight": ({"elevation_deg": 40, "azimuth_deg": 200}, UP),
    "environment": ({"illuminant": "energy-saving-3500K", "image": "map.png", "rotation_deg": 25}, UP),
}


def lit(folder: Path, facing, *sources: dict) -> Scene:
    """A small white diffuser at the origin of the scene, facing somewhere, seen by nobody."""
    x, y, z = facing
    # A plane faces -z: turned about x, then about y.
    turn = [float(np.degrees(np.arcsin(np.clip(y, -1, 1)))), float(np.degrees(np.arctan2(-x, -z))), 0.0]
    plane = {"name": "card", "shape": "plane", "material": MATERIAL, "size_cm": [0.1, 0.1], "rotation_deg": turn}
    view = {"position_cm": [3, -5, -70], "look_at_cm": [2, 1, 0]}  # askew, so that all axes count
    data = {"name": "test", "lights": list(sources), "objects": [plane], "folder": folder, "view": view}
    return parse(Scene, data, "test")


def radiance(scene: Scene, facing, rays: int = 0) -> np.ndarray:
    """Radiance of the diffuser at ``AT_NM``, W m^-2 sr^-1 nm^-1, the mean of many paths."""
    import drjit as dr
    import mitsuba as mi

    from dasim.render import translate

    scalar = mi.variant().startswith("scalar")
    rays = rays or (SCALAR_RAYS if scalar else RAYS)
    loaded = translate.load(scene)
    axes = scenes.world_to_camera(scene)
    start, towards = axes[:3, :3] @ np.multiply(facing, 0.01) + axes[:3, 3], -axes[:3, :3] @ np.array(facing)
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    sampler = mi.load_dict({"type": "independent", "sample_count": rays})
    ray = mi.RayDifferential3f(mi.Point3f(*start.tolist()), mi.Vector3f(*towards.tolist()))
    ray.wavelengths = mi.Spectrum(*AT_NM)
    if scalar:
        sampler.seed(0)
        samples = [np.array(integrator.sample(loaded, sampler, ray)[0]) for _ in range(rays)]
        return np.mean(samples, axis=0)
    sampler.seed(0, rays)
    samples = integrator.sample(loaded, sampler, ray)[0]
    return np.array([dr.mean(samples[k]).numpy().item() for k in range(4)])


def source(kind: str, folder: Path, lux: float = 700.0) -> dict:
    if kind == "environment":
        rng = np.random.default_rng(1)
        cv2.imwrite(str(folder / "map.png"), rng.integers(10, 255, (16, 32, 3), dtype=np.uint8))
    return {"kind": kind, "lux": lux, **KINDS[kind][0]}


def expected(light: dict, scene: Scene) -> np.ndarray:
    """The diffuser's radiance, rho E / pi, with E of the light's own level and illuminant."""
    name = scene.lights[0].illuminant
    curve = light["lux"] * illuminants.illuminant(name) * reflectance(MATERIAL) / np.pi
    return np.interp(AT_NM, grid.WAVELENGTH_NM, curve)


@pytest.mark.parametrize("kind", KINDS)
def test_level_and_spectrum(kind, tmp_path, renderer):
    """Rationale: scenes are lit in lux, from 400 to 830 nm. Expectation: a diffuser has the radiance rho E / pi at
    450, 550, 700 and 800 nm, to within 1 %.
    """
    light = source(kind, tmp_path)
    scene = lit(tmp_path, KINDS[kind][1], light)
    np.testing.assert_allclose(radiance(scene, KINDS[kind][1]), expected(light, scene), rtol=LEVEL)


_SCALAR = """
import sys
from pathlib import Path
from dasim.render import backend
backend.activate(backend.choose("scalar_spectral"))
from tests.dasim.render import test_lights
for kind in ("panel", "sun", "sky", "environment"):
    test_lights.test_level_and_spectrum(kind, Path(sys.argv[1]), "scalar_spectral")
"""


def test_level_and_spectrum_in_the_scalar_variant(tmp_path):
    """Rationale: the surrounding is a plugin of our own, which the scalar variant has to take as well."""
    root = Path(__file__).parents[3]
    paths = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    subprocess.run(
        [sys.executable, "-c", _SCALAR, str(tmp_path)],
        check=True,
        timeout=200,
        cwd=root,
        env={**os.environ, "PYTHONPATH": paths},
    )


# --- directions ------------------------------------------------------------------------------------


RIGHT, DOWN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
AXES = {  # of scene coordinates, and the place in a panorama that shows it: column of 64, row of 32
    "ahead": (AHEAD, 32, 16),
    "right": (RIGHT, 48, 16),
    "behind": (BACK, 0, 16),
    "left": (LEFT, 16, 16),
    "up": (UP, None, 0),
    "down": (DOWN, None, 32),
}


def spot(folder: Path, column: int | None, row: int) -> dict:
    """A panorama that is bright about one corner of its pixels, with a little light elsewhere."""
    values = np.full((32, 64, 3), 1e-4, np.float32)
    for y in (row - 1, row):
        for x in (column - 1, column) if column is not None else range(64):
            if 0 <= y < 32:
                values[y, x] = 1e3
    cv2.imwrite(str(folder / "spot.hdr"), values)
    return {"kind": "environment", "illuminant": "D65", "lux": 1.0, "image": "spot.hdr"}


@pytest.mark.parametrize(
    "axis",
    ["right", "left", "down", *(pytest.param(axis, marks=pytest.mark.slow) for axis in ("ahead", "behind", "up"))],
)
def test_a_panoramas_directions(axis, tmp_path, renderer):
    """Expectation: a bright spot lights what faces it, half of it what is turned away by 60 degrees, and nothing the
    other sides, whichever axis it lies on, seen from a camera that stands askew.
    """
    towards, column, row = AXES[axis]
    light = spot(tmp_path, column, row)
    level = radiance(lit(tmp_path, towards, light), towards, 1 << 13)[1]
    aside = next(vector for vector, *_ in AXES.values() if np.dot(vector, towards) == 0)
    turned = tuple(0.5 * np.array(towards) + np.sqrt(0.75) * np.array(aside))
    assert radiance(lit(tmp_path, turned, light), turned, 1 << 13)[1] / level == pytest.approx(0.5, rel=0.03)
    away = tuple(-np.array(towards))
    assert radiance(lit(tmp_path, away, light), away, 1 << 13)[1] < 1e-3 * level


def test_a_turned_panorama(tmp_path, renderer):
    """Expectation: 90 degrees put the image's middle to the right, so that what faces there is as bright as what
    faced it before, and what faces ahead is dark.
    """
    light = spot(tmp_path, 32, 16)
    before = radiance(lit(tmp_path, AHEAD, light), AHEAD)[1]
    turned = light | {"rotation_deg": 90}
    assert radiance(lit(tmp_path, RIGHT, turned), RIGHT)[1] == pytest.approx(before, rel=LEVEL)
    assert radiance(lit(tmp_path, LEFT, turned), LEFT)[1] < 1e-3 * before


def test_a_small_bright_place_is_aimed_at(tmp_path, renderer):
    """Rationale: chance finds 1 of 8,000 pixels hardly ever. Set-up: one pixel holds nearly all light.

    Expectation: the level is met to within 1 % with few rays.
    """
    values = np.full((64, 128, 3), 1e-3, np.float32)
    values[12, 70] = 1e4
    cv2.imwrite(str(tmp_path / "pixel.hdr"), values)
    light = {"kind": "environment", "illuminant": "A", "lux": 300.0, "image": "pixel.hdr"}
    scene = lit(tmp_path, UP, light)
    np.testing.assert_allclose(radiance(scene, UP, 1 << 13), expected(light, scene), rtol=LEVEL)


@pytest.mark.parametrize(
    ("elevation_deg", "azimuth_deg", "facing", "share"),
    [
        (90, 0, UP, 1.0),
        (30, 90, RIGHT, np.cos(np.pi / 6)),
        (30, 90, UP, 0.5),
        (30, 90, AHEAD, 0.0),
        (45, 180, BACK, np.sqrt(0.5)),
        (10, -90, LEFT, np.cos(np.radians(10))),
    ],
)
def test_the_sun_stands_where_it_should(elevation_deg, azimuth_deg, facing, share, tmp_path, renderer):
    """Expectation: the cosine between the surface and the sun: azimuth from ahead to the right, up is -y."""
    light = {"kind": "sun", "illuminant": "sun-30deg", "lux": 5e4}
    light |= {"elevation_deg": elevation_deg, "azimuth_deg": azimuth_deg}
    scene = lit(tmp_path, facing, light)
    ratio = radiance(scene, facing, 1 << 10) / expected(light, scene)
    np.testing.assert_allclose(ratio, share, atol=2e-3)  # the disc's edge, where a surface is edge-on


def test_the_sun_is_half_a_degree_wide(tmp_path, renderer):
    """Expectation: looked at, it has the radiance E / (pi sin^2) to 0.26 degrees from its middle, none at 0.27."""
    import mitsuba as mi

    light = {"kind": "sun", "illuminant": "A", "lux": 1e3, "elevation_deg": 35, "azimuth_deg": 20}
    scene = lit(tmp_path, UP, light)
    loaded, axes = mi_scene(scene), scenes.world_to_camera(scene)
    power = np.interp(AT_NM, grid.WAVELENGTH_NM, 1e3 * illuminants.illuminant("A"))
    for off_deg, share in ((0.0, 1.0), (0.26, 1.0), (0.27, 0.0)):
        towards = axes[:3, :3] @ direction(35 + off_deg, 20)
        ray = mi.RayDifferential3f(mi.Point3f(0, 0, 0), mi.Vector3f(*towards.tolist()))
        ray.wavelengths = mi.Spectrum(*AT_NM)
        si = loaded.ray_intersect(ray)
        value = np.array(si.emitter(loaded).eval(si)).ravel() if si.is_valid() else np.zeros(4)
        np.testing.assert_allclose(value, share * power / (np.pi * np.sin(np.radians(0.265)) ** 2), rtol=1e-4)


def mi_scene(scene: Scene):
    from dasim.render import translate

    return translate.load(scene)


# --- panoramas -------------------------------------------------------------------------------------


def test_the_main_light_names_the_captures_illuminant(tmp_path):
    """Expectation: the light of most lux, whatever its kind; daylight by its own name."""
    lamp = source("lamp", tmp_path, 900.0)
    for level, name in ((5e4, "daylight-40deg"), (100.0, "D65")):
        scene = lit(tmp_path, UP, lamp, source("daylight", tmp_path, level))
        assert scenes.main_illuminant(scene) == name
        assert illuminants.illuminant(name).min() > 0


def test_a_picture_is_its_luminance_in_every_format(tmp_path):
    """Expectation: PNG (sRGB), HDR and EXR of the same linear colours give the same luminance; colours of equal
    luminance count the same.
    """
    import OpenEXR

    coded = np.random.default_rng(0).integers(0, 256, (8, 16, 3)).astype(np.uint8)
    linear = np.where(coded / 255 <= 0.04045, coded / 255 / 12.92, ((coded / 255 + 0.055) / 1.055) ** 2.4)
    cv2.imwrite(str(tmp_path / "a.png"), coded[..., ::-1])
    cv2.imwrite(str(tmp_path / "a.hdr"), linear[..., ::-1].astype(np.float32))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": linear.astype(np.float32)}) as file:
        file.write(str(tmp_path / "a.exr"))
    expected_luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    for name, tolerance in (("a.png", 1e-9), ("a.exr", 1e-6), ("a.hdr", 0.01)):  # shared exponent of 8 bits
        image = panorama.load(name, tmp_path)
        assert np.abs(image - expected_luminance).max() < tolerance * expected_luminance.max()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sky", "daylight"])
def test_ground_outside_the_picture(kind, tmp_path, renderer):
    """Expectation: level ground of reflectance 0.4 under E lux gives 0.4 E to what faces down, the level above it is
    as before, and what stands upright gets half the ground's more.
    """
    light = source(kind, tmp_path) | {"ground_reflectance": 0.4}
    scene = lit(tmp_path, DOWN, light)
    np.testing.assert_allclose(radiance(scene, DOWN), 0.4 * expected(light, scene), rtol=LEVEL)
    np.testing.assert_allclose(radiance(lit(tmp_path, UP, light), UP), expected(light, scene), rtol=LEVEL)
    if kind == "sky":  # even: half of it each
        np.testing.assert_allclose(radiance(lit(tmp_path, LEFT, light), LEFT), 0.7 * expected(light, scene), rtol=LEVEL)


def test_lights_from_all_around_add_up(tmp_path, renderer):
    """Rationale: Mitsuba takes one environment, so ours are summed. Expectation: the sum of each alone."""
    sources = [source("sky", tmp_path, 300.0), source("dome", tmp_path, 200.0), source("environment", tmp_path, 100.0)]
    together = radiance(lit(tmp_path, UP, *sources), UP)
    alone = sum(expected(light, lit(tmp_path, UP, light)) for light in sources)
    np.testing.assert_allclose(together, alone, rtol=LEVEL)


def test_a_camera_sees_an_even_panorama_as_a_dome(make_scene, wide, tmp_path, renderer):
    """Rationale: the whole camera, not one ray. Set-up: a brick wall before an even panorama and before a dome of as
    many lux, under a lamp of lines. Expectation: the same electrons per second in every channel, on the wall and in the
    empty space beside it, to within the noise of 64 samples in half a frame.
    """
    from dasim.render import passes

    cv2.imwrite(str(tmp_path / "even.png"), np.full((4, 8, 3), 90, np.uint8))
    common = {"illuminant": "F11", "lux": 800.0}
    wall = {"name": "wall", "shape": "plane", "material": "brick", "size_cm": [60, 60], "position_cm": [30, 0, 40]}
    camera, pictures = wide(24, 18), []
    for light in ({"kind": "dome"}, {"kind": "environment", "image": "even.png"}):
        scene = make_scene(wall, lights=[light | common], folder=tmp_path)
        pictures.append(passes.stop_pass(mi_scene(scene), camera, camera.stops[0], passes.Sampling(64, 3)))
    for half in (slice(None, 10), slice(14, None)):
        dome, even = (rate[:, half].mean(axis=(0, 1)) for rate in pictures)
        np.testing.assert_allclose(even[dome > 0], dome[dome > 0], rtol=LEVEL)


# --- the user's mistakes ---------------------------------------------------------------------------

HEAD = 'name = "mine"\n[[objects]]\nname = "ball"\nshape = "sphere"\nradius_cm = 5\nposition_cm = [0, 0, 40]\n'
HEAD += 'material = "brick"\n[[lights]]\n'
NEAR = "position_cm = [0, -30, 20]\ntarget_cm = [0, 0, 40]\n"


def test_all_problems_of_a_light_are_reported(tmp_path):
    light = 'kind = "environment"\nilluminant = "F77"\nlux = 1\nimage = "no.png"\n'
    (tmp_path / "mine.toml").write_text(HEAD + light)
    with pytest.raises(InputError, match=r"lights.0 \(environment\): illuminant 'F77'.*; lights.0 .*'no.png'"):
        loading.load_scene(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("light", "message_part"),
    [
        ('kind = "sun"\nilluminant = "F77"\nlux = 1\nelevation_deg = 9', ("lights.0 (sun)", "'F77'", "F7")),
        ('kind = "sun"\nilluminant = "A"\nlux = 1\nelevation_deg = 95', ("lights.0.elevation_deg", "90", "95")),
        ('kind = "daylight"\nlux = 1\nelevation_deg = 2', ("lights.0.elevation_deg", "5", "2")),
        ('kind = "daylight"\nlux = 1e9\nelevation_deg = 20', ("lights.0.lux", "10000000")),
        ('kind = "sky"\nilluminant = "D65"\nlux = 1\ndistribution = "foggy"', ("lights.0.distribution", "overcast")),
        ('kind = "panel"\nilluminant = "A"\nlux = 1\nsize_cm = [0, 1]\n' + NEAR, ("lights.0.size_cm",)),
        ('kind = "bulb"\nilluminant = "A"\nlux = 1\nradius_cm = 90\n' + NEAR, ("lights.0", "inside the bulb", "36.0")),
        (
            'kind = "lamp"\nilluminant = "A"\nlux = 1\nradius_cm = 1\nposition_cm = [1, 0, 41]\ntarget_cm = [0, 0, 0]',
            ("lights.0 (lamp)", "inside object 'ball'"),
        ),
        ("no.png", ("lights.0 (environment)", "'no.png'", "no such file")),
        ("mine.toml", ("lights.0 (environment)", "cannot be read as a picture")),
        ("broken.exr", ("lights.0 (environment)", "cannot be read as EXR")),
        ("square.png", ("lights.0 (environment)", "is 8 x 8", "twice as wide as high")),
        ("black.png", ("lights.0 (environment)", "black", "must contain light")),
        ("low.png", ("lights.0 (environment)", "upper half is black")),
    ],
)
def test_problems_of_a_light_are_reported_in_one_line(light, message_part, tmp_path):
    low = np.zeros((8, 16, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "black.png"), low)
    cv2.imwrite(str(tmp_path / "square.png"), np.ones((8, 8, 3), np.uint8))
    low[6:] = 200
    cv2.imwrite(str(tmp_path / "low.png"), low)
    (tmp_path / "broken.exr").write_bytes(b"no picture")
    if "kind" not in light:
        light = f'kind = "environment"\nilluminant = "A"\nlux = 1\nimage = "{light}"'
    (tmp_path / "mine.toml").write_text(HEAD + light + "\n")
    with pytest.raises(InputError) as caught:
        loading.load_scene(tmp_path / "mine.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert all(part in message for part in message_part), message
