"""The camera as data: what is refused and how it is said, crops, the mosaic, the intrinsic matrix, sensitivity."""

from __future__ import annotations

import numpy as np
import pytest

from dasim import camera as cameras
from dasim import spectra
from dasim.errors import InputError

SOURCE = (cameras.CAMERA_DIR / "da-mobile.toml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("focal_length_mm = 3.6", "focal_length_mm = 0", ["lens.focal_length_mm"]),
        (
            "focal_length_mm = 3.6",
            "focal_length = 3.6",
            ["lens.focal_length: unknown", "lens.focal_length_mm: is missing"],
        ),
        ("focal_length_mm = 3.6", "focal_length_mm = nan", ["lens.focal_length_mm"]),
        ("focal_length_mm = 3.6", "focal_length_mm = '3.6 mm'", ["lens.focal_length_mm", "3.6 mm"]),
        ("f_number = 2.8", "f_number = -2.8", ["lens.f_number", "-2.8"]),
        ("focus_distance_m = 0.4", "focus_distance_m = 0.0036", ["lens", "focus_distance_m", "focal length"]),
        ("focus_distance_m = 0.4", "focus_distance_m = inf", ["lens.focus_distance_m"]),
        ("radius_ratio = 0.46", "radius_ratio = 1.46", ["stops.1.radius_ratio"]),
        (
            "radius_ratio = 0.46",
            "radius_ratio = 0.46\ncentre_ratio = [0.5, 0.3]",
            ["stops.1", "outside the lens", "1.043"],
        ),
        ("[[650, 830]]", "[[650, 840]]", ["stops.1.passes_nm", "400 to 830"]),
        ("edge_width_nm = 8", "edge_width_nm = 0", ["stops.0.edge_width_nm"]),
        ("width_px = 2048", "width_px = 2047", ["sensor", "2047 x 1536", "2 x 2 mosaic"]),
        ("width_px = 2048", "width_px = 2", ["sensor.width_px"]),
        ("pixel_pitch_um = 1.7", "pixel_pitch_um = 0", ["sensor.pixel_pitch_um"]),
        ('["G", "R"]', '["G", "X"]', ["sensor", "mosaic channel 'X'", "R, G, B, IR"]),
        ('["G", "R"]', '["G"]', ["sensor", "mosaic", "equal length"]),
        ("full_well_e = 6000", "full_well_e = 0", ["sensor.full_well_e"]),
        ("read_noise_e = 3.0", "read_noise_e = -1", ["sensor.read_noise_e"]),
        ("prnu = 0.01", "prnu = 1", ["sensor.prnu"]),
        ("adc_bits = 10", "adc_bits = 20", ["sensor.adc_bits"]),
        ("black_level_dn = 64", "black_level_dn = 1023", ["sensor", "black_level_dn", "1023"]),
        ('name = "da-mobile"', "", ["name: is missing"]),
        ("[lens]", "[lens", ["not valid TOML"]),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path, old, new, said):
    """Expectation: InputError with the file and the key, and the value or what is allowed."""
    assert old in SOURCE
    path = tmp_path / "mine.toml"
    path.write_text(SOURCE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        cameras.load_camera(path)
    message = str(caught.value)
    assert "\n" not in message
    for part in ("mine.toml", *said):
        assert part in message, message


def test_all_mistakes_are_named_at_once(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SOURCE.replace("f_number = 2.8", "f_number = 0").replace("prnu = 0.01", "prnu = -1"))
    with pytest.raises(InputError, match=r"lens\.f_number.*sensor\.prnu"):
        cameras.load_camera(path)


def test_names_and_files(tmp_path):
    assert "da-mobile" in cameras.camera_names()
    with pytest.raises(InputError, match=r"camera 'nokia' is neither a bundled name .*da-mobile.* nor a file"):
        cameras.load_camera("nokia")
    (tmp_path / "mine.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"mine\.toml: cannot be read"):
        cameras.load_camera(tmp_path / "mine.toml")


def test_focus_stays_beyond_the_focal_length(da_mobile):
    assert cameras.refocused(da_mobile, 0.12).lens.focus_distance_m == 0.12
    for bad in (0.0036, 0.001, 0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"focus: .*focus_distance_m"):
            cameras.refocused(da_mobile, bad)


def test_crop_keeps_pitch_and_mosaic(da_mobile):
    small = cameras.cropped(da_mobile, 64, 48)
    assert (small.sensor.width_px, small.sensor.height_px, small.sensor.pixel_pitch_um) == (64, 48, 1.7)
    for size in ((65, 48), (64, 47), (2050, 48), (64, 1538), (0, 48), (64, -2), (4, 4)):
        with pytest.raises(InputError, match=f"size {size[0]}x{size[1]}"):
            cameras.cropped(da_mobile, *size)


def test_mosaic_starts_at_the_top_left(da_mobile):
    """Expectation: the preset's block, rows from above: G R over B IR, then again."""
    channels = cameras.mosaic_channels(cameras.cropped(da_mobile, 12, 8))
    letters = np.array(spectra.CHANNELS)[channels]
    assert letters.shape == (8, 12)
    assert letters[0, :4].tolist() == ["G", "R", "G", "R"]
    assert letters[1, :4].tolist() == ["B", "IR", "B", "IR"]
    assert letters[:4, 0].tolist() == ["G", "B", "G", "B"]
    assert all(np.count_nonzero(letters == name) == 24 for name in spectra.CHANNELS)


def test_intrinsic_matrix_is_similar_triangles(da_mobile):
    """Set-up: a ray through the lens centre to a point 2 mm right and 1 mm below the axis, 10 cm away, focus 40 cm.

    Expectation: it meets the sensor s / d as far from the axis, s = 3.6 * 400 / 396.4 mm; crops keep the rays.
    """
    for width, height in ((2048, 1536), (64, 48)):
        matrix = cameras.intrinsic_matrix(cameras.cropped(da_mobile, width, height))
        x, y, one = matrix @ np.array([0.002, 0.001, 0.1]) / 0.1
        image_mm = 3.6 * 400 / 396.4
        assert one == 1
        assert (x - width / 2) * 1.7e-3 == pytest.approx(2 * image_mm / 100, rel=1e-12)
        assert (y - height / 2) * 1.7e-3 == pytest.approx(1 * image_mm / 100, rel=1e-12)


def test_sensitivity_follows_area_distance_and_pixel(da_mobile):
    """Expectation: electrons go with the stop's area, the pixel's area and the lens's transmittance, and fall with the
    square of the image distance; nothing beyond the sensor's filter is seen.
    """
    hole = da_mobile.stops[1]
    whole = hole.model_copy(update={"radius_ratio": 1.0})
    ours, open_ = cameras.stop_response(da_mobile, hole), cameras.stop_response(da_mobile, whole)
    np.testing.assert_allclose(ours, open_ * 0.46**2, rtol=1e-12)
    sensor = da_mobile.sensor.model_copy(update={"pixel_pitch_um": 3.4})
    np.testing.assert_allclose(
        cameras.stop_response(da_mobile.model_copy(update={"sensor": sensor}), hole), 4 * ours, rtol=1e-12
    )
    near = cameras.refocused(da_mobile, 0.0072)  # unit magnification: s = 2 f
    far = cameras.refocused(da_mobile, 1e6)  # s = f
    np.testing.assert_allclose(4 * cameras.stop_response(near, hole), cameras.stop_response(far, hole), rtol=1e-5)
    above = spectra.WAVELENGTH_NM > 826  # four widths beyond 810 nm
    assert cameras.response(da_mobile)[:, above].max() < 1e-3 * cameras.response(da_mobile).max()


def test_hole_passes_near_infrared_alone(da_mobile):
    """Expectation: the infrared pixel gets most of its light through the hole, green most through the open lens."""
    flat = [spectra.integrate(cameras.stop_response(da_mobile, stop)) for stop in da_mobile.stops]
    through_hole = flat[1] / (flat[0] + flat[1])
    assert through_hole[3] > 0.9 and through_hole[1] < 0.1 and through_hole[2] < 0.1
