"""Point-spread functions against closed forms, a Fourier transform of a sampled pupil, and geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0, j1

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry, pointspread, radial_pattern, radiometry
from dasim.camera.pointspread import pixel_kernels, psf, radial_profiles
from dasim.camera.radial_pattern import wave_profile
from dasim.camera.specification import Camera
from dasim.spectra import grid as spectra
from dasim.spectra.grid import CHANNELS
from dasim.spectra.illuminants import illuminant

STEP = 0.01  # in lambda N, of the tests' own integrals over radius
QUADRATURE = 1e-4  # of those integrals by trapezoids
SAMPLED_PUPIL = 0.01  # a disc of 128 samples across has a ragged edge
ENERGY = 2e-3  # kernels are sampled ten times a pixel and axis
SIDES = 1e-9  # both halves of a symmetric kernel come from the same numbers


@pytest.fixture(scope="module")
def hole_only(da_mobile):
    """da-mobile behind its hole alone, all wavelengths: one stop of f / 6.1."""
    hole = da_mobile.stops[1].model_copy(update={"passes": "all"})
    return da_mobile.model_copy(update={"stops": (hole,)})


def encircled(profile: np.ndarray, radius: np.ndarray) -> np.ndarray:
    ring = 2 * np.pi * radius * profile
    return np.concatenate([[0.0], np.cumsum((ring[1:] + ring[:-1]) / 2 * np.diff(radius))])


def moments(kernel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid from the middle pixel and variance, each (y, x)."""
    kernel = kernel / kernel.sum()
    place = np.arange(len(kernel)) - len(kernel) // 2
    sums = [kernel.sum(axis=1), kernel.sum(axis=0)]
    mean = np.array([line @ place for line in sums])
    return mean, np.array([line @ place**2 for line in sums]) - mean**2


def test_in_focus_energy_is_that_of_airy():
    """Expectation: encircled energy 1 - J0^2 - J1^2 (Rayleigh), 83.8 % within the first dark ring."""
    radius = np.arange(0, 10, STEP)
    energy = encircled(wave_profile(radius, np.array([0.0]))[0], radius)
    np.testing.assert_allclose(energy, 1 - j0(np.pi * radius) ** 2 - j1(np.pi * radius) ** 2, atol=QUADRATURE)
    assert np.interp(1.2197, radius, energy) == pytest.approx(0.838, abs=1e-3)


def test_in_focus_transfer_is_the_overlap_of_two_discs():
    """Set-up: Hankel transform of the in-focus profile up to 300 lambda N, where 7e-4 of the light is left.

    Expectation: the area two unit discs share, counted on a grid.
    """
    radius = np.arange(0, 300, STEP)
    profile = wave_profile(radius, np.array([0.0]))[0]
    grid = np.linspace(-1, 1, 1201)
    y, x = np.meshgrid(grid, grid, indexing="ij")
    for v in (0.05, 0.3, 0.5, 0.8, 0.95):
        transfer = np.trapezoid(2 * np.pi * radius * profile * j0(2 * np.pi * v * radius), radius)
        shared = np.count_nonzero((np.hypot(x - v, y) <= 1) & (np.hypot(x + v, y) <= 1))
        overlap = shared / np.count_nonzero(np.hypot(x, y) <= 1)
        assert transfer == pytest.approx(overlap, abs=3e-3)
        assert radial_pattern.ring_mtf(np.array([v]))[0] == pytest.approx(overlap, abs=2e-3)


def test_defocus_on_the_axis_is_a_sinc():
    """Expectation: on the axis intensity falls as sinc^2(W20), dark at whole waves (Born and Wolf, sec. 8.8)."""
    waves = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 7.0])
    axis = wave_profile(np.array([0.0]), waves)[:, 0]
    np.testing.assert_allclose(axis / axis[0], np.sinc(waves) ** 2, atol=1e-12)


@pytest.mark.parametrize("inner", [0.0, 0.4])
def test_interpolated_profiles_are_those_of_the_integral(inner, monkeypatch):
    """Set-up: four wavelengths, in parts of one and all together, to a radius of 90 rings at the shortest, up to 12
    waves of defocus. Expectation: equal to 1e-5 of each peak, and finite for a single radius and for no wavelength.
    """
    radius_px, scale_px = np.arange(0, 60, 0.05), np.array([0.66, 0.9, 1.2, 1.5])
    waves = np.array([0.0, 0.3, -2.0, 12.0]) * 0.66 / scale_px[:, None]
    whole = np.stack(list(radial_pattern.wave_profiles(radius_px, scale_px, waves, inner)))
    monkeypatch.setattr(radial_pattern, "AT_ONCE", 1 << 12)
    in_parts = np.stack(list(radial_pattern.wave_profiles(radius_px, scale_px, waves, inner)))
    for index, scale in enumerate(scale_px):
        expected = wave_profile(radius_px / scale, waves[index], inner) / scale**2
        peak = expected.max(axis=1, keepdims=True)
        for found in (whole, in_parts):
            np.testing.assert_allclose(found[index] / peak, expected / peak, atol=1e-5)
    (middle,) = radial_pattern.wave_profiles(np.zeros(1), scale_px[:1], waves[:1], inner)
    np.testing.assert_allclose(middle, whole[0][:, :1], rtol=1e-6, atol=1e-12)
    assert not list(radial_pattern.wave_profiles(radius_px, scale_px[:0], waves[:0], inner))


@pytest.mark.parametrize("waves", [0.0, 0.5, 1.2, 3.0])
def test_defocus_is_the_fourier_transform_of_a_sampled_pupil(waves):
    """Rationale: an independent method: no Bessel functions, no radial symmetry.

    Set-up: 1,024 x 1,024 grid, pupil 128 samples across with the quadratic phase, FFT, squared; one sample of the
    picture is 128 / 1,024 lambda N. Expectation: encircled energies agree within 0.01 at all radii.
    """
    size, across = 1024, 128
    axis = (np.arange(size) - size // 2) / (across / 2)
    rho2 = axis[:, None] ** 2 + axis**2
    pupil = np.where(rho2 <= 1, np.exp(2j * np.pi * waves * rho2), 0)
    picture = np.abs(np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(pupil)))) ** 2
    distance = np.hypot(*np.meshgrid(*[np.arange(size) - size // 2] * 2)) * across / size
    edges = np.arange(0.5, 20, 0.5)
    sampled = np.array([picture[distance <= edge].sum() for edge in edges]) / picture.sum()
    radius = np.arange(0, 20, STEP)
    ours = np.interp(edges, radius, encircled(wave_profile(radius, np.array([waves]))[0], radius))
    # A grid's disc of r samples has its area to a few samples: compare between neighbouring edges.
    assert np.abs(ours - sampled)[2:].max() < SAMPLED_PUPIL


def test_many_waves_of_defocus_approach_the_geometric_disc():
    """Rationale: rays are the limit of short waves. A disc of diameter c has encircled energy (2 r / c)^2, and c is
    8 W20 in units of lambda N. Expectation: the largest difference falls with W20, below 0.05 at 20 waves.
    """
    errors = []
    for waves in (1.5, 5.0, 20.0):
        radius = np.arange(0, 8 * waves + 8, STEP)
        energy = encircled(wave_profile(radius, np.array([waves]))[0], radius)
        errors.append(np.abs(energy - np.minimum(radius / (4 * waves), 1) ** 2).max())
    assert errors[0] > 1.5 * errors[1] > 1.5**2 * errors[2]
    assert errors[2] < 0.05


@pytest.mark.parametrize(("blur_px", "scale_px"), [(8.0, 2.6), (4.0, 0.9), (0.0, 2.6)])
def test_airy_and_disc_in_the_middle(blur_px, scale_px):
    """Expectation: the middle of disc * Airy is the Airy energy within the disc's radius over the disc's area; with no
    disc, Airy's peak pi / 4 over the unit's area. The rest of the plane brings the integral to 1.
    """
    radius = np.arange(0, 60 * scale_px, 0.05)
    profile = radial_pattern.airy_profile(radius, np.array([blur_px]), scale_px)[0]
    x = np.pi * blur_px / 2 / scale_px
    inside = 1 - j0(x) ** 2 - j1(x) ** 2
    expected = inside / (np.pi * blur_px**2 / 4) if blur_px else np.pi / 4 / scale_px**2
    assert profile[0] == pytest.approx(expected, rel=1e-3)
    left = 2 / np.pi**2 * scale_px / radius[-1]  # of Airy's energy, beyond
    assert encircled(profile, radius)[-1] == pytest.approx(1 - left, abs=left / 2)


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 3.0, 11.0, -11.0, 40.0])
def test_geometric_kernel_has_the_moments_of_a_disc_and_a_pixel(da_mobile, hole_only, blur_px):
    """Set-up: each stop's own blur c, on either side of the focus, at 16 sub-pixel places (one place alone has the
    moments of its own binning). Expectation: variance c^2 / 16 + 1 / 12 along each axis on average, sum 1, and at the
    middle of a pixel the same on all four sides. A blur below 0.3 px is drawn as 0.3 px and an edge
    of a tenth: 0.4^2 / 16 = 0.010 px^2.
    """
    radius = np.arange(0, 60, pointspread.RADIAL_STEP_PX)
    for camera, ratio in ((da_mobile.model_copy(update={"stops": da_mobile.stops[:1]}), 1.0), (hole_only, 0.46)):
        profiles, _ = radial_profiles(camera, np.array([blur_px]), illuminant("D65"), radius, "off")
        seconds = []
        for offset in np.stack(np.meshgrid(*[np.arange(4) / 4] * 2), axis=-1).reshape(-1, 2):
            kernel = pixel_kernels(profiles[0, 1], radius, 47, tuple(offset))
            mean, variance = moments(kernel)
            # Sampled at ten points a pixel, a disc's area is off by a tenth of its outline's samples.
            assert kernel.sum() == pytest.approx(1.0, abs=ENERGY + 0.01 / max(abs(blur_px) * ratio, 0.3))
            seconds.append(variance + (mean - offset) ** 2)
        expected = (ratio * blur_px) ** 2 / 16 + 1 / 12
        np.testing.assert_allclose(np.mean(seconds, axis=0), expected, rtol=0.01, atol=0.011)
        middle = pixel_kernels(profiles[0, 1], radius, 47)
        for turned in (middle[::-1], middle[:, ::-1], middle.T):
            np.testing.assert_allclose(turned, middle, atol=SIDES)


@pytest.fixture(scope="module")
def wave_kernels(da_mobile):
    """Profiles and kernels of all channels at 0, 8 and 20 px of visible blur, and the relative electrons."""
    size, radius = 65, np.arange(0, 50, pointspread.RADIAL_STEP_PX)
    profiles, signal = radial_profiles(da_mobile, np.array([0.0, 8.0, 20.0]), illuminant("D65"), radius)
    return profiles, radius, pixel_kernels(profiles, radius, size), signal


def test_wave_kernels_lose_only_what_falls_outside_the_frame(wave_kernels):
    """Rationale: light is conserved. Airy's energy beyond r lambda N is 2 / (pi^2 r): the frame's half width and its
    half diagonal bound what is missing. Set-up: 65 x 65 px; lambda N is 0.8 to 0.95 px in green's main band, 2.3 to
    2.9 px in the near-infrared, and a blur of 20 px shrinks the room by 10 (green) and 5 px (infrared) at most.
    """
    kernels = wave_kernels[2]
    for level, blur in enumerate((0.0, 8.0, 20.0)):
        for channel, low, high, ratio in (("G", 0.8, 2.9, 1.0), ("IR", 2.3, 2.9, 0.46)):
            missing = 1 - kernels[level, CHANNELS.index(channel)].sum()
            nearest, farthest = 32.5 - ratio * blur / 2, 32.5 * np.sqrt(2) + ratio * blur / 2
            assert 2 / np.pi**2 * low / farthest < missing + ENERGY, (channel, blur)
            assert missing - ENERGY < 2 / np.pi**2 * high / nearest, (channel, blur)


def test_kernel_in_focus_is_wider_in_the_near_infrared(wave_kernels):
    """Expectation: half maxima of 1.029 lambda N before the pixel: 0.9 px in green; in infrared 2.7 px for 730 nm
    through the hole, less for the whole band, whose share near 650 nm comes through the open lens in a peak 4.7 times
    narrower in area. At 20 px of blur green is the wider one. This order decides which channel is sharp where.
    """
    profiles, radius, kernels, _ = wave_kernels
    widths = [2 * np.interp(-0.5, -p / p[0], radius) for p in profiles[0]]
    assert widths[CHANNELS.index("G")] == pytest.approx(0.9, abs=0.1)
    assert widths[CHANNELS.index("IR")] == pytest.approx(2.5, abs=0.2)
    green, infrared = (moments(kernels[2, CHANNELS.index(name), 20:45, 20:45])[1][0] for name in ("G", "IR"))
    assert green > 1.5 * infrared


def test_relative_electrons_are_those_of_the_camera(da_mobile, wave_kernels):
    """Expectation: the sum over bands of 10 nm equals an integral on a grid of 1 nm."""
    from dasim.camera import radiometry

    nm = np.arange(400, 831)
    light = np.interp(nm, spectra.WAVELENGTH_NM, illuminant("D65"))
    for channel, row in enumerate(radiometry.response(da_mobile)):
        fine = np.interp(nm, spectra.WAVELENGTH_NM, row) * light
        assert wave_kernels[3][channel] == pytest.approx(fine.sum(), rel=2e-3)


def test_offset_moves_the_kernel_down_and_right(hole_only):
    """The proof of the axes: offset_px is (y, x), y down. Expectation: the centroid follows, also past half a pixel."""
    profiles, radius = wave_profile(np.arange(0, 30, 0.05) / 2.0, np.array([0.8])) / 4, np.arange(0, 30, 0.05)
    for offset in ((0.3, 0.0), (0.0, 0.4), (-0.25, 0.6)):
        mean, _ = moments(pixel_kernels(profiles, radius, 41, offset)[0])
        np.testing.assert_allclose(mean, offset, atol=0.02)  # the frame cuts a little more of one side's tail
    kernel = psf(hole_only, 0.15, "IR", "D65", offset_px=(0.4, 0.0), size=15, diffraction="off")
    assert kernel[8:].sum() > 1.2 * kernel[:7].sum(), "down is a higher row"


def test_psf_is_the_kernel_of_its_depth(da_mobile):
    """Set-up: 15 cm, focus 40 cm: 11.43 px of visible blur (traced: A s |1/d - 1/d_f| / p).

    Expectation: the variance of each stop's own disc and the pixel, c^2 / 16 + 1 / 12, weighted with the channel's
    electrons through that stop (4 % of green's come through the hole, 3 % of infrared's through the open lens); the
    automatic frame is odd and holds all but the tail. Tolerance: one place alone has the moments of its own binning,
    0.05 px^2.
    """
    blur = 3.6e-3 / 2.8 * (3.6e-3 * 0.4 / 0.3964) * (1 / 0.15 - 1 / 0.4) / 1.7e-6
    light = illuminant("D65")
    electrons = np.stack([spectra.integrate(radiometry.stop_response(da_mobile, s) * light) for s in da_mobile.stops])
    for channel in ("G", "IR"):
        share = electrons[:, CHANNELS.index(channel)] / electrons[:, CHANNELS.index(channel)].sum()
        expected = share @ (np.array([1.0, 0.46]) * blur) ** 2 / 16 + 1 / 12
        kernel = psf(da_mobile, 0.15, channel, "D65", diffraction="off", size=31)
        np.testing.assert_allclose(moments(kernel)[1], expected, atol=0.05)
    whole = psf(da_mobile, 0.15, "IR", "D65")
    assert whole.shape[0] == whole.shape[1] and whole.shape[0] % 2 == 1
    assert whole.sum() > 0.95


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"channel": "W"}, "channel 'W' is unknown; allowed are R, G, B, IR"),
        ({"depth_m": 0.0}, "depth_m: must be a distance above 0, in metres, not the float 0.0"),
        ({"depth_m": float("nan")}, "depth_m: must be a distance above 0, in metres, not the float nan"),
        ({"illuminant": "F99"}, "illuminant 'F99' is unknown"),
        ({"diffraction": "fourier"}, "diffraction 'fourier' is unknown; allowed are wave, airy, off"),
    ],
)
def test_mistakes_are_named(da_mobile, change, message):
    with pytest.raises(InputError, match=message):
        psf(da_mobile, **({"depth_m": 0.1, "channel": "G", "illuminant": "D65"} | change))


@pytest.mark.parametrize("inner", [0.3, 0.6, 0.9])
def test_ring_transfer_is_the_overlap_of_two_rings(inner):
    """Expectation: the area that two rings share, counted on a grid; none beyond the diffraction limit."""
    grid = np.linspace(-2, 2, 1001)
    y, x = np.meshgrid(grid, grid, indexing="ij")

    def ring(centre):
        return (np.hypot(x - centre, y) <= 1) & (np.hypot(x - centre, y) >= inner)

    for v in (0.0, 0.02, 0.3, 0.5, 0.8, 0.95, 1.1):
        overlap = np.count_nonzero(ring(-v) & ring(v)) / np.count_nonzero(ring(0))
        assert radial_pattern.ring_mtf(np.array([v]), inner)[0] == pytest.approx(overlap, abs=0.01), v


@pytest.mark.parametrize("inner", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("waves", [0.0, 0.7, 4.0])
def test_ring_profile_integrates_to_one(inner, waves):
    """Expectation: every edge of the pupil sends light to both sides along its normal, whose part beyond a distance
    from the edge's own geometric place falls as one over that distance (Keller, 1962). Places are at 4 W20 (outer edge)
    and 4 W20 e (inner edge) from the middle in units of lambda N, so that the share beyond r is
    2 / (pi^2 (1 - e^2)) (r / (r^2 - (4 W20)^2) + e r / (r^2 - (4 e W20)^2)): in focus 2 / (pi^2 r (1 - e)).

    Tolerance: light of the two edges interferes. In focus the share beyond r has the term
    -4 e / (1 - e^2) int J1(t) J1(e t) / t dt from pi r on, at most 2 sqrt(e) / ((1 - e^2) pi r) of the whole by the
    asymptotes of J1. To this comes the error of the trapezoids.
    """
    radius = np.arange(0, 100, STEP)
    energy = encircled(wave_profile(radius, np.array([waves]), inner)[0], radius)
    for edge in (50.0, 95.0):
        missing = 1 - np.interp(edge, radius, energy)
        tails = edge / (edge**2 - (4 * waves) ** 2) + inner * edge / (edge**2 - (4 * inner * waves) ** 2)
        expected = 2 / (np.pi**2 * (1 - inner**2)) * tails
        interference = 2 * np.sqrt(inner) / ((1 - inner**2) * np.pi * edge)
        assert missing == pytest.approx(expected, abs=interference * expected + QUADRATURE)


def many_stops(da_mobile, *stops: dict, **lens):
    data = da_mobile.model_dump()
    named = [{"name": f"stop {index}"} | stop for index, stop in enumerate(stops)]
    return parse(Camera, data | {"stops": named, "lens": data["lens"] | lens}, "camera")


COLOURED = (
    {"radius_ratio": 0.4, "centre_ratio": [0.6, 0.0], "passes_nm": [[590, 830]]},
    {"radius_ratio": 0.4, "centre_ratio": [-0.3, 0.5], "passes_nm": [[500, 590]]},
    {"radius_ratio": 0.4, "centre_ratio": [-0.3, -0.5], "passes_nm": [[400, 500]]},
)


@pytest.mark.parametrize("depth_m", [0.18, 1.5])
def test_three_coloured_discs_part_the_channels(da_mobile, depth_m):
    """Set-up: a lens of three displaced discs of one colour each (Bando et al., 2008). Expectation: by geometry
    the centroid of each channel is -c / 2 times the mean centre, weighted with its electrons through each disc;
    kernels of all three are the sum of those of each alone, weighted alike.
    """
    camera = many_stops(da_mobile, *COLOURED)
    light = illuminant("D65")
    electrons = np.stack([spectra.integrate(radiometry.stop_response(camera, stop) * light) for stop in camera.stops])
    centres = np.array([stop.centre_ratio for stop in camera.stops])
    blur = float(geometry.blur_px(camera, depth_m))
    alone = [many_stops(da_mobile, stop) for stop in COLOURED]
    for index, channel in enumerate(CHANNELS):
        share = electrons[:, index] / electrons[:, index].sum()
        mean, _ = moments(psf(camera, depth_m, channel, "D65", size=31, diffraction="off"))
        np.testing.assert_allclose(mean[::-1], -blur / 2 * (share @ centres), atol=0.02)
        parts = [psf(one, depth_m, channel, "D65", size=31) for one in alone]
        whole = psf(camera, depth_m, channel, "D65", size=31)
        np.testing.assert_allclose(whole, np.tensordot(share, parts, 1), atol=1e-6)


def test_axial_colour_in_geometric_kernels(da_mobile):
    """Set-up: a disc at (0.5, -0.3) passes one narrow band; the lens is 30 um longer there. Expectation: centroid
    and variance of the blur from 1/f(lambda) - 1/s, written out; a curve of zeros changes nothing.
    """
    stop = {"radius_ratio": 0.3, "centre_ratio": [0.5, -0.3], "passes_nm": [[550, 558]], "edge_width_nm": 1}
    camera = many_stops(da_mobile, stop, focal_shift_um=[[500, 30], [600, 30]])
    image_mm = 1 / (1 / 3.6 - 1 / 400)
    blur = 3.6 / 2.8 * image_mm * (1 / 120 - (1 / 3.63 - 1 / image_mm)) / 1.7e-3
    mean, variance = moments(psf(camera, 0.12, "G", "D65", size=47, diffraction="off"))
    np.testing.assert_allclose(mean[::-1], np.array([0.5, -0.3]) * -blur / 2, atol=0.02)
    np.testing.assert_allclose(variance, (0.3 * blur) ** 2 / 16 + 1 / 12, rtol=0.02)
    plain, zero = (many_stops(da_mobile, stop, focal_shift_um=curve) for curve in ((), [[400, 0], [830, 0]]))
    first, second = (psf(camera, 0.12, "G", "D65", size=47) for camera in (plain, zero))
    np.testing.assert_allclose(first, second, atol=1e-12)


LETTER_L = ((-0.6, -0.7), (-0.2, -0.7), (-0.2, 0.3), (0.5, 0.3), (0.5, 0.7), (-0.6, 0.7))


@pytest.mark.parametrize(
    "stop",
    [
        {"radius_ratio": 0.3, "centre_ratio": [0.7, 0.0]},
        {"shape": "annulus", "inner_ratio": 0.8, "outer_ratio": 1.0},
        {"shape": "polygon", "corners_ratio": LETTER_L},
        {"shape": "mask", "mask": [[0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]]},
    ],
)
@pytest.mark.parametrize("blur_px", [-6.0, 12.0])
def test_automatic_frame_holds_the_kernel(da_mobile, stop, blur_px):
    """Expectation: of light beyond three rings of a disc as broad as the stop, 2 / (3 pi^2) = 7 % at most."""
    camera = many_stops(da_mobile, stop)
    depth_m = float(geometry.depth_of_blur_m(camera, blur_px))
    for channel in ("G", "IR"):
        assert psf(camera, depth_m, channel, "D65").sum() > 0.92
