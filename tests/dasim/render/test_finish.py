"""Finishes of glTF files: metallic share, roughness and normal map, from the file to the scattering of light."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import dasim
from dasim.base.errors import InputError
from dasim.materials.photographs import photograph_surface
from dasim.materials.surfaces import Diffuse, Finished, Mixture
from dasim.scene import mesh_merging, meshes, object_materials
from dasim.spectra.grid import WAVELENGTH_NM

GOLDEN = (0.9, 0.6, 0.2)  # linear light
WAVELENGTHS_NM = (450.0, 550.0, 650.0, 750.0)
TILT = np.radians(30.0)
BY_BYTES = 4e-3  # of a value of 8 bits: half a step is 1/510
SINGLE = 1e-4  # relative: single precision, at cosines above 0.5
FURNACE = 0.03  # of the brightness: rendering noise over the middle of a ball


@pytest.fixture(scope="module")
def mi(renderer):
    import mitsuba

    return mitsuba


def picture(rgb) -> Image.Image:
    """A picture [h, w, rgb] of bytes from values 0..1."""
    values = np.atleast_3d(np.asarray(rgb, float))
    values = values.reshape(1, 1, 3) if values.size == 3 else values
    return Image.fromarray(np.rint(values * 255).astype(np.uint8))


def square(material: PBRMaterial) -> trimesh.Trimesh:
    """An upright square of side 20 in glTF's axes (y up) that faces +z, with the whole texture."""
    corners = [[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return mesh


def part_of(folder, *materials: PBRMaterial) -> meshes.Part:
    """The mesh that is made of a GLB with one square per material."""
    scene = trimesh.Scene({str(number): square(material) for number, material in enumerate(materials)})
    scene.export(folder / "squares.glb")
    return mesh_merging.merge_with_colours(meshes.read(folder / "squares.glb", 0.01, "squares"), "squares")


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ({"metallicFactor": 0.25, "roughnessFactor": 0.75}, (0.25, 0.75)),
        ({"metallicFactor": 1.0, "roughnessFactor": 0.0}, (1.0, 0.0)),
        ({}, (1.0, 1.0)),  # glTF 2.0, 5.22: both factors are 1 where they are left out
    ],
)
def test_factors_are_those_of_the_file(tmp_path, factors, expected):
    part = part_of(tmp_path, PBRMaterial(baseColorFactor=[200, 100, 50, 255], **factors))
    np.testing.assert_allclose(part.finish[..., :2], np.broadcast_to(expected, (1, 1, 2)), atol=1e-6)
    np.testing.assert_array_equal(part.finish[..., 2:], [[[0.5, 0.5, 1.0]]])


@pytest.mark.parametrize(("name", "value"), [("metallicFactor", 1.5), ("roughnessFactor", -0.1)])
def test_factors_that_gltf_forbids_are_refused_in_one_line(tmp_path, name, value):
    with pytest.raises(InputError, match=rf"^squares: does not load \(its {name} is {value}, 0 to 1 is allowed"):
        part_of(tmp_path, PBRMaterial(**{name: value}))


def test_a_matt_material_has_no_finish(tmp_path):
    part = part_of(tmp_path, PBRMaterial(baseColorFactor=[200, 100, 50, 255], metallicFactor=0.0, roughnessFactor=1.0))
    assert part.finish is None


def test_textures_hold_roughness_in_green_and_metal_in_blue(tmp_path):
    """Set-up: a picture of 2 x 1 texels, times factors, beside colours of one texel and a map of normals of 4 x 4.

    Expectation: all become pictures of 4 x 4; the halves have the values of the texels.
    """
    shares = picture([[[0.9, 0.2, 0.8], [0.1, 0.6, 0.4]]])
    material = PBRMaterial(
        baseColorTexture=picture((0.5, 0.5, 0.5)),
        metallicRoughnessTexture=shares,
        normalTexture=picture(np.broadcast_to((0.5, 0.75, 0.9), (4, 4, 3))),
        metallicFactor=0.5,
        roughnessFactor=1.0,
    )
    part = part_of(tmp_path, material)
    assert part.paint.shape == (4, 4, 3) and part.finish.shape == (4, 4, 5)
    np.testing.assert_allclose(part.finish[:, 0, :2], [[0.4, 0.2]] * 4, atol=BY_BYTES)
    np.testing.assert_allclose(part.finish[:, -1, :2], [[0.2, 0.6]] * 4, atol=BY_BYTES)
    np.testing.assert_allclose(part.finish[0, 0, 2:], (0.5, 0.75, 0.9), atol=BY_BYTES)


def test_parts_keep_their_own_finish_in_one_atlas(tmp_path):
    """Expectation: at the texture coordinates of each part, the atlas has the finish of its material; a part without
    one is matt.
    """
    metal = PBRMaterial(baseColorTexture=picture((0.5, 0.4, 0.3)), metallicFactor=1.0, roughnessFactor=0.25)
    matt = PBRMaterial(baseColorTexture=picture((0.2, 0.4, 0.8)), metallicFactor=0.0, roughnessFactor=1.0)
    part = part_of(tmp_path, metal, matt)
    seen = []
    for number in (0, 1):
        u, v = part.uv[4 * number : 4 * number + 4].mean(axis=0)
        row, column = int((1 - v) * part.finish.shape[0]), int(u * part.finish.shape[1])
        is_blue = bool(part.paint[row, column, 2] > part.paint[row, column, 0])
        seen.append((is_blue, *part.finish[row, column, :2].tolist()))
    assert sorted(seen) == [(False, 1.0, 0.25), (True, 0.0, 1.0)]


# --- light ---------------------------------------------------------------------------------------


def uniform(metallic: float, roughness: float) -> Finished:
    base = photograph_surface(np.full((1, 1, 3), GOLDEN, np.float32), "achromatic")
    assert isinstance(base, Diffuse | Mixture)
    image = np.ones((1, 1), np.float32)
    return Finished(base, metallic * image, roughness * image, None)


def reflectance(surface) -> np.ndarray:
    """Reflectance of a tree of one texel at ``WAVELENGTHS_NM``."""
    if isinstance(surface, Diffuse):
        return np.interp(WAVELENGTHS_NM, WAVELENGTH_NM, surface.reflectance)
    share = float(surface.weight.mean())
    return (1 - share) * reflectance(surface.first) + share * reflectance(surface.second)


def unit(x: float, y: float) -> np.ndarray:
    return np.array([x, y, np.sqrt(1 - x * x - y * y)])


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.9])
def test_a_metal_scatters_by_the_formula_of_gltf(mi, roughness):
    """Expectation: D G F / (4 cos) with the distribution of Trowbridge and Reitz (GGX, alpha = roughness squared),
    Smith's shadowing of both directions, and Schlick's reflectance from the base colour at normal incidence: light
    is tinted by it at every wavelength, near-infrared by the rule. Rough metal spreads light, smooth metal does not.
    """
    from dasim.render.reflection import surface_bsdf

    surface = uniform(1.0, roughness)
    bsdf, base, alpha = surface_bsdf(surface, flip=False), reflectance(surface.base), roughness**2
    for light, view in ((unit(0, 0), unit(0, 0)), (unit(0.3, 0.1), unit(-0.4, 0.2)), (unit(0.6, 0), unit(0.2, 0.5))):
        half = (light + view) / np.linalg.norm(light + view)
        spread = alpha**2 / (np.pi * (half[2] ** 2 * (alpha**2 - 1) + 1) ** 2)
        shadow = [2 / (1 + np.sqrt(1 + alpha**2 * (1 / way[2] ** 2 - 1))) for way in (light, view)]
        fresnel = base + (1 - base) * (1 - half @ view) ** 5
        expected = spread * np.prod(shadow) * fresnel / (4 * view[2])  # times the cosine of the light
        si = mi.SurfaceInteraction3f()
        si.uv, si.wi = mi.Point2f(0.5, 0.5), mi.Vector3f(*view.tolist())
        si.wavelengths = mi.Spectrum(*WAVELENGTHS_NM)
        value = np.ravel(np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*light.tolist()))))
        np.testing.assert_allclose(value, expected, rtol=2e-3)  # texture nodes lie 0.125 nm from these wavelengths


@pytest.mark.parametrize(
    ("place", "turn", "metallic"), [((1, 0), (0, -1, 0), 0.0), ((0, 1), (-1, 0, 0), 0.0), ((-1, 0), (0, 1, 0), 1.0)]
)
def test_a_normal_map_shades_as_a_surface_that_is_tilted(loaded, mi, make_scene, tmp_path, place, turn, metallic):
    """Rationale: the cosine law holds for the mapped normal; a wrong axis or sign brightens the wrong side.

    Set-up: a square that faces the camera with a map of normals that lean by 30 degrees to the right (up, left) of
    the picture, beside a plain square that is turned by 30 degrees that way.

    Expectation: from the same light to the same eye, both scatter equally, at every wavelength.
    """
    lean = (0.5 + 0.5 * np.sin(TILT) * place[0], 0.5 + 0.5 * np.sin(TILT) * place[1], 0.5 + 0.5 * np.cos(TILT))
    finish = {"baseColorFactor": [230, 150, 60, 255], "metallicFactor": metallic, "roughnessFactor": 0.6}
    square(PBRMaterial(normalTexture=picture(lean), **finish)).export(tmp_path / "mapped.glb")
    square(PBRMaterial(**finish)).export(tmp_path / "plain.glb")
    values = {}
    for name, angle_deg in (("mapped", 0.0), ("plain", np.degrees(TILT))):
        rotation_deg = np.array([180.0, 0, 0]) + np.multiply(turn, angle_deg)  # half a turn about x: upright
        item = {"name": name, "shape": "mesh", "file": f"{name}.glb", "near_infrared": "achromatic"}
        pose = {"position_cm": (0, 0, 40), "rotation_deg": tuple(rotation_deg.tolist())}
        scene = loaded(make_scene(item | pose, folder=tmp_path))
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0))
        ray.wavelengths = mi.Spectrum(*WAVELENGTHS_NM)
        si = scene.ray_intersect(ray)
        values[name] = [
            np.ravel(np.array(si.bsdf().eval(mi.BSDFContext(), si, si.to_local(mi.Vector3f(*light.tolist())))))
            for light in (np.array([x, y, -np.sqrt(1 - x * x - y * y)]) for x, y in ((0.3, 0.1), (-0.1, -0.4)))
        ]
    normal = np.array([np.sin(TILT) * place[0], -np.sin(TILT) * place[1], -np.cos(TILT)])
    np.testing.assert_allclose(np.ravel(np.array(si.n)), normal, atol=1e-6)
    assert np.min(values["plain"]) > 1e-3
    np.testing.assert_allclose(values["mapped"], values["plain"], rtol=5 * BY_BYTES)


def test_a_metal_is_as_bright_as_its_reflectance_in_an_even_dome(renderer, make_scene, wide, tmp_path):
    """Set-up: two balls of one colour under a dome, a smooth metal and a matt one, photographed through a pinhole.

    Expectation: in their middles both reflect the share of the dome that is their reflectance, in every channel.
    """
    for name, factors in (("metal", (1.0, 0.2)), ("matt", (0.0, 1.0))):
        ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
        material = PBRMaterial(
            baseColorFactor=[230, 150, 60, 255], metallicFactor=factors[0], roughnessFactor=factors[1]
        )
        ball.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(ball.vertices), 2)), material=material)
        ball.export(tmp_path / f"{name}.glb", include_normals=True)
    items = [
        {"name": name, "shape": "mesh", "file": f"{name}.glb", "near_infrared": "achromatic", "position_cm": (x, 0, 40)}
        for name, x in (("metal", -6), ("matt", 6))
    ]
    shot = dasim.simulate(make_scene(*items, folder=tmp_path), wide(), spp=16, diffraction="off")
    middles = []
    for number in (1, 2):
        rows, columns = np.nonzero(shot.truth.object_id == number)
        near = np.hypot(rows - rows.mean(), columns - columns.mean()) < 0.3 * np.ptp(columns) / 2
        middles.append(shot.truth.sharp_e[rows[near], columns[near]].mean(axis=0))
    np.testing.assert_allclose(middles[0], middles[1], rtol=FURNACE)
    notes = " ".join(shot.capture.provenance["notes"])
    assert "metal.glb (one colour) rendered as a finish of the file (metallic 1)" in notes
    assert "matt.glb (one colour) rendered as a matt material" in notes


def test_materials_of_the_scene_replace_the_finish_of_the_file(make_scene, tmp_path):
    square(PBRMaterial(metallicFactor=1.0, roughnessFactor=0.2)).export(tmp_path / "metal.glb")
    item = {"name": "thing", "shape": "mesh", "file": "metal.glb", "position_cm": (0, 0, 40), "material": "gold"}
    scene = make_scene(item, folder=tmp_path)
    assert not isinstance(object_materials.surface_of(scene.objects[0], scene), Finished)
