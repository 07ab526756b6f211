"""Wave-true blur by weighted rays, against the camera's own kernels, which know no rays."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry, pointspread
from dasim.camera import specification as cameras
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS

DEPTH_CM = 18  # 7.9 px of visible blur, 3.6 px of the hole's: neither geometric nor in focus
ENERGY = 0.03  # encircled energy; 10,000 weighted hits are known to 0.01
EDGE = 0.02  # of the step's height
FLAT = 0.004


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(da_mobile, 48, 48)


@pytest.fixture(scope="module")
def render(jit, loaded):
    """The picture of a scene through all stops, wave-true or geometric."""
    from dasim.render import passes

    def picture(scene, camera, spp, diffraction="wave"):
        mitsuba_scene = loaded(scene)
        return sum(
            passes.stop_pass(
                mitsuba_scene, camera, stop, passes.Sampling(spp, 6), diffraction=diffraction, max_blur_px=9.0
            )
            for stop in camera.stops
        )

    return picture


@pytest.fixture(scope="module")
def profiles(camera):
    """Radial kernels of the camera at the depth, under the light of the lamp on white paper."""
    radius = np.arange(0, 72, pointspread.RADIAL_STEP_PX)
    from dasim.materials import library

    light = illuminants.illuminant("D65") * library.reflectance("white-paper")
    blur = np.array([float(geometry.blur_px(camera, DEPTH_CM / 100))])
    return pointspread.radial_profiles(camera, blur, light, radius)[0][0], radius


def within(picture: np.ndarray, radii) -> np.ndarray:
    """Share of the light within circles around the frame's centre."""
    y, x = np.indices(picture.shape)
    centre = (len(picture) - 1) / 2
    distance = np.hypot(y - centre, x - centre)
    return np.array([picture[distance <= r].sum() for r in radii]) / picture.sum()


def test_even_areas_stay_as_they_are(render, make_scene, camera, lamp):
    """Expectation: on a wall without any pattern, diffraction changes nothing beyond noise."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (40, 40), "position_cm": (0, 0, DEPTH_CM)}
    scene = make_scene(wall | {"material": "grey-card"}, lights=[lamp])
    small = cameras.cropped(camera, 16, 16)
    waves, rays = render(scene, small, 64), render(scene, small, 64, "off")
    np.testing.assert_allclose(waves.mean(axis=(0, 1)), rays.mean(axis=(0, 1)), rtol=FLAT)


@pytest.fixture(scope="module")
def spot(render, make_scene, camera, lamp):
    """A bright disc of 2 px radius before nothing."""
    radius_cm = 2 * 1.7e-3 * DEPTH_CM / (3.6 * 400 / 396.4)
    disc = {"name": "spot", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, DEPTH_CM)}
    scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
    return render(scene, camera, 900)


@pytest.mark.parametrize("channel", ["G", "IR"])
def test_small_source_has_the_energy_of_the_kernel(spot, profiles, channel):
    """Set-up: the kernel of wave optics at 64 places of the source, summed. Expectation: encircled energies within
    0.03; the geometric kernel differs by more, so the test can tell them apart.
    """
    picture, radii = spot[..., CHANNELS.index(channel)], np.arange(1.5, 16, 1.0)
    profile, radius = profiles
    turns = np.arange(64)
    places = 2 * np.sqrt((turns + 0.5) / 64) * np.exp(2j * np.pi * turns * 0.381966)
    expected = np.zeros((49, 49))
    for place in places:
        # The frame has 48 pixels, its centre between two: half a pixel off the middle of 49.
        offset = (place.imag - 0.5, place.real - 0.5)
        expected += pointspread.pixel_kernels(profile[CHANNELS.index(channel)], radius, 49, offset)
    theory = within(expected[:48, :48], radii)
    assert np.abs(within(picture, radii) - theory).max() < ENERGY


@pytest.mark.parametrize("beyond", ["ink", "nothing"])
@pytest.mark.parametrize("channel", ["G", "IR"])
def test_edge_is_the_step_spread_by_the_kernel(render, make_scene, camera, lamp, profiles, channel, beyond):
    """Set-up: white paper left of the frame's middle; right of it black ink at the same depth, or nothing (there rays
    that pass the edge belong to another depth).

    Expectation: the mean row is the running sum of the kernel's columns, within 0.02 of the step; that of rays alone
    is farther off for the near-infrared, where diffraction decides.
    """
    sheet = {"name": "sheet", "shape": "plane", "size_cm": (40, 40), "position_cm": (-20, 0, DEPTH_CM)}
    things = [sheet | {"material": "white-paper"}]
    if beyond == "ink":
        things.append(sheet | {"name": "ink", "position_cm": (20, 0, DEPTH_CM), "material": "carbon-black"})
    scene = make_scene(*things, lights=[lamp])
    index = CHANNELS.index(channel)
    # Sources at eight places a pixel, in all pixels left of the edge: pixel k gets what the kernel of a source in
    # pixel q throws k - q to the right, summed over q <= 23.
    profile, radius = profiles
    offsets = (np.arange(8) + 0.5) / 8 - 0.5
    kernels = [pointspread.pixel_kernels(profile[index], radius, 97, (0.0, offset)) for offset in offsets]
    lines = np.mean(kernels, axis=0).sum(axis=0)
    step = np.array([lines[48 + k - 23 :].sum() for k in range(48)]) / lines.sum()

    def rendered(diffraction):
        row = render(scene, camera, 64, diffraction)[..., index].mean(axis=0)
        black = row[-4:].mean() - (step[-4:].mean() / step[:4].mean()) * row[:4].mean() if beyond == "ink" else 0.0
        return (row - black) / (row[:4].mean() - black) * step[:4].mean()

    assert np.abs(rendered("wave") - step).max() < EDGE
    if channel == "IR":
        assert np.abs(rendered("off") - step).max() > EDGE


# --- every depth in focus ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def in_focus(jit, loaded):
    """The picture of a scene through all stops, every depth in focus."""
    from dasim.render import passes

    def picture(scene, camera, spp):
        mitsuba_scene = loaded(scene)
        return sum(
            passes.stop_pass(
                mitsuba_scene,
                camera,
                stop,
                passes.Sampling(spp, 7),
                diffraction="wave",
                max_blur_px=9.0,
                in_focus=True,
            )
            for stop in camera.stops
        )

    return picture


def test_in_focus_a_small_source_has_the_kernel_of_the_focal_plane(in_focus, make_scene, camera, lamp):
    """Set-up: a bright disc of 1 px radius, out of focus by 7.9 px in the visible and 3.6 px in the infrared; kernels
    of ``dasim.psf`` for a point in the focal plane at four places of the disc, summed. Expectation: encircled energies
    within 0.03, and off by more than twice that for kernels of the disc's own depth.
    """
    small, radii = cameras.cropped(camera, 24, 24), np.arange(1.5, 9, 1.0)
    radius_cm = 1.7e-3 * DEPTH_CM / (3.6 * 400 / 396.4)
    disc = {"name": "spot", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, DEPTH_CM)}
    scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
    picture = in_focus(scene, small, 900)
    places = [(0.71, 0.0), (-0.71, 0.0), (0.0, 0.71), (0.0, -0.71)]  # a ring with the second moment of the disc

    def theory(depth_m, channel):
        kernel = np.zeros((25, 25))
        for y, x in places:
            # The frame has 24 pixels, its centre between two: half a pixel off the middle of 25.
            kernel += pointspread.psf(small, depth_m, channel, "D65", offset_px=(y - 0.5, x - 0.5), size=25)
        return within(kernel[:24, :24], radii)

    for channel in ("G", "IR"):
        shares = within(picture[..., CHANNELS.index(channel)], radii)
        assert np.abs(shares - theory(small.lens.focus_distance_m, channel)).max() < ENERGY
        assert np.abs(shares - theory(DEPTH_CM / 100, channel)).max() > 2 * ENERGY


@pytest.mark.parametrize("at_px", [None, (0, 0)], ids=["axis", "corner"])
def test_in_focus_is_what_the_lens_sees_of_a_plane_in_focus(in_focus, render, make_scene, da_mobile, lamp, at_px):
    """Set-up: an edge in the middle of a window of the sensor. Expectation: rows across an edge in the focal plane
    agree to 2 % of the step, where a pinhole's picture differs by a third; out of focus the picture stays as it is, at
    unchanged angles. The same in the corner, where diffraction is wider.
    """
    thin = cameras.cropped(da_mobile, 32, 16, at_px=at_px)
    focus_cm = 100 * thin.lens.focus_distance_m
    middle = np.array([0.0, 0.0] if at_px is None else [16 - 1024, 8 - 768])  # of the window, pixels from the axis
    slope = middle * thin.sensor.pixel_pitch_um * 1e-6 / geometry.image_distance_m(thin)

    def edge(cm):
        sheet = {"name": "sheet", "shape": "plane", "size_cm": (cm, cm), "material": "white-paper"}
        return make_scene(sheet | {"position_cm": (*(cm * (slope - (0.5, 0.0))), cm)}, lights=[lamp])

    def row(picture):
        return picture.mean(axis=0) / picture[:, :4].mean(axis=(0, 1))

    focused, lens = row(in_focus(edge(focus_cm), thin, 256)), row(render(edge(focus_cm), thin, 256))
    assert np.abs(focused - lens).max() < EDGE
    assert np.abs(focused - row(in_focus(edge(DEPTH_CM), thin, 256))).max() < 2e-3
    assert np.abs(focused - (np.arange(32) < 16)[:, None]).max() > 0.15
