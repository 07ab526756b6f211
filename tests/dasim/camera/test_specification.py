"""Camera files: wrong input and its messages, crops, the mosaic, the intrinsic matrix, sensitivity."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import geometry, radiometry, response_curves
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import grid

SOURCE = (cameras.CAMERA_DIR / "da-mobile.toml").read_text()


def refusal(folder, text: str) -> str:
    """What is said of a camera file that must be refused: one line."""
    path = folder / "mine.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        cameras.load_camera(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{path}: ")
    return message


@pytest.mark.parametrize(
    ("old", "new", "message_part"),
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
        ("radius_ratio = 0.46", "radius_ratio = 1.46", ["stops.hole.radius_ratio"]),
        ("[[650, 830]]", "[[650, 840]]", ["stops.hole.passes_nm", "400 to 830"]),
        ("[[650, 830]]", "[[650, 700], [690, 830]]", ["stops.hole.passes_nm", "without overlap"]),
        ('name = "hole"', 'name = "open"', ["stops: names must be unique", "open, open"]),
        ("cutoff_nm = 810", "cutoff_nm = 840", ["sensor.cutoff_nm", "840"]),
        ("focus_distance_m = 0.4", "focus_distance_m = 0.4\nfocal_shift_um = [[900, 1]]", ["lens.focal_shift_um"]),
        ("edge_width_nm = 8", "edge_width_nm = 0", ["stops.open.edge_width_nm"]),
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
def test_problems_are_named_in_one_line(tmp_path, old, new, message_part):
    """Expectation: InputError with the file and the key, and the value or what is allowed."""
    assert old in SOURCE
    message = refusal(tmp_path, SOURCE.replace(old, new, 1))
    for part in ("mine.toml", *message_part):
        assert part in message, message


@pytest.mark.parametrize(
    ("stop", "message_part"),
    [
        ("radius_ratio = 0.46\ncentre_ratio = [0.5, 0.3]", "stops.hole: the stop reaches outside the lens, to 1.043"),
        (
            'shape = "annulus"\ninner_ratio = 0.2\nouter_ratio = 0.5\ncentre_ratio = [0.6, 0]',
            "stops.hole: the stop reaches outside the lens, to 1.1",
        ),
        ('shape = "annulus"\ninner_ratio = 0.6\nouter_ratio = 0.5', "stops.hole: inner_ratio must be below outer"),
        (
            'shape = "polygon"\ncorners_ratio = [[0, 0], [0.9, 0.9], [0, 0.5]]',
            "stops.hole.corners_ratio: the stop reaches outside the lens, to 1.273",
        ),
        (
            'shape = "polygon"\ncorners_ratio = [[0, 0], [0.5, 0.5], [0.6, 0], [0, 0.5]]',
            "stops.hole.corners_ratio: is not a simple polygon: its sides cross",
        ),
        (
            'shape = "polygon"\ncorners_ratio = [[0, -0.9], [0.5, 0.7], [-0.8, -0.3], [0.8, -0.3], [-0.5, 0.7]]',
            "stops.hole.corners_ratio: is not a simple polygon: its sides cross",
        ),
        ('shape = "polygon"\ncorners_ratio = [[0, 0], [0.5, 0.5], [0.2, 0.2]]', "stops.hole.corners_ratio: is no"),
        (
            'shape = "mask"\nmask = [[1, 0, 0, 0], [0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0]]',
            "stops.hole.mask: is open outside the lens",
        ),
        ('shape = "mask"\nmask = [[0, 0], [0, 0]]', "stops.hole.mask: is closed everywhere"),
        ('shape = "mask"\nmask = [[0, 2], [0, 0]]', "stops.hole.mask.0.1: must be less than or equal to 1"),
        ('shape = "mask"\nfile = "none.png"', "none.png: no such file"),
        ('shape = "mask"\nfile = "mine.toml"', "mine.toml: cannot be read as a picture"),
        ('shape = "star"', "stops.hole: "),
    ],
)
def test_impossible_stops_are_refused(tmp_path, stop, message_part):
    """Expectation: one line with the stop's key as the file has it, for each shape."""
    message = refusal(tmp_path, SOURCE.replace("radius_ratio = 0.46", stop))
    assert message_part in message and "stops.hole" in message, message


NM = tuple(range(400, 831, 10))
FLAT = (0.3,) * len(NM)


def inline(nm=NM, **channels) -> str:
    curves = ", ".join(f'"{name}" = {list(values)}' for name, values in channels.items())
    return f"wavelength_nm = {list(nm)}, channels = {{{curves}}}"


@pytest.mark.parametrize(
    ("curves", "message_part"),
    [
        (inline(R=(-0.1, *FLAT[1:]), G=FLAT, B=FLAT, IR=FLAT), "channels.R.0: must be greater than or equal to 0"),
        (inline(R=FLAT, G=(1.1, *FLAT[1:]), B=FLAT, IR=FLAT), "channels.G.0: must be less than or equal to 1"),
        (inline(R=FLAT[1:], G=FLAT, B=FLAT, IR=FLAT), "channels.R must have as many values as wavelength_nm"),
        (
            inline(NM[:11] + NM[15:], **dict.fromkeys(("R", "G", "B", "IR"), FLAT[4:])),
            "wavelength_nm has a gap from 500 to 550 nm",
        ),
        (inline((*NM, 840), **dict.fromkeys(("R", "G", "B", "IR"), (*FLAT, 0.3))), "must lie within 400 to 830 nm"),
        (
            inline(NM[:-4], **dict.fromkeys(("R", "G", "B", "IR"), FLAT[4:])),
            "wavelength_nm must reach from 400 to 826 nm",
        ),
        (inline(NM[::-1], **dict.fromkeys(("R", "G", "B", "IR"), FLAT)), "wavelength_nm must rise"),
        (
            inline(R=FLAT, G=FLAT, B=FLAT),
            "mosaic channel 'IR' has no curve in quantum_efficiency, which has R, G, B; add one",
        ),
        (inline(**dict.fromkeys(("R", "G", "B", "IR", "a,b"), FLAT)), "channels.a,b: names must be"),
        ('file = "none.csv"', "none.csv: no such file"),
        ('file = "c.csv", ' + inline(R=FLAT), "file and curves both give the response"),
    ],
)
def test_impossible_curves_are_refused(tmp_path, curves, message_part):
    text = SOURCE.replace("[sensor]", f"[sensor]\nquantum_efficiency = {{{curves}}}")
    message = refusal(tmp_path, text)
    assert ": sensor" in message and message_part in message, message


@pytest.mark.parametrize(
    ("table", "message_part"),
    [
        ("", "the first line must be 'wavelength_nm' and one name per channel"),
        ("nm,R,G,B,IR\n400,0,0,0,0\n", "the first line must be 'wavelength_nm' and one name per channel"),
        ("wavelength_nm,R,G,R,IR\n400,0,0,0,0\n", "the first line must be 'wavelength_nm' and one name per channel"),
        ("wavelength_nm,R,G,B,IR\n400,0.1,0.1,0.1,0.1\n410,0.1,,0.1,0.1\n", "line 3 of the table: must have 5 numbers"),
        ("wavelength_nm,R,G,B,IR\n400,0.1,0.1,0.1\n", "line 2 of the table: must have 5 numbers"),
        ("wavelength_nm,R,G,B,IR\n400,0.1,0.1,x,0.1\n", "line 2 of the table: 'x' is not a number"),
        ("wavelength_nm,R,G,B,IR\n400,0.1,0.1,nan,0.1\n", "line 2 of the table: 'nan' is not a number"),
        ("wavelength_nm,R,G,B,IR\n", "must have two or more lines of numbers"),
        (b"\xff\xfe\x00", "cannot be read, is not UTF-8"),
    ],
)
def test_broken_tables_of_curves_are_refused(tmp_path, table, message_part):
    """Expectation: one line with the key, the file and what is wrong in it."""
    (tmp_path / "c.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    message = refusal(tmp_path, SOURCE.replace("[sensor]", '[sensor]\nquantum_efficiency = { file = "c.csv" }'))
    assert "sensor.quantum_efficiency: file " in message and "c.csv" in message and message_part in message, message


@pytest.mark.slow
@pytest.mark.parametrize("mosaic", [[["R", "G", "W"], ["B", "IR", "G"]], [["W", "G"] * 4, ["R", "IR"] * 4] * 4])
def test_curves_of_ones_own_travel_to_the_truth(renderer, tmp_path, mosaic):
    """Set-up: a 3x2 and an 8x8 mosaic with a clear channel W, of our own curves in a CSV file with a comment.

    Expectation: the curves come back exactly, channels in the order R, G, B, IR, then others; a picture renders,
    in which W has more electrons than any colour, and capture and truth come back from their folder.
    """
    names = ("W", "IR", "G", "R", "B")
    ours = dict(zip(grid.CHANNELS, response_curves.rgb_ir_quantum_efficiency(), strict=True))
    ours["W"] = np.maximum.reduce(list(ours.values()))
    rows = [",".join((f"{nm:g}", *(f"{ours[n][k]:.9f}" for n in names))) for k, nm in enumerate(grid.WAVELENGTH_NM)]
    (tmp_path / "c.csv").write_text("\n".join(["# source: made up", "wavelength_nm," + ",".join(names), *rows]) + "\n")
    text = SOURCE.replace("[sensor]", '[sensor]\nquantum_efficiency = { file = "c.csv" }')
    text = text.replace('[["G", "R"], ["B", "IR"]]', str(mosaic)).replace("width_px = 2048", "width_px = 24")
    (tmp_path / "mine.toml").write_text(text.replace("height_px = 1536", "height_px = 16"))
    camera = cameras.load_camera(tmp_path / "mine.toml")
    used = tuple(name for name in ("R", "G", "B", "IR", "W") if any(name in row for row in mosaic))
    assert sensors.channels(camera.sensor) == used
    np.testing.assert_allclose(
        sensors.quantum_efficiency(camera.sensor), np.stack([ours[name] for name in used]), atol=1e-9
    )
    letters = np.array(used)[cameras.mosaic_channels(camera)]
    assert letters[: len(mosaic), : len(mosaic[0])].tolist() == mosaic
    assert (letters[len(mosaic) :, len(mosaic[0]) :] == letters[: -len(mosaic), : -len(mosaic[0])]).all()

    scene = dasim.load_scene("desk")
    shot = dasim.simulate(scene, dasim.focused(camera, scene), seed=1, spp=16, diffraction="off")
    dasim.save_capture(tmp_path / "shot", shot.capture, shot.truth)
    assert dasim.load_capture(tmp_path / "shot").camera.sensor == camera.sensor
    truth = dasim.load_truth(tmp_path / "shot")
    assert truth.channels == used
    np.testing.assert_array_equal(truth.mean_e, shot.truth.mean_e)
    assert truth.mean_e.mean(axis=(0, 1)).argmax() == used.index("W")


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


def test_a_central_part_keeps_the_colours_of_the_sensor(da_mobile):
    """Set-up: a size whose centre would lie one pixel off the mosaic's cells. Expectation: each pixel of the part has
    the colour, and the distance from the axis, that it has on the sensor.
    """
    part = cameras.cropped(da_mobile, 66, 50)
    assert part == cameras.cropped(da_mobile, 66, 50, at_px=(990, 742))
    assert part.sensor.principal_point_px == (34, 26)
    whole = cameras.mosaic_channels(da_mobile)
    np.testing.assert_array_equal(cameras.mosaic_channels(part), whole[742:792, 990:1056])


def test_windows_keep_the_optical_axis(da_mobile):
    """Expectation: the intrinsic matrix of a window is that of the frame, moved by its corner, also for a window of a
    window and the central part of one; illumination and shading are that part of the frame's.
    """
    lens = da_mobile.lens.model_copy(update={"shading_per_mm": (-0.05,)})
    whole = da_mobile.model_copy(update={"lens": lens})
    corner = cameras.cropped(whole, 64, 48, at_px=(1984, 1400))
    assert corner.sensor.principal_point_px == (1024 - 1984, 768 - 1400)
    moved = np.array([[1, 0, -1984], [0, 1, -1400], [0, 0, 1]])
    np.testing.assert_array_equal(geometry.intrinsic_matrix(corner), moved @ geometry.intrinsic_matrix(whole))
    part = radiometry.relative_illumination(whole)[1400:1448, 1984:]
    np.testing.assert_array_equal(radiometry.relative_illumination(corner), part)
    assert part.max() < 0.7
    middle, again = cameras.cropped(corner, 32, 24), cameras.cropped(corner, 32, 24, at_px=(16, 12))
    assert middle.sensor.principal_point_px == again.sensor.principal_point_px == (-976, -644)
    assert cameras.cropped(whole, 64, 48).sensor.principal_point_px is None, "in the middle as before"
    same = cameras.cropped(whole, 64, 48, at_px=(992, 744))
    assert sensors.principal_point(same.sensor) == (32, 24)


@pytest.mark.parametrize("at_px", [(1, 0), (0, 3), (-2, 0), (1986, 0), (0, 1490), (0.5, 0)])
def test_windows_lie_within_the_sensor_and_on_the_mosaic(da_mobile, at_px):
    with pytest.raises(InputError, match="at_px"):
        cameras.cropped(da_mobile, 64, 48, at_px=at_px)


def test_mosaic_starts_at_the_top_left(da_mobile):
    """Expectation: the preset's block, rows from above: G R over B IR, then again."""
    channels = cameras.mosaic_channels(cameras.cropped(da_mobile, 12, 8))
    letters = np.array(grid.CHANNELS)[channels]
    assert letters.shape == (8, 12)
    assert letters[0, :4].tolist() == ["G", "R", "G", "R"]
    assert letters[1, :4].tolist() == ["B", "IR", "B", "IR"]
    assert letters[:4, 0].tolist() == ["G", "B", "G", "B"]
    assert all(np.count_nonzero(letters == name) == 24 for name in grid.CHANNELS)


def test_intrinsic_matrix_is_similar_triangles(da_mobile):
    """Set-up: a ray through the lens centre to a point 2 mm right and 1 mm below the axis, 10 cm away, focus 40 cm.

    Expectation: it meets the sensor s / d as far from the axis, s = 3.6 * 400 / 396.4 mm; crops keep the rays.
    """
    for width, height in ((2048, 1536), (64, 48)):
        matrix = geometry.intrinsic_matrix(cameras.cropped(da_mobile, width, height))
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
    ours, open_ = radiometry.stop_response(da_mobile, hole), radiometry.stop_response(da_mobile, whole)
    np.testing.assert_allclose(ours, open_ * 0.46**2, rtol=1e-12)
    sensor = da_mobile.sensor.model_copy(update={"pixel_pitch_um": 3.4})
    np.testing.assert_allclose(
        radiometry.stop_response(da_mobile.model_copy(update={"sensor": sensor}), hole), 4 * ours, rtol=1e-12
    )
    near = cameras.refocused(da_mobile, 0.0072)  # unit magnification: s = 2 f
    far = cameras.refocused(da_mobile, 1e6)  # s = f
    np.testing.assert_allclose(4 * radiometry.stop_response(near, hole), radiometry.stop_response(far, hole), rtol=1e-5)
    above = grid.WAVELENGTH_NM > 826  # four widths beyond 810 nm
    assert radiometry.response(da_mobile)[:, above].max() < 1e-3 * radiometry.response(da_mobile).max()


def test_hole_passes_near_infrared_alone(da_mobile):
    """Expectation: the infrared pixel gets most of its light through the hole, green most through the open lens."""
    flat = [grid.integrate(radiometry.stop_response(da_mobile, stop)) for stop in da_mobile.stops]
    through_hole = flat[1] / (flat[0] + flat[1])
    assert through_hole[3] > 0.9 and through_hole[1] < 0.1 and through_hole[2] < 0.1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cameras.Levels(count=1, max_blur_px=-2), ("Levels: count", "max_blur_px")),
        (lambda: dasim.Camera(name="mine"), ("Camera: lens: is missing", "sensor: is missing")),  # type: ignore[call-arg]
        (lambda: dasim.Exposure(time_s=-1), ("Exposure: time_s", "(is -1)")),
        (lambda: dasim.Exposure(times=1), ("times: unknown key; did you mean 'time_s'?",)),  # type: ignore[call-arg]
        (lambda: setattr(dasim.Exposure(), "gain", 2), ("Exposure.gain cannot be changed",)),
    ],
)
def test_mistakes_in_python_are_those_of_files(call, message):
    """Rationale: who builds a camera in Python needs the same line as who writes a file."""
    with pytest.raises(InputError) as raised:
        call()
    text = str(raised.value)
    assert "\n" not in text and all(part in text for part in message), text


def test_many_problems_are_cut():
    mosaic = [["G", 1]] * 100
    with pytest.raises(InputError, match=r"mosaic\.0\.1: must be a valid string .*; and 80 more"):
        sensors.Sensor(width_px=8, height_px=8, pixel_pitch_um=1.0, mosaic=mosaic)  # type: ignore[arg-type]


def test_with_values_changes_its_keys_alone(da_mobile):
    """Expectation: entries of lists by name and by index, the camera itself unchanged."""
    by_name = dasim.with_values(da_mobile, {"stops.hole.radius_ratio": 0.65, "lens.f_number": 2.0})
    assert by_name == dasim.with_values("da-mobile", {"stops.1.radius_ratio": 0.65, "lens.f_number": 2.0})
    assert (by_name.stops[1].radius_ratio, by_name.lens.f_number, da_mobile.stops[1].radius_ratio) == (0.65, 2.0, 0.46)
    back = dasim.with_values(by_name, {"stops.hole.radius_ratio": 0.46, "lens.f_number": da_mobile.lens.f_number})
    assert back == da_mobile
