"""Axial colour and shading of the lens in rendered pictures, against the thin lens written out."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import radiometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera

MOMENTS = 0.02  # a second moment of about 60,000 hits is known to 1 %
FLAT = 0.004  # sampling noise of a grey wall
SHIFT = [[500, -30], [600, 30]]  # um


@pytest.fixture(scope="module")
def passes(jit):
    from dasim.render import passes

    return passes


@pytest.fixture(scope="module")
def changed(da_mobile):
    def make(stops: list[dict] | None = None, **lens) -> Camera:
        data = da_mobile.model_dump()
        data["lens"] |= lens
        return parse(Camera, data | ({} if stops is None else {"stops": stops}), "camera")

    return make


@pytest.fixture(scope="module")
def disc(loaded, make_scene, lamp):
    """A disc of 4 px radius in front of nothing, 20 cm away."""
    radius_cm = 4 * 1.7e-3 * 20 / (3.6 * 400 / 396.4)
    thing = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, 20)}
    return loaded(make_scene(thing | {"material": "white-paper"}, lights=[lamp]))


def blur_px(nm: float) -> float:
    """Signed blur of the open lens at 20 cm, from 1/s = 1/f - 1/d_f at the unshifted focal length and 1/d_f =
    1/f(lambda) - 1/s.
    """
    image_mm = 1 / (1 / 3.6 - 1 / 400)
    focal_mm = 3.6 + 1e-3 * np.interp(nm, *np.transpose(SHIFT))
    in_focus = 1 / focal_mm - 1 / image_mm
    return 3.6 / 2.8 * image_mm * (1 / 200 - in_focus) / 1.7e-3


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.4, -0.2)])
@pytest.mark.parametrize("nm", [504, 554, 604])
def test_blur_follows_the_wavelength(passes, changed, disc, nm, centre):
    """Set-up: a narrow band of green through a disc of 0.5, diffraction off; the blur is about 14.4, 7.1 and 0.1 px.

    Expectation: a variance of c^2 / 16 plus source and pixel, as in a lens without axial colour, and the centroid at
    -rho c / 2.
    """
    stop = {"name": "stop", "radius_ratio": 0.5, "centre_ratio": centre}
    stop |= {"passes_nm": [[nm - 4, nm + 4]], "edge_width_nm": 1}
    camera = cameras.cropped(changed([stop], focal_shift_um=SHIFT), 48, 48)
    picture = passes.stop_pass(disc, camera, camera.stops[0], passes.Sampling(256, 5))[..., 1]
    picture /= picture.sum()
    place = np.arange(48) - 23.5
    for line, rho in ((picture.sum(axis=0), centre[0]), (picture.sum(axis=1), centre[1])):
        mean = line @ place
        assert mean == pytest.approx(-rho * blur_px(nm) / 2, abs=0.06)
        expected = (0.5 * blur_px(nm)) ** 2 / 16 + 4**2 / 4 + 1 / 12
        assert line @ place**2 - mean**2 == pytest.approx(expected, rel=MOMENTS)


@pytest.mark.parametrize("diffraction", ["off", "wave"])
def test_a_curve_of_zeros_changes_nothing(passes, changed, disc, diffraction):
    """Expectation: the same picture within noise (other random numbers), and without a curve the blur of one focus."""
    plain, zero = (cameras.cropped(changed(focal_shift_um=curve), 32, 32) for curve in ([], [[400, 0], [830, 0]]))
    first, second = (
        passes.stop_pass(
            disc, camera, camera.stops[0], passes.Sampling(400, 5), diffraction=diffraction, max_blur_px=8.0
        )[..., 1]
        for camera in (plain, zero)
    )
    assert second.sum() == pytest.approx(first.sum(), rel=0.02)
    for axis in (0, 1):
        running = [np.cumsum(picture.sum(axis=axis)) / picture.sum() for picture in (first, second)]
        np.testing.assert_allclose(*running, atol=0.01)


@pytest.mark.slow
def test_axial_colour_keeps_even_areas(passes, changed, make_scene, loaded, lamp):
    """Expectation: a wall without pattern is as bright with strong axial colour as without, in every channel."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (40, 40), "position_cm": (0, 0, 20), "material": "grey-card"}
    scene = loaded(make_scene(wall, lights=[lamp]))
    plain, coloured = (cameras.cropped(changed(focal_shift_um=curve), 16, 16) for curve in ([], SHIFT))
    for diffraction in ("off", "wave"):
        for index in (0, 1):
            first, second = (
                passes.stop_pass(
                    scene, camera, camera.stops[index], passes.Sampling(64, 3), diffraction=diffraction, max_blur_px=9.0
                ).mean(axis=(0, 1))
                for camera in (plain, coloured)
            )
            np.testing.assert_allclose(first, second, rtol=FLAT, atol=1e-3 * first.max())


def test_shading_is_cos4_times_the_polynomial(passes, changed, make_scene, loaded):
    """Set-up: an even dome and wall, a view to 1.5 mm from the axis; a_1 = -0.1 and a_2 = 0.02; coatings that stay.

    Expectation: corner over middle is cos^4 times 1 + a_1 r^2 + a_2 r^4 at the patches' radius in millimetres; a
    central crop has the very values of the whole frame.
    """
    wall = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "grey-card"}
    scene = loaded(make_scene(wall))
    data = changed(shading_per_mm=[-0.1, 0.02], coating_index=0).model_dump()
    data["sensor"] |= {"width_px": 48, "height_px": 36, "pixel_pitch_um": 50.0}
    camera = parse(Camera, data, "camera")
    picture = passes.stop_pass(scene, camera, camera.stops[0], passes.Sampling(64, 1))[..., 1]
    image_mm = 1 / (1 / 3.6 - 1 / 400)

    def expected(y: float, x: float) -> float:
        r2 = (y**2 + x**2) * 0.05**2
        return (image_mm**2 / (image_mm**2 + r2)) ** 2 * (1 - 0.1 * r2 + 0.02 * r2**2)

    corner = np.mean([expected(y, x) for y in np.arange(-17.5, -13) for x in np.arange(-23.5, -19)])
    middle = np.mean([expected(y, x) for y in np.arange(-1.5, 2) for x in np.arange(-1.5, 2)])
    assert picture[:5, :5].mean() / picture[16:20, 22:26].mean() == pytest.approx(corner / middle, rel=2 * FLAT)
    crop = radiometry.relative_illumination(cameras.cropped(camera, 24, 16))
    np.testing.assert_allclose(crop, radiometry.relative_illumination(camera)[10:26, 12:36], rtol=1e-12)


@pytest.mark.parametrize(
    ("stop", "curve", "message"),
    [
        ({"shape": "annulus", "inner_ratio": 0.5, "outer_ratio": 1.0}, [], "stop 'one' is not a centred disc"),
        ({"radius_ratio": 0.3, "centre_ratio": [0.1, 0.0]}, [], "stop 'one' is not a centred disc"),
        ({"radius_ratio": 1.0}, [[400, 0], [830, 5]], "lens.focal_shift_um is set"),
        ({"radius_ratio": 1.0, "phase_nm": 100}, [], "stop 'one' has a phase_nm"),
    ],
)
def test_stock_plugins_refuse_before_any_work(changed, make_scene, stop, curve, message):
    """Expectation: one line that says what and what to install, and no step of progress before it."""
    import dasim

    camera = changed([{"name": "one"} | stop], focal_shift_um=curve)
    card = {"name": "card", "shape": "plane", "size_cm": (4, 4), "position_cm": (0, 0, 20), "material": "grey-card"}
    steps: list[str] = []
    with pytest.raises(InputError, match=r"install LLVM 17 or newer") as raised:
        dasim.simulate(
            make_scene(card), camera, variant="scalar_spectral", progress=lambda stage, share: steps.append(stage)
        )
    assert message in str(raised.value) and "\n" not in str(raised.value)
    assert steps == []
