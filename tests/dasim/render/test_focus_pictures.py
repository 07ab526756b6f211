"""Pictures with every depth in focus by convolution, against rays through the stops, which know no convolution."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import specification as cameras
from dasim.render import backend, focus_pictures, pinhole

SIZE, RAYS = (40, 24), 1024
OPTICS = {"max_blur_px": 9.0, "field": None}


@pytest.fixture(scope="module")
def wall(make_scene, lamp, loaded):
    """A wall of fine grains in two deep colours, larger than the view of a whole sensor."""
    grains = {
        "kind": "blend",
        "image": "skimage:gravel",
        "repeat": [24, 24],
        "dark": "checker-green",
        "bright": "checker-red",
    }
    board = {"name": "wall", "shape": "plane", "size_cm": [120, 120], "position_cm": [0, 0, 50], "material": "grains"}
    return loaded(make_scene(board, lights=[lamp], materials={"grains": grains}))


def pictures(scene, camera, spp, seed=3):
    """The pictures through the stops, and those through a pinhole."""
    from dasim.render import passes

    also = cameras.load_camera("bayer-mobile")
    return passes.sharp_pass(scene, camera, passes.Sampling(spp, seed), None, also, diffraction="wave", max_blur_px=9.0)


@pytest.mark.parametrize("place", ["axis", "corner"])
def test_pictures_are_those_of_rays_through_the_stops(jit, wall, place, monkeypatch):
    """Rationale: all-in-focus pictures are scored against these.

    Set-up: the frame on the axis, or in the corner of the whole sensor behind a lens with distortion, where kernels are
    up to a third wider in one direction, in four tiles; in comparison, 1,024 rays per pixel through every stop and
    through a pinhole. Expectation: means within 0.1 %, pixels within 1 % (root mean
    square); in the corner, less than half as well with the kernels of the axis.
    """
    from dasim.render import passes

    camera = cameras.load_camera("da-mobile")
    if place == "corner":
        lens = camera.lens.model_copy(update={"distortion_per_mm": (-0.02, 0.001)})
        camera = camera.model_copy(update={"lens": lens})
    camera = cameras.cropped(camera, *SIZE, at_px=(0, 0) if place == "corner" else None)
    monkeypatch.setattr(backend, "LANES", 64 * 30 * 20)
    ours, sampling = pictures(wall, camera, 64), passes.Sampling(RAYS, 4)
    drawn = sum(
        passes.stop_pass(wall, camera, stop, sampling, diffraction="wave", in_focus=True, **OPTICS)
        for stop in camera.stops
    )
    pinhole = passes.pinhole_pass(wall, camera, sampling, None, cameras.load_camera("bayer-mobile"))

    def errors(found, true):
        error = (found - true) / true.mean(axis=(0, 1))
        return np.abs(error.mean(axis=(0, 1))), np.sqrt(np.mean(error**2, axis=(0, 1)))

    for found, true in ((sum(ours.in_focus.values()), drawn), (ours.rate.mean(axis=0), pinhole)):
        mean, rms = errors(found, true)
        assert mean.max() < 1e-3 and rms.max() < 0.01, (mean, rms)
    if place == "corner":
        monkeypatch.setattr(focus_pictures, "_towards_axis", lambda *_: np.eye(2))
        wrong = sum(pictures(wall, camera, 64).in_focus.values())
        assert errors(wrong, drawn)[1][3] > 2 * errors(sum(ours.in_focus.values()), drawn)[1][3]


def test_places_of_edges_do_not_depend_on_wavelength(jit, make_scene, loaded, lamp):
    """Rationale: if the rays of a node had always the same wavelengths, a channel that sees few of them would see some
    nodes alone, and edges at other places.

    Set-up: white paper above black ink, blue through the hole, which passes near-infrared alone. Expectation: a row on
    either side of the edge, means over the columns, are within 0.5 % of the step of those of rays (2 % with the same
    wavelengths for a node).
    """
    from dasim.render import passes

    sheet = {"shape": "plane", "size_cm": [60, 60]}
    paper = sheet | {"name": "paper", "position_cm": [0, -30, 50], "material": "white-paper"}
    ink = sheet | {"name": "ink", "position_cm": [0, 30, 50], "material": "carbon-black"}
    scene, camera = loaded(make_scene(paper, ink, lights=[lamp])), cameras.cropped("da-mobile", *SIZE)
    ours = pictures(scene, camera, 256).in_focus[1][..., 2].mean(axis=1)
    optics = OPTICS | {"diffraction": "wave", "in_focus": True}
    drawn = passes.stop_pass(scene, camera, camera.stops[1], passes.Sampling(RAYS, 4), **optics)[..., 2].mean(axis=1)
    step = drawn[:4].mean() - drawn[-4:].mean()
    middle = slice(SIZE[1] // 2 - 2, SIZE[1] // 2 + 2)
    assert np.abs(ours - drawn)[middle].max() < 5e-3 * step


def test_weights_of_nodes_blur_an_edge_wherever_it_lies_in_a_node(jit):
    """Rationale: with the weight of its middle for a whole node, an edge is up to 0.7 % of its step off.

    Set-up: a step at eleven places from one node to the next, whose moments are known, in green through the open lens.
    Expectation: the pixel beside it is within 0.1 % of a sum over 64 points per pixel.
    """
    camera = cameras.cropped("da-mobile", *SIZE)
    core = focus_pictures._core(camera, camera.stops[0], None, 9.0)
    margin, cells = focus_pictures.MARGIN_PX, pinhole.CELLS
    weights = core.nodes(np.eye(2))[1].sum(axis=(1, 3))  # of columns, [moment, column, x]
    at = np.arange(-64 * margin, 64 * margin + 1) / 64
    place = np.stack(np.meshgrid(at, at), axis=-1)
    kernel = core._at(place)[..., 1].sum(axis=2) * (np.hypot(place[..., 0], place[..., 1]) <= focus_pictures.CORE_PX)
    profile = np.convolve(kernel.sum(axis=0), np.r_[0.5, np.ones(63), 0.5], mode="same")
    beyond = 1 - (np.cumsum(profile) - profile / 2) / profile.sum()
    left = np.arange(-margin, margin + 1) + np.arange(cells)[:, None] / cells - 0.5  # of the nodes
    for step in np.linspace(0, 1 / cells, 11) - 0.5:
        lit = np.clip((left + 1 / cells - step) * cells, 0, 1)  # share of a node beyond the step
        found = np.sum(weights[0] * lit + weights[1] * lit * (1 - lit) / (2 * cells))
        assert found == pytest.approx(np.interp(step, at, beyond), abs=1e-3)


@pytest.mark.slow
def test_other_stops_are_left_to_their_own_rays(jit):
    """Set-up: a square beside a disc, a lens with aberrations, and one whose open disc is too fast for the nodes.

    Expectation: the disc, none, and the hole.
    """

    def convolved(camera):
        return focus_pictures.InFocus(camera, None, 9.0, 20).stops

    plain = cameras.cropped("da-mobile", *SIZE)
    corners = [[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]]
    square = {"name": "square", "shape": "polygon", "corners_ratio": corners}
    values = plain.model_dump()
    mixed = type(plain).model_validate(values | {"stops": [values["stops"][0], square]})
    assert convolved(mixed) == [mixed.stops[0]]
    for changes, numbers in (({"wavefront_nm": {"spherical": 60.0}}, []), ({"f_number": 0.9}, [1])):
        other = type(plain).model_validate(values | {"lens": values["lens"] | changes})
        assert convolved(other) == [other.stops[number] for number in numbers]
