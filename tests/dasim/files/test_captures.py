"""Capture folders: what is written is read again, and truncated or foreign files are refused."""

from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import specification as cameras
from dasim.files import captures, folders, png
from dasim.files.truth import read_truth_parts, write_truth
from dasim.values import Capture, Truth

H, W = 12, 16


@pytest.fixture
def capture(da_mobile):
    rng = np.random.default_rng(7)
    return Capture(
        raw_dn=rng.integers(0, 1024, (H, W)).astype(np.uint16),
        camera=cameras.cropped(da_mobile, W, H),
        exposure_s=1 / 3,
        gain=2.0,
        seed=5,
        illuminant="D55",
        provenance={"spp": 64, "scene": {"name": "Tisch"}},
    )


@pytest.fixture
def truth():
    rng = np.random.default_rng(8)
    depth = rng.uniform(0.05, 2, (H, W)).astype(np.float32)
    depth[0, 0] = np.nan
    return Truth(
        depth_m=depth,
        valid=~np.isnan(depth),
        normal=rng.normal(size=(H, W, 3)).astype(np.float32),
        object_id=rng.integers(0, 70_000, (H, W)).astype(np.uint32),
        material_id=rng.integers(0, 300, (H, W)).astype(np.uint32),
        blur_px=rng.normal(size=(H, W)).astype(np.float32),
        level=rng.normal(size=(H, W)).astype(np.float32),
        boundary=rng.random((H, W)) > 0.5,
        channels=("R", "G", "B", "IR"),
        mean_e=rng.uniform(0, 6000, (H, W, 4)).astype(np.float32),
        sharp_e=rng.uniform(0, 6000, (H, W, 4)).astype(np.float32),
        sharp_srgb=rng.uniform(0, 1, (H, W, 3)).astype(np.float32),
        objects=("wall, far", "cup"),
        materials=("white-paper",),
        mean_e_variance=rng.uniform(0, 60, (H, W, 4)).astype(np.float32),
        focus_e=rng.uniform(0, 6000, (H, W, 4)).astype(np.float32),
    )


@pytest.fixture
def folder(tmp_path, capture, truth):
    captures.save_capture(tmp_path / "shot", capture, truth)
    return tmp_path / "shot"


def test_capture_and_truth_come_back_as_they_were(folder, capture, truth):
    """Expectation: every field exactly, types and NaN included."""
    back = captures.load_capture(folder)
    for field in dataclasses.fields(Capture):
        if field.name != "raw_dn":
            assert getattr(back, field.name) == getattr(capture, field.name), field.name
    np.testing.assert_array_equal(back.raw_dn, capture.raw_dn)
    assert back.raw_dn.dtype == np.uint16
    truth_back = captures.load_truth(folder)
    for field in dataclasses.fields(Truth):
        ours, theirs = np.array(getattr(truth, field.name)), np.array(getattr(truth_back, field.name))
        assert ours.dtype == theirs.dtype, field.name
        np.testing.assert_array_equal(ours, theirs, err_msg=field.name)
    assert sorted(path.name for path in folder.iterdir()) == ["meta.json", "raw.png", "truth.exr"]
    assert [path.name for path in folder.parent.iterdir()] == ["shot"], "no temporary folder is left"


def test_meta_states_what_a_reader_needs(folder, capture):
    """Expectation: schema, K (the principal point in the centre), a table of 29 levels, versions; other tools read the
    raw picture as 16 bits and the depth as Z.
    """
    meta = json.loads((folder / "meta.json").read_text())
    assert meta["schema"] == 4
    assert [row[2] for row in meta["intrinsic_matrix_px"]] == [W / 2, H / 2, 1]
    assert [row["level"] for row in meta["levels"]] == list(range(29))
    assert meta["levels"][0]["depth_m"] == pytest.approx(capture.camera.lens.focus_distance_m)
    assert {"dasim", "mitsuba", "drjit", "numpy"} <= meta["software"].keys()
    assert cv2.imread(str(folder / "raw.png"), cv2.IMREAD_UNCHANGED).dtype == np.uint16
    import OpenEXR

    with OpenEXR.File(str(folder / "truth.exr"), separate_channels=True) as file:
        assert file.parts[0].name() == "depth"
        assert list(file.parts[0].channels) == ["Z"]


def test_captures_of_the_schema_before_are_read(folder, tmp_path, capture, truth):
    """Set-up: no variance of ``mean_e``, no picture in focus. Expectation: all else is read, these two are None."""
    before = dataclasses.replace(truth, mean_e_variance=None, focus_e=None)
    captures.save_capture(tmp_path / "before", capture, before)
    file = tmp_path / "before" / "meta.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"schema": 3}))
    np.testing.assert_array_equal(captures.load_capture(tmp_path / "before").raw_dn, capture.raw_dn)
    back = captures.load_truth(tmp_path / "before")
    assert back.mean_e_variance is None and back.focus_e is None
    np.testing.assert_array_equal(back.mean_e, truth.mean_e)


@pytest.fixture
def depths_only(tmp_path, folder, truth):
    """The folder of the capture with a truth of depth alone, as a dataset with ``truth.keep = ["depth"]`` writes it."""
    write_truth(folder / "truth.exr", truth, ["depth"])
    meta = json.loads((folder / "meta.json").read_text())
    meta["file_bytes"]["truth.exr"] = (folder / "truth.exr").stat().st_size
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder


def test_blur_and_labels_follow_from_depth(depths_only, capture, truth):
    """Expectation: blur of the thin lens A s |1/d - 1/d_f| / p, which is not the noise in the whole truth's fields;
    levels are (1 - alpha) of it, and pixels without a depth see nothing.
    """
    back, lens = captures.load_truth(depths_only), capture.camera.lens
    aperture_m, focus_m = lens.focal_length_mm * 1e-3 / lens.f_number, lens.focus_distance_m
    image_m = 1 / (1 / (lens.focal_length_mm * 1e-3) - 1 / focus_m)
    blur_m = aperture_m * image_m * (1 / truth.depth_m.astype(np.float64) - 1 / focus_m)
    seen = np.isfinite(truth.depth_m)
    expected = (blur_m / (capture.camera.sensor.pixel_pitch_um * 1e-6))[seen]
    np.testing.assert_allclose(back.blur_px[seen], expected, rtol=1e-4, atol=1e-4)
    hole, whole = (next(s.radius_ratio for s in capture.camera.stops if s.name == name) for name in ("hole", "open"))
    np.testing.assert_allclose(back.level[seen], (1 - hole / whole) * expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(back.valid, seen)
    assert back.boundary.all(), "neighbours of random depths all differ"


def test_what_a_truth_lacks_is_named_where_it_is_needed(depths_only):
    back = captures.load_truth(depths_only)
    assert back.has("depth_m", "level") and not back.has("sharp_e") and back.focus_e is None
    with pytest.raises(
        InputError, match=r'truth\.exr: lacks sharp_e, needed here; .*truth\.keep = \[\.\.\., "sharp_e"\]'
    ):
        _ = back.sharp_e
    with pytest.raises(InputError, match=r"lacks normal, sharp_srgb, needed"):
        back.require("depth_m", "normal", "sharp_srgb")
    with pytest.raises(AttributeError):
        _ = back.no_such_field
    assert "channels R G B IR" in repr(back)


def test_a_truth_without_parts_is_copied_scaled_and_written(depths_only, tmp_path, truth):
    back = pickle.loads(pickle.dumps(captures.load_truth(depths_only)))
    assert not back.scaled(2.0).has("mean_e")
    np.testing.assert_array_equal(truth.scaled(2.0).mean_e, 2 * truth.mean_e)
    write_truth(tmp_path / "again.exr", back)
    again = read_truth_parts(tmp_path / "again.exr")
    np.testing.assert_array_equal(again["depth_m"], truth.depth_m)
    np.testing.assert_array_equal(again["level"], back.level)
    assert "normal" not in again and "mean_e" not in again
    with pytest.raises(InputError, match="lacks sharp_e"):
        write_truth(tmp_path / "none.exr", back, ["sharp_e"])


@pytest.mark.parametrize("length", [0.0, 0.3, 0.9, 0.999])
@pytest.mark.parametrize("name", ["raw.png", "truth.exr", "meta.json"])
def test_cut_files_are_refused(folder, name, length):
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: min(int(len(data) * length), len(data) - 3)])
    load = captures.load_truth if name == "truth.exr" else captures.load_capture
    with pytest.raises(InputError, match=name):
        load(folder)


@pytest.mark.parametrize("name", ["raw.png", "truth.exr", "meta.json"])
def test_missing_files_are_named(folder, name):
    (folder / name).unlink()
    load = captures.load_truth if name == "truth.exr" else captures.load_capture
    with pytest.raises(InputError, match=rf"{name}: is missing"):
        load(folder)
    with pytest.raises(InputError, match="no such folder"):
        captures.load_capture(folder / "nothing")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda meta: meta.pop("schema"), "schema 3 or 4"),
        (lambda meta: meta.update(schema=99), "schema 3 or 4"),
        (lambda meta: meta.pop("gain"), "gain"),
        (lambda meta: meta.update(exposure_s=[1]), "meta.json"),
        (lambda meta: meta.update(exposure_s="long"), "meta.json"),
        (lambda meta: meta.update(provenance=3), "meta.json"),
        (lambda meta: meta["camera"]["lens"].pop("f_number"), "camera.lens.f_number: is missing"),
        (lambda meta: meta["camera"]["sensor"].update(width_px=32), "16 x 12 pixels, meta.json says 32 x 12"),
    ],
)
def test_wrong_meta_is_refused(folder, change, message):
    meta = json.loads((folder / "meta.json").read_text())
    change(meta)
    (folder / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(InputError, match=message):
        captures.load_capture(folder)


def test_other_pictures_are_no_raw_pictures(folder):
    assert cv2.imwrite(str(folder / "raw.png"), np.zeros((H, W), np.uint8))
    with pytest.raises(InputError, match=r"raw\.png: has \d+ bytes instead of \d+"):
        captures.load_capture(folder)
    with pytest.raises(InputError, match="not a 16-bit grey PNG"):
        png.read_png16(folder / "raw.png")
    (folder / "truth.exr").write_bytes((folder / "raw.png").read_bytes())
    with pytest.raises(InputError, match=r"truth\.exr"):
        captures.load_truth(folder)


def test_own_results_are_replaced_and_foreign_files_kept(tmp_path, capture):
    """Expectation: an earlier capture is replaced as a whole; a folder with anything else, and a file, are refused."""
    captures.save_capture(tmp_path / "a" / "shot", capture, None)
    before = (tmp_path / "a" / "shot").stat().st_ino
    captures.save_capture(tmp_path / "a" / "shot", capture, None)
    assert (tmp_path / "a" / "shot").stat().st_ino != before
    assert sorted(path.name for path in (tmp_path / "a" / "shot").iterdir()) == ["meta.json", "raw.png"]
    (tmp_path / "a" / "shot" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        captures.save_capture(tmp_path / "a" / "shot", capture, None)
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "meta.json").write_text('{"mine": 1}')
    with pytest.raises(InputError, match=r"foreign: .*did not write"):
        captures.save_capture(tmp_path / "foreign", capture, None)
    (tmp_path / "holiday").mkdir()
    (tmp_path / "holiday" / "beach.jpg").write_text("mine")
    with pytest.raises(InputError, match=r"holiday: .*did not write"):
        captures.save_capture(tmp_path / "holiday", capture, None)
    assert [path.name for path in (tmp_path / "holiday").iterdir()] == ["beach.jpg"]
    with pytest.raises(InputError, match="is a file"):
        captures.save_capture(tmp_path / "holiday" / "beach.jpg", capture, None)
    with pytest.raises(InputError, match="not a folder that can be written to"):
        folders.check_output(tmp_path / "holiday" / "beach.jpg" / "below", "capture")
    if Path("/proc").is_dir():  # root has permission there, but the file system takes no folders
        with pytest.raises(InputError, match="/proc is not a folder that can be written to"):
            folders.check_output(Path("/proc/shot"), "capture")
    series = tmp_path / "series"
    captures.save_capture(series / "000", capture, None)
    (series / "series.json").write_text('{"software": {"dasim": "1"}}')
    folders.check_output(series, "series of captures")
    (series / "000" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"000/notes\.txt"):
        folders.check_output(series, "series of captures")
    (tmp_path / "empty").mkdir()
    captures.save_capture(tmp_path / "empty", capture, None)
    assert (tmp_path / "empty" / "raw.png").is_file()
