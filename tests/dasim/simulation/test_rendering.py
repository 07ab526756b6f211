"""The pixels that may get light from several depths, and the others, which take fewer samples."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.render.ray_pass import px_per_m
from dasim.simulation import exact, rendering, rendering_noise
from dasim.simulation.adaptive_sampling import FEWEST_OF_LAYERS, FEWEST_SPP
from dasim.simulation.rendering import Picture, Sampling, View
from dasim.simulation.simulate import prepare, simulate

WALL_M, CARD_M, CARD_WIDTH_M = 0.6, 0.25, 0.02
SIZE_PX = 128, 96
IR, HOLE = 3, 1  # channel and stop


def view_of(make_scene, da_mobile, focus_m, size_px, materials=("sand", "sand")) -> View:
    """The right half of the frame sees a card before a wall."""
    card = {"name": "card", "shape": "plane", "size_cm": (100 * CARD_WIDTH_M, 100), "material": materials[0]}
    card |= {"position_cm": (50 * CARD_WIDTH_M, 0, 100 * CARD_M)}
    wall = {"name": "wall", "shape": "plane", "size_cm": (200, 200), "material": materials[1]}
    wall |= {"position_cm": (0, 0, 100 * WALL_M)}
    lens = da_mobile.lens.model_copy(update={"focus_distance_m": focus_m})
    camera = cameras.cropped(da_mobile.model_copy(update={"lens": lens}), *size_px)
    dome = {"kind": "dome", "illuminant": "A", "lux": 1000.0}
    return prepare(make_scene(card, wall, lights=[dome]), camera, None, None, lambda stage, share: None)


@pytest.mark.parametrize("focus_m", [WALL_M, 0.35, CARD_M])
def test_pixels_with_rays_to_two_depths_are_known(make_scene, da_mobile, jit, focus_m):
    """Rationale: few samples bias such a pixel, so that it must have more of them.

    Set-up: the right half of the frame sees a card before a wall; focused on the wall, between both, and on the card.
    Rays of 400 places on the lens through the centre and the corners of each pixel meet the card or the wall, by the
    lines of similar triangles.

    Expectation: a pixel whose rays meet both is in the mask; of those whose rays meet one, at most a fifth is: the mask
    takes the larger blur of two surfaces, although one in focus hides the one behind it sharply.
    """
    view = view_of(make_scene, da_mobile, focus_m, SIZE_PX)
    camera = view.camera
    mask = rendering._sees_several_depths(view)

    slope = np.arange(SIZE_PX[0] + 1) - SIZE_PX[0] / 2
    slope = slope / px_per_m(camera)  # of the rays through the middle of the lens
    x = np.linspace(-1, 1, 400)[:, None] * geometry.aperture_m(camera) / 2
    at_card = x + (slope * focus_m - x) * (CARD_M / focus_m)
    inside = (at_card > 0) & (at_card < CARD_WIDTH_M)
    both = inside.any(axis=0) & ~inside.all(axis=0)
    several = both[:-1] | both[1:]
    assert mask[:, several].all()
    border = int(np.ceil(view.reach_px / 2))
    inner = mask[border:-border, border:-border]
    one = ~several[border:-border]
    assert inner[:, one].mean() < 0.2 and (several.any() or focus_m == CARD_M)


def test_control_variates_are_released_after_their_last_use(make_scene, da_mobile, jit):
    """Rationale: those of a large frame take 200 MB per stop.

    Expectation: when the rays of the second stop are traced, the first stop's control variate is there only if it is
    needed again; afterwards so are all; the picture is the same either way.
    """
    view = view_of(make_scene, da_mobile, WALL_M, (48, 32))
    sampling, there, rates = Sampling(4, 0.25, 50.0, 1), [], []

    def progress(stage: str, share: float) -> None:
        if view.camera.stops[1].name in stage:
            there.append(sharp.controls[0] is not None)

    for again in (True, False):
        sharp = exact.sharp_pictures(view, sampling, lambda stage, share: None)
        there.clear()
        rates.append(rendering.lens_picture(view, sharp, sampling, Exposure(), progress, again=again).rate)
        assert there and set(there) == {again}
        assert [control is not None for control in sharp.controls] == [again, again]
    np.testing.assert_array_equal(*rates)


@pytest.mark.slow
def test_few_samples_have_no_bias_where_one_depth_is_seen(make_scene, da_mobile, jit):
    """Rationale: in the tail of the hole's diffraction pattern, a ray in hundreds meets another depth. Four rays of
    which one does so were taken for two layers, and its light counted too much: 0.05 to 0.1 % beside an edge.

    Set-up: a white card before a black wall, infrared through the hole; the mean of 32 pairs of pictures of 4 samples,
    and of 8 pairs of 16, over the pixels of the card that see one depth, up to 14 px from those that may see both.

    Expectation: no difference, to 4.5 standard errors; if layers are separated at 4 samples, a lack of light, by 5.
    """
    view = view_of(make_scene, da_mobile, 0.35, (96, 48), ("ceramic-white", "carbon-black"))
    several = rendering._sees_several_depths(view)
    edge = 1 + np.flatnonzero(several[24, :70]).max()
    beside = np.zeros_like(several)
    beside[:, edge : edge + 14] = True
    beside &= ~several
    sharp = exact.sharp_pictures(view, Sampling("auto", 0.25, 50.0, 1), lambda stage, share: None)

    def means(spp: int, count: int, layers_from: int) -> np.ndarray:
        result = []
        for seed in range(count):
            pair = []
            for half in range(2):
                of_each = np.full(several.shape, spp)
                own = 1000 * spp + 2 * seed + half
                ratios = rendering.stop_picture(
                    *(view, sharp, HOLE, sharp.field, of_each, own, lambda stage, share: None), layers_from=layers_from
                )
                pair.append(Picture(of_each[None], *(part[None] for part in ratios)))
            result.append(rendering_noise.mean_and_left(*pair)[0][0, ..., IR][beside].mean())
        return np.array(result)

    many = means(16, 8, FEWEST_OF_LAYERS)
    z = []
    for layers_from in (FEWEST_OF_LAYERS, 1):
        few = means(FEWEST_SPP, 32, layers_from)
        z.append((few.mean() - many.mean()) / np.sqrt(few.var(ddof=1) / len(few) + many.var(ddof=1) / len(many)))
    assert abs(z[0]) < 4.5 and z[1] < -5, z


def wire_and_wall(make_scene, *, width_px: float, at_px: float, da_mobile):
    """A plane of a width at 10 cm, whose left edge lies ``at_px`` from the axis, before a wall in focus at 40 cm."""
    px = da_mobile.sensor.pixel_pitch_um * 1e-6 / geometry.image_distance_m(cameras.refocused(da_mobile, 0.4))
    wire = {"name": "wire", "shape": "plane", "size_cm": (10 * width_px * px, 4), "material": "checker-white"}
    wire |= {"position_cm": (10 * px * (at_px + width_px / 2), 0, 10)}
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "material": "checker-black"}
    wall |= {"position_cm": (0, 0, 40)}
    return make_scene(wire, wall, lights=[{"kind": "dome", "illuminant": "D65", "lux": 800.0}])


@pytest.mark.parametrize(
    ("width_px", "at_px", "seen"),
    [(0.9, -0.45, True), (40, 32 + 6, True), (40, 32 + 14, False)],
    ids=["between pixel centres", "beside the frame", "too far beside it"],
)
def test_the_reach_of_blur_knows_what_no_pixel_centre_sees(make_scene, da_mobile, jit, width_px, at_px, seen):
    """Rationale: kernels beyond the reach are those of geometric optics.

    Set-up: a frame of 64 px, whose pixel centres see the wall in focus alone, and something at 10 cm, with 20.6 px of
    blur. Expectation: the reach covers that blur, unless its disc of 10.3 px ends before the frame.
    """
    scene = wire_and_wall(make_scene, width_px=width_px, at_px=at_px, da_mobile=da_mobile)
    view = prepare(scene, cameras.cropped(cameras.refocused(da_mobile, 0.4), 64, 32), None, None, lambda *_: None)
    assert np.abs(view.blur_px).max() < 0.01
    assert (view.reach_px > 20.6) == seen and (seen or view.reach_px < 0.1)


def test_light_in_a_gap_between_two_surfaces(make_scene, da_mobile, jit, monkeypatch):
    """Set-up: a ramp that ends 0.8 mm, four pixels, before a wall, under a dome. Expectation: the light of each row
    beside its end is that of a path tracer that interpolates no irradiance, within 3.5 %; three standard errors.
    """
    wall = {"name": "wall", "shape": "plane", "size_cm": (200, 200), "material": "checker-neutral-5"}
    ramp = {
        "name": "ramp",
        "shape": "plane",
        "size_cm": (40, 40),
        "material": "wood-light",
        "rotation_deg": (-85, 0, 0),
    }
    scene = make_scene(
        wall | {"position_cm": (0, 0, 60)},
        ramp | {"position_cm": (0, 1.2, 40)},
        lights=[{"kind": "dome", "illuminant": "D65", "lux": 800.0}],
    )
    camera = cameras.cropped(cameras.cropped(da_mobile, 48, 48), 24, 12, at_px=(12, 0))

    def rows():
        shots = [simulate(scene, camera, seed=seed, spp=64, exposure=Exposure(time_s=0.02)) for seed in range(3)]
        return np.mean([shot.truth.mean_e[:7] for shot in shots], axis=(0, 2))[..., 1]

    ours = rows()
    monkeypatch.setattr(rendering.passes, "irradiance_field", lambda *_, **__: None)
    np.testing.assert_allclose(ours, rows(), rtol=0.035)
