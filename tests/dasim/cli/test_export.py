"""The command export, and the reconstruction of what it writes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import tifffile

import dasim
import recon
from dasim.cli import run
from dasim.files.captures import save_capture
from dasim.values import Capture


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A capture of a grey ramp by the Bayer twin, without rendering."""
    camera = dasim.cropped(dasim.load_camera("bayer-mobile"), 64, 48)
    ramp = np.tile(np.linspace(100, 900, 64), (48, 1)).astype(np.uint16)
    path = tmp_path_factory.mktemp("export") / "capture"
    save_capture(path, Capture(ramp, camera, 0.01, 1.0, 0, "D65", {"diffraction": "off"}), None)
    return path


def test_export_writes_two_files_and_recon_reads_the_mosaic(folder, tmp_path, capsys):
    """Expectation: the picture that ``dasim recon`` makes of the DNG alone is that of the capture folder."""
    assert run(["export", str(folder), "--as", "dng", "--out", str(tmp_path / "photo.dng")]) == 0
    assert "photo-linear.dng" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photo-linear.dng", "photo.dng"]
    with tifffile.TiffFile(tmp_path / "photo-linear.dng") as file:
        assert [page.shape for page in file.pages] == [(48, 64, 3)]  # a Bayer sensor has no infrared
    for source, name in ((folder, "a"), (tmp_path / "photo.dng", "b")):
        assert run(["recon", str(source), "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a" / "rgb.png").read_bytes() == (tmp_path / "b" / "rgb.png").read_bytes()
    assert recon.develop(dasim.load_capture(folder)).light in (tmp_path / "a" / "meta.json").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{capture}", "--out", "{new}/photo.tif"], "is not a DNG file in a folder that exists"),
        (["{capture}", "--out", "{new}/no/photo.dng"], "is not a DNG file in a folder that exists"),
        (["{capture}", "--out", "{new}/photo.dng", "--as", "exr"], "exr"),
        (["{new}/none", "--out", "{new}/photo.dng"], "no such folder"),
    ],
)
def test_mistakes_end_in_one_line(folder, tmp_path, capsys, arguments, message):
    status = run(["export", *(text.format(capture=folder, new=tmp_path) for text in arguments)])
    error = capsys.readouterr().err
    assert status == 2 and message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_frame_too_small_to_be_developed_leaves_nothing(folder, tmp_path, capsys):
    shot = dasim.load_capture(folder)
    small = dataclasses.replace(shot, raw_dn=shot.raw_dn[:16, :16], camera=dasim.cropped(shot.camera, 16, 16))
    save_capture(tmp_path / "small", small, None)
    assert run(["export", str(tmp_path / "small"), "--out", str(tmp_path / "photo.dng")]) == 2
    assert "too few" in capsys.readouterr().err and not list(tmp_path.glob("*.dng"))
