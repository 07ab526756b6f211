from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dasim
from dasim.camera.sensor import principal_point
from dasim.render import irradiance, irradiance_nodes, passes, ray_pass, translate
from dasim.render.irradiance_nodes import Nodes, clamped, even_nodes, smoothed
from dasim.render.irradiance_tracing import TILE, in_tile
from dasim.scene import specification as scenes
from dasim.typing import FloatArray

SHAPE = 48, 64
SPECTRA = np.ones((1, 431))
APART = 0.0014  # as a tangent: three pixels of da-mobile


def plane(normal: tuple[float, float, float] = (0.0, 0.0, -1.0), vergence: float = 2.0) -> FloatArray:
    """A surface that all nodes see, [y, x, (1/z, normal, known)]."""
    return np.broadcast_to(np.array([vergence, *normal, 1.0]), (*SHAPE, 5)).copy()


def nodes_of(surface: FloatArray) -> Nodes:
    """Nodes that see a surface [y, x, (1/z, normal, known)], or with the distance of the surroundings besides."""
    shape = surface.shape[:2]
    y, x = np.mgrid[: shape[0], : shape[1]] * APART
    flat = np.zeros((y.size, 6))
    flat[:, : surface.shape[2]] = surface.reshape(y.size, -1)
    return Nodes(np.arange(y.size).reshape(shape), np.column_stack([x.ravel(), y.ravel()]), flat)


def levels(irradiance: FloatArray) -> FloatArray:
    """Of all wavelengths alike, [node, light, wavelength]."""
    return np.broadcast_to(irradiance.ravel()[:, None, None], (irradiance.size, 1, 8)).copy()


def averaged(light: FloatArray, surface: FloatArray | None = None, apart: float = APART) -> FloatArray:
    """:func:`smoothed` of a light [y, x], likewise."""
    nodes = nodes_of(plane() if surface is None else surface)
    return smoothed(levels(light), nodes, SPECTRA, apart)[:, 0, 0].reshape(light.shape)


def test_noise_of_an_even_wall_falls_to_an_eighth() -> None:
    noise = np.random.default_rng(0).normal(1, 0.01, SHAPE)
    result = averaged(noise)
    middle = result[16:-16, 16:-16]
    assert middle.std() < noise.std() / 8
    assert abs(middle.mean() - 1) < 0.001


def test_differences_within_the_noise_of_the_directions_are_averaged() -> None:
    """Set-up: each node has a standard error of 15 % from independent directions for each wavelength, and one side of
    the wall gets twice the light. Expectation: the noise of each side falls to a fifth, and the step remains.
    """
    light = np.where(np.arange(SHAPE[1]) < 32, 1.0, 2.0) * np.ones(SHAPE)
    noise = np.random.default_rng(0).normal(1, 0.15 * np.sqrt(8), (light.size, 1, 8))
    result = smoothed(levels(light) * noise, nodes_of(plane()), SPECTRA, APART).mean(axis=-1).reshape(SHAPE)
    left, right = result[8:-8, 8:24], result[8:-8, 40:-8]
    assert left.std() < 0.15 / 5
    assert right.std() < 2 * 0.15 / 5
    assert left.mean() == pytest.approx(1, rel=0.01)
    assert right.mean() == pytest.approx(2, rel=0.01)
    assert result[8:-8, 29:31].mean() < 1.1
    assert result[8:-8, 33:35].mean() > 1.9


def test_each_of_several_lights_is_averaged_by_itself() -> None:
    """Set-up: two lights of one spectrum, in single precision, as they are traced; the noise of the second is nine
    times that of the first, upside down. Expectation: so is the change by averaging, with weights of both in common.
    """
    noise = np.random.default_rng(0).normal(0, 0.001, SHAPE)
    both = np.concatenate([levels(1 + noise), levels(3 - 9 * noise)], axis=1).astype(np.float32)
    result = smoothed(both, nodes_of(plane()), np.concatenate([SPECTRA, SPECTRA]), APART)
    assert result.dtype == np.float32
    change = result[:, :, 0] - both[:, :, 0]
    assert np.abs(change[:, 0]).max() > 1e-3
    assert change[:, 1] == pytest.approx(-9 * change[:, 0], abs=1e-5)


def test_linear_light_stays_as_it_is_up_to_the_border() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = 1 + 0.01 * x - 0.008 * y
    assert averaged(light) == pytest.approx(light, abs=1e-12)


def test_light_of_two_surfaces_is_not_mixed() -> None:
    light, surface = np.where(np.arange(SHAPE[1]) < 30, 1.0, 1.1) * np.ones(SHAPE), plane()
    surface[:, 30:, 0] *= 1.5
    assert averaged(light, surface) == pytest.approx(light, abs=1e-12)


def test_surface_that_bends_is_averaged_with_its_nearest_nodes_alone() -> None:
    noise, surface = np.random.default_rng(0).normal(1, 0.03, SHAPE), plane()
    turn = np.radians(6) * np.arange(SHAPE[1])
    surface[..., 1], surface[..., 3] = np.sin(turn), -np.cos(turn)
    impulse = noise.copy()
    impulse[24, 32] += 0.01
    difference = averaged(impulse, surface) - averaged(noise, surface)
    rows, columns = np.nonzero(np.abs(difference) > 1e-9)
    assert set(columns) <= {31, 32, 33}
    assert len(rows) > 1


def test_coarse_grid_is_averaged_with_nearest_nodes_alone() -> None:
    light = 1 + 1e-4 * (np.arange(SHAPE[1]) - 32.0) ** 2 * np.ones(SHAPE)
    fine = averaged(light)[24, 32] - light[24, 32]
    coarse = averaged(light, apart=10 * APART)[24, 32] - light[24, 32]
    # A kernel [1, 2, 1] / 4 has a variance of half a node, and one with twice the distance four times as much.
    assert coarse == pytest.approx(1e-4 * 0.5, rel=1e-6)
    assert fine == pytest.approx(1e-4 * (0.5 + 2 + 8), rel=1e-6)


def test_steep_shadow_stays() -> None:
    light = np.where(np.arange(SHAPE[1]) < 30, 1.0, 0.4) * np.ones(SHAPE)
    assert averaged(light) == pytest.approx(light, abs=1e-12)


def test_nodes_of_a_square_follow_each_other() -> None:
    rows, columns = np.mgrid[:TILE, :TILE]
    number = in_tile(rows, columns)
    assert sorted(number.ravel()) == list(range(TILE**2))
    assert sorted(number[:2, 2:].ravel()) == [4, 5, 6, 7]
    assert in_tile(rows + TILE, columns + 2 * TILE).tolist() == number.tolist()


@pytest.mark.parametrize("shape", [(2, 2), (3, 9), (7, 8), (9, 5)])
def test_grid_smaller_than_the_widest_step(shape: tuple[int, int]) -> None:
    light = np.linspace(1.0, 1.01, shape[1]) * np.ones(shape)
    surface = np.broadcast_to(np.array([2.0, 0.0, 0.0, -1.0, 1.0]), (*shape, 5))
    assert averaged(light, surface) == pytest.approx(light, abs=1e-12)


def test_nodes_are_even_where_neighbours_on_their_surface_agree() -> None:
    """Set-up: two walls at different depths, each evenly lit, the second four times as brightly; a node with 30 % more
    light; and a node at a depth of its own.
    Expectation: beside the step nodes are even, since the other wall does not count. The brighter node is not, nor are
    the eight around it, nor is the node without neighbours.
    """
    light, surface = np.where(np.arange(SHAPE[1]) < 30, 1.0, 4.0) * np.ones(SHAPE), plane()
    surface[:, 30:, 0] *= 1.5
    light[20, 10] = 1.3
    surface[5, 5, 0] = 9.0
    even = even_nodes(levels(light), nodes_of(surface), SPECTRA).reshape(SHAPE)
    expected = np.ones(SHAPE, bool)
    expected[19:22, 9:12] = expected[5, 5] = False
    assert (even == expected).all()


def test_surroundings_are_no_farther_than_a_neighbour_implies() -> None:
    """Set-up: a wall at half a metre; one node sees surroundings at 1 mm, the others at 1 m.
    Expectation: of its neighbours on one row, those are at 1 mm and the way between the nodes; a neighbour farther away
    keeps its own, and so does one that sees no surface.
    """
    surface = np.concatenate([plane(), np.ones((*SHAPE, 1))], axis=-1)
    surface[20, 10, 5] = 1e3
    surface[21, 10, 4] = 0
    near = clamped(nodes_of(surface)).reshape(SHAPE)
    assert 1 / near[20, 11] == pytest.approx(1e-3 + APART / 2)
    assert near[20, 12] == near[21, 10] == 1
    assert near[20, 10] == 1e3


@pytest.mark.slow
def test_contact_shadows_are_those_of_path_tracing(jit, monkeypatch) -> None:
    """Rationale: what lies beneath an object is dark, and the nodes around see the bright floor before it.

    Set-up: the lower edge of a rounded can on a table, 64 x 40 px of a random scene, through a pinhole, by the grid
    and by path tracing.
    Expectation: 3 % of the mean light at most in the root mean square over the pixels, where noise is 1 %, with refined
    cells and with the grid alone; the grid alone with surroundings as each node sees them has more than three times as
    much.
    """
    scene = dasim.random_scene(0, 1)
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), 64, 40), scene)
    world, spectrum = translate.load(scene), scenes.light_spectrum(scene)

    def picture(field: irradiance.Field | None, spp: int) -> FloatArray:
        return passes.pinhole_pass(world, camera, passes.Sampling(spp, 3), field)[..., 1]

    def error(field: irradiance.Field | None) -> float:
        return float(np.sqrt(np.mean((picture(field, 256) - traced) ** 2)) / traced.mean())

    traced = picture(None, 1024)
    right = passes.irradiance_field(world, camera, spectrum, 0.0, 64, 1)
    assert right is not None
    grid_alone = error(replace(right, refined=right.refined * 0))
    assert error(right) < 0.03
    assert grid_alone < 0.03
    monkeypatch.setattr(irradiance_nodes, "clamped", lambda nodes: nodes.surface[:, 5])
    wrong = passes.irradiance_field(world, camera, spectrum, 0.0, 64, 1)
    assert wrong is not None
    assert error(replace(wrong, refined=wrong.refined * 0)) > 3 * grid_alone


def test_refined_cells_know_light_where_the_grid_does_not(jit) -> None:
    """Rationale: rays that find no irradiance are traced on, and make most of the noise and the cost.

    Set-up: a random scene whose floor recedes fast, 96 x 72 px, through a pinhole: with refined cells,
    without them, and by path tracing.
    Expectation: of rays without known light two thirds are left at most; means over blocks of 12 x 12 px are those of
    path tracing within 3 % in the root mean square.
    """
    scene = dasim.random_scene(0, 3, dasim.RandomScenes(floating=True))
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), 96, 72), scene)
    world = translate.load(scene)
    field = passes.irradiance_field(world, camera, scenes.light_spectrum(scene), 0.0, 64, 1)
    assert field is not None
    grid_alone = replace(field, refined=field.refined * 0)
    unknown = [1 - _known(world, camera, each) for each in (field, grid_alone)]
    assert unknown[0] < 2 / 3 * unknown[1]

    def blocks(field: irradiance.Field | None, spp: int) -> FloatArray:
        picture = passes.pinhole_pass(world, camera, passes.Sampling(spp, 3), field)
        return picture.reshape(6, 12, 8, 12, -1).mean(axis=(1, 3))

    assert np.sqrt(np.mean((blocks(field, 64) / blocks(None, 256) - 1) ** 2)) < 0.03


def test_refined_cells_have_the_nodes_of_their_places(jit, monkeypatch) -> None:
    """Rationale: light changes little within a cell, so that the wrong one of its nodes would hardly be seen; depth on
    a floor that recedes fast changes much.

    Set-up: rays that end in refined cells of such a floor.
    Expectation: they end on the surface that the cell's corners see, where depths agree within 0.1 %; and, where points
    must lie in the planes of the nodes within 0.1 mm, as many know their light.
    """
    scene = dasim.random_scene(0, 3, dasim.RandomScenes(floating=True))
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), 96, 72), scene)
    world = translate.load(scene)
    field = passes.irradiance_field(world, camera, scenes.light_spectrum(scene), 0.0, 64, 1)
    assert field is not None

    def found() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        si, known, cell = _light(world, camera, field)
        rows, columns = field.shape
        here = (np.array(cell.number) >= (rows - 1) * (columns - 1)) & (np.abs(np.array(si.n)[1]) > 0.99)
        assert here.sum() > 500
        return np.array(known)[here], np.array(cell.is_on_surface)[here]

    known, is_on_surface = found()
    assert is_on_surface[known].mean() > 0.8
    monkeypatch.setattr(irradiance, "SAME_PLANE", 2e-4)
    assert found()[0].mean() > 0.95 * known.mean()


def _light(world: Any, camera: dasim.Camera, field: irradiance.Field) -> tuple[Any, Any, Any]:
    """Where rays through the middle of the lens end, whether light is known there, and in which cell."""
    import drjit as dr
    import mitsuba as mi

    size = camera.sensor.width_px, camera.sensor.height_px
    axis, scale = principal_point(camera.sensor), ray_pass.px_per_m(camera)
    place = np.random.default_rng(0).uniform(0, size, (1 << 14, 2))
    slope = mi.Vector2f(*(mi.Float(side.astype(np.float32)) for side in ((place - axis) / scale).T))
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.0), dr.normalize(mi.Vector3f(slope.x, slope.y, 1.0))))
    ray.wavelengths = mi.Spectrum(450.0, 550.0, 600.0, 700.0)
    si = world.ray_intersect(ray)
    _, known, cell = field.at(si, si.is_valid() & irradiance.lambertian(si.bsdf(ray)))
    return si, known, cell


def _known(world: Any, camera: dasim.Camera, field: irradiance.Field) -> float:
    """Share of the rays through the middle of the lens that end where the irradiance is known."""
    return float(np.mean(_light(world, camera, field)[1]))
