"""Mitsuba scenes from other sources: near-infrared colours, pictures and metals."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest
import trimesh

from dasim.camera import radiometry
from dasim.spectra.grid import WAVELENGTH_NM
from tests.support.foreign_scenes import ASLANT, wall

SINGLE = 1e-4  # relative: rays and shapes are single precision
LEVEL_LIMIT = 0.01  # relative, of a mean over many pixels: sampling noise of wavelengths
RED, BLUE = (0.6, 0.05, 0.05), (0.05, 0.1, 0.7)


def reflected(scene, directions, wavelengths_nm) -> np.ndarray:
    """Reflectance of what rays from the lens centre meet, [ray, wavelength], from the scattering function."""
    import mitsuba as mi

    rows = []
    for direction in directions:
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(np.array(direction) / np.linalg.norm(direction)).tolist()))
        row = []
        for wavelength in wavelengths_nm:
            ray.wavelengths = mi.Spectrum(float(wavelength))
            si = scene.ray_intersect(ray)
            value = si.bsdf(mi.RayDifferential3f(ray)).eval(mi.BSDFContext(), si, si.wi)
            row.append(np.ravel(value)[0] / np.abs(np.ravel(si.wi)[2]) * np.pi)
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("rule", ["print", "dyed", "achromatic"])
def test_rgb_surfaces_have_the_rules_spectrum_and_nothing_of_rgb_upsampling(xml, world, wide, rule):
    """Expectation: red and blue walls reflect what the rule's spectra say at 450 to 820 nm. Achromatic at 800 nm is
    the colours' luminance; prints and dyes differ there by little, whatever the colour (RGB upsampling: by far).
    """
    from dasim.render.foreign.colours import spectrum_of

    nm = (450, 550, 650, 740, 800, 820)
    found = []
    for colour in (RED, BLUE):
        inside = f'<bsdf type="diffuse"><rgb name="reflectance" value="{colour[0]}, {colour[1]}, {colour[2]}"/></bsdf>'
        scene = world(xml(wall(inside), near_infrared=rule), wide())
        curve = np.interp(nm, WAVELENGTH_NM, spectrum_of(colour, rule))
        (seen,) = reflected(scene.scene, [(0, 0, 1)], nm)
        np.testing.assert_allclose(seen, curve, atol=1e-5)
        assert any(f"rule '{rule}'" in note for note in scene.notes)
        found.append(seen)
    if rule == "achromatic":
        luminance = np.array([RED, BLUE]) @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose([found[0][4], found[1][4]], luminance, atol=2e-3)
    assert found[0][0] < found[1][0] and found[0][2] > 2 * found[1][2], "in the visible they are red and blue"


def test_picture_lies_where_mitsuba_puts_it(xml, world, wide, jit, tmp_path):
    """Set-up: a grey picture on a wall, scaled by to_uv and repeated. Mitsuba's own grey upsampling is flat, and so is
    the achromatic rule's, so both reflect the same at every wavelength.

    Expectation: the same reflectance at 30 places, in the near-infrared too.
    """
    import mitsuba as mi

    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(30, 220, (4, 5), dtype=np.uint8), (40, 32), interpolation=cv2.INTER_LINEAR)
    cv2.imwrite(str(tmp_path / "grey.png"), cv2.merge([picture] * 3))
    inside = (
        '<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="grey.png"/>'
        '<transform name="to_uv"><scale x="12" y="9"/></transform></texture></bsdf>'
    )
    text = wall(inside)
    ours = world(xml(text), wide()).scene
    theirs = mi.load_string(text.replace("grey.png", str(tmp_path / "grey.png")))
    directions = np.column_stack([rng.uniform(-0.8, 0.8, (30, 2)), np.ones(30)])
    # Theirs looks along z with x left and y up.
    (expected,) = reflected_at_once(theirs, directions * [-1, -1, 1], 550)
    assert np.ptp(expected) > 0.2
    found = reflected_at_once(ours, directions, 550, 700)
    np.testing.assert_allclose(found[0], expected, atol=1e-4)
    np.testing.assert_allclose(found[1], expected, atol=1e-3)  # the basis sums to 1, but for rounding


def reflected_at_once(scene, directions, *wavelengths_nm) -> list[np.ndarray]:
    """``reflected`` of many rays in a JIT variant, [wavelength][ray]."""
    import mitsuba as mi

    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(unit.T.astype(np.float32))))
    found = []
    for wavelength in wavelengths_nm:
        ray.wavelengths = mi.Spectrum(float(wavelength))
        si = scene.ray_intersect(ray)
        value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.wi)
        found.append(np.array(value[0]) / np.abs(np.array(si.wi.z)) * np.pi)
    return found


def test_scalar_pictures_become_blends_or_their_mean(wide, tmp_path):
    """Set-up: in a process of its own, ``scalar_spectral``: a picture, half black and half white, on a matt wall and
    on a rough plastic. Expectation: the matt one shows both halves, the plastic its mean, and the notes say so.
    """
    picture = np.zeros((2, 8, 3), np.uint8)
    picture[:, 4:] = 255
    cv2.imwrite(str(tmp_path / "half.png"), picture)
    texture = '<texture type="bitmap" name="KEY"><string name="filename" value="half.png"/></texture>'
    for name, key in (("diffuse", "reflectance"), ("roughplastic", "diffuse_reflectance")):
        (tmp_path / f"{name}.xml").write_text(wall(f'<bsdf type="{name}">{texture.replace("KEY", key)}</bsdf>'))
    program = (
        "import sys, dasim\nfrom dasim.render import backend\nbackend.activate(backend.choose('scalar_spectral'))\n"
        "from dasim.render import translate\nimport numpy as np, mitsuba as mi\n"
        "for name in sys.argv[1:]:\n"
        "    world = translate.world(dasim.load_scene(name), dasim.load_camera('da-mobile'))\n"
        "    row = []\n"
        "    for x in (-4.0, 4.0):\n"
        "        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(np.array([x, 0, 4]) / np.sqrt(x * x + 16)).tolist()))\n"
        "        ray.wavelengths = mi.Spectrum(550.0)\n"
        "        si = world.scene.ray_intersect(ray)\n"
        "        row.append(np.ravel(si.bsdf(mi.RayDifferential3f(ray)).eval(mi.BSDFContext(), si, si.wi))[0])\n"
        "    print(abs(row[0] - row[1]) > 0.1, any('their mean colour' in note for note in world.notes))\n"
    )
    names = [str(tmp_path / f"{name}.xml") for name in ("diffuse", "roughplastic")]
    done = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["True", "False", "False", "True"], done.stderr[-1000:]


@pytest.mark.parametrize(
    ("text", "noted"),
    [
        ('<bsdf type="diffuse"><spectrum name="reflectance" value="2"/></bsdf>', "clipped to 1"),
        ('<bsdf type="diffuse"><spectrum name="reflectance" value="400:1.5, 830:1.9"/></bsdf>', "clipped to 1"),
        ('<bsdf type="diffuse"><rgb name="reflectance" value="2, 2, 2"/></bsdf>', "clipped to 1"),
    ],
)
def test_no_surface_reflects_more_than_it_receives(xml, world, wide, text, noted):
    """Expectation: a wall of reflectance 2 is as bright as one of reflectance 1, and that is noted."""
    import drjit as dr
    import mitsuba as mi

    def brightness(inside: str) -> float:
        found = world(xml(wall(inside)), wide())
        notes.append(found.notes)
        si = found.scene.ray_intersect(mi.Ray3f([0, 0, 0], [0, 0, 1], 0, mi.Spectrum(600.0)))
        context = mi.BSDFContext()
        value = si.bsdf().eval(context, si, mi.Vector3f(0, 0, 1))
        return float(np.ravel(value)[0]) * dr.pi

    notes: list[list[str]] = []
    assert brightness(text) == pytest.approx(1.0, abs=0.01)
    assert any(noted in line for line in notes[0])


def test_files_of_spectra_are_found_beside_the_scene(xml, world, wide, monkeypatch, tmp_path, tmp_path_factory):
    (tmp_path / "half.spd").write_text("400 0.5\n830 0.5\n")
    scene = xml(wall('<bsdf type="diffuse"><spectrum name="reflectance" filename="half.spd"/></bsdf>'))
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert world(scene, wide()).objects


def test_rough_metal_with_a_pattern_of_roughness_has_finite_light(xml, world, wide, jit, tmp_path):
    """Rationale: a smooth mesh shows some rays its back, where a pattern of roughness has no value and a sampled
    direction is NaN with the weight 0. Such samples must not count.

    Set-up: a coarse mesh of a ball with a checkerboard of roughness, of amorphous carbon, before even light.
    Expectation: every pixel is finite, and the mean of all is that of Mitsuba's own path tracer.
    """
    from dasim.render import passes, stock, wavelengths

    trimesh.creation.icosphere(subdivisions=1, radius=1.0).export(tmp_path / "ball.ply")
    carbon = (
        '<bsdf type="roughconductor"><string name="material" value="a-C"/><texture name="alpha" type="checkerboard">'
        '<float name="color0" value="0.3"/><float name="color1" value="0.5"/></texture></bsdf>'
    )
    shape = f'<shape type="ply"><string name="filename" value="ball.ply"/>{carbon}</shape>'
    light = '<emitter type="constant"><spectrum name="radiance" value="1"/></emitter>'
    scene = xml(f'<scene version="3.0.0">{ASLANT}{shape}{light}</scene>')
    camera = wide(48, 36)
    ours = world(scene, camera).scene
    sampling = passes.Sampling(64, 0)
    rate = passes.pinhole_pass(ours, camera, sampling)
    assert np.isfinite(rate).all()
    theirs = stock.pinhole_pass(ours, camera, wavelengths.pinhole_responses(camera), sampling)
    theirs *= radiometry.relative_illumination(camera)[..., None]
    np.testing.assert_allclose(rate.mean(axis=(0, 1)), theirs.mean(axis=(0, 1)), rtol=LEVEL_LIMIT)


@pytest.mark.parametrize("material", ["Li", "MgO"])
def test_metals_continue_beyond_their_tables(xml, world, wide, material):
    """Rationale: Mitsuba's tables of lithium and magnesium oxide end at 751 and 768 nm, and their index is zero beyond:
    a perfect mirror.

    Expectation: at normal incidence and 820 nm the reflectance is that of the last value of the table,
    |(n - 1) / (n + 1)|^2, and a note says so.
    """
    import mitsuba as mi

    index = complex(*(mi.spectrum_from_file(str(mi.file_resolver().resolve(f"data/ior/{material}.{part}.spd")))[1][-1]
                      for part in ("eta", "k")))  # fmt: skip
    inside = f'<bsdf type="conductor"><string name="material" value="{material}"/></bsdf>'
    found = world(xml(wall(inside)), wide())
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0)))
    ray.wavelengths = mi.Spectrum(820.0)
    si = found.scene.ray_intersect(ray)
    _, weight = si.bsdf(ray).sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.5))
    assert np.ravel(weight)[0] == pytest.approx(abs((index - 1) / (index + 1)) ** 2, rel=SINGLE)
    assert any(f"spectrum {material}.eta covers" in note for note in found.notes)
