"""Files that anybody may have written: each malformed one is refused in one line, quickly and without much memory."""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import Field

import dasim
from dasim.base import untrusted
from dasim.base.errors import LONGEST, InputError
from dasim.base.toml import Specification, parse, parse_toml
from dasim.scene import meshes

ALL = cv2.IMREAD_UNCHANGED
GREY = np.arange(48, dtype=np.uint16).reshape(6, 8)
SQUARE = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n"
ROOM = (
    '<scene version="3.0.0"><shape type="sphere"><float name="radius" value="{}"/></shape>'
    '<emitter type="constant"><rgb name="radiance" value="{}"/></emitter></scene>'
)


class Lens(Specification):
    radius_cm: float = Field(gt=0)
    counts: tuple[int, ...] = ()
    is_open: bool = True


def png(**changes) -> bytes:
    """A PNG of ``GREY``; ``size`` is what its header states, ``cut`` the bytes that its pixels lack."""
    data = bytearray(cv2.imencode(".png", GREY)[1].tobytes())
    if "size" in changes:
        data[16:24] = struct.pack(">II", *changes["size"])
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    if "cut" in changes:
        place = data.index(b"IDAT") - 4
        length = int.from_bytes(data[place : place + 4])
        body = bytes(data[place + 8 : place + 8 + length - changes["cut"]])
        chunk = struct.pack(">I", len(body)) + b"IDAT" + body + struct.pack(">I", zlib.crc32(b"IDAT" + body))
        data[place : place + 12 + length] = chunk
    return bytes(data)


def npy(array) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(*entries: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return file.getvalue()


# --- what a file is ------------------------------------------------------------------------------


def test_pipes_devices_and_folders_are_refused_at_once(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(InputError, match=r"not a regular file|is a folder"):
            untrusted.content(path, str(path))
        with pytest.raises(InputError, match="not a regular file"):
            untrusted.check_file(path, str(path))


def test_sparse_file_is_refused_until_the_limit_is_raised(tmp_path, monkeypatch):
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(3_000_000_000)
    with pytest.raises(InputError, match=r"sparse: has 3000 MB, at most 2000 MB are read; set DASIM_MOST_FILE_MB"):
        untrusted.content(path, "sparse")
    monkeypatch.setenv("DASIM_MOST_FILE_MB", "4000")
    untrusted.check_file(path, "sparse")
    monkeypatch.setenv("DASIM_MOST_FILE_MB", "many")
    with pytest.raises(InputError, match="DASIM_MOST_FILE_MB=many: is not a number above 0"):
        untrusted.check_file(path, "sparse")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("a = " + "9" * 5000, "not valid TOML"),
        ("a = [{b = " + "9" * 400 + "}]", "more than 128 bits"),
        ("a = " + "[" * 30_000 + "]" * 30_000, "nested too deeply"),
        (b"a = '\xff'", "not UTF-8"),
        ("radius_cm = true", r"radius_cm: must be a number \(is True\)"),
        ("radius_cm = '1'", "must be a number"),
        ("radius_cm = 1\ncounts = [1, false]", "counts.1: must be a number"),
        ("radius_cm = 1\nis_open = 3", "is_open"),
        ("radius_cm = -" + "9" * 300, "128 bits"),
        ("radius_cm = -" + "9" * 30, "radius_cm"),
        ('"\\u001b[31m" = 1', r"\\x1b\[31m: unknown key"),
    ],
)
def test_specifications(written, message, tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(written if isinstance(written, bytes) else written.encode())
    with pytest.raises(InputError, match=message) as caught:
        parse_toml(Lens, path)
    assert len(str(caught.value)) < 400 and str(caught.value).isprintable()
    assert parse(Lens, {"radius_cm": 2, "counts": [1]}, "lens").radius_cm == 2.0


def test_long_messages_are_cut():
    assert len(str(InputError("a" * 10**6))) < LONGEST + 10


@pytest.mark.parametrize("written", ["{", "[" * 100_000, "[]", "9" * 5000, '{"a": ' + "9" * 400 + "}", '{"a": NaN'])
def test_json(written):
    with pytest.raises(InputError, match=r"^meta: "):
        untrusted.json_values(written, "meta")


# --- pictures ------------------------------------------------------------------------------------


def test_pictures(tmp_path, monkeypatch):
    np.testing.assert_array_equal(untrusted.decoded(png(), "a", ALL), GREY)
    for data, message in (
        (png(size=(100_000, 100_000)), "has 100000 x 100000 pixels, at most 100 million"),
        (png(size=(12_000, 12_000)), "set DASIM_MOST_MPX"),
        (png(cut=4), "truncated PNG"),
        (png()[:-20], "truncated"),
        (png()[:-12], "truncated"),  # without its last chunk alone
        (png()[:8], "picture"),
        (png()[:50] + b"!" + png()[51:], "damaged"),
        (b"\xff\xd8\xff", "cannot be read as a picture"),
        (b"", "cannot be read as a picture"),
        (b"#?RADIANCE\n\n-Y 100000 +X 200000\n", "200000 x 100000"),
    ):
        with pytest.raises(InputError, match=message):
            untrusted.decoded(data, "a", ALL)
    monkeypatch.setenv("DASIM_MOST_MPX", "1e-5")
    with pytest.raises(InputError, match="8 x 6 pixels"):
        untrusted.decoded(png(), "a", ALL)


# --- arrays --------------------------------------------------------------------------------------


def test_arrays(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(npy(np.asfortranarray(GREY)))
    np.testing.assert_array_equal(untrusted.array(path, "a"), GREY)
    huge = npy(GREY).replace(b"(6, 8)", b"(6, 9)")
    for data in (b"1 2 3", npy(GREY)[:-1], huge, npy(np.array([{}], object)), npz(("a.npy", npy(GREY)))):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"^a: "):
            untrusted.array(path, "a")


def test_archives(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(npz(("a.npy", npy(GREY)), ("about.npy", npy(np.array("{}")))))
    assert set(untrusted.arrays(path, "a")) == {"a", "about"}
    with pytest.warns(UserWarning, match="Duplicate"):
        twice = npz(("a.npy", npy(GREY)), ("a.npy", npy(GREY)))
    bomb = npz(("a.npy", b"0" * 3_000_000))
    for data, message in ((twice, "entry twice"), (b"text", "no NPZ"), (bomb, "as an NPY array")):
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            untrusted.arrays(path, "a")


def test_archive_that_unpacks_to_more_than_the_limit(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    path.write_bytes(npz(("a.npy", b"0" * 3_000_000)))
    monkeypatch.setenv("DASIM_MOST_FILE_MB", "1")
    with pytest.raises(InputError, match="unpacks to 3 MB"):
        untrusted.arrays(path, "a")


# --- meshes and scenes ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ("f 1 2 0\n", "index 0"),
        ("f 1/1 0/2 3/3\n", "index 0"),
        ("v 1e30 0 0\nf 1 2 5\n", "beyond"),
        ("vt nan 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n", "texture coordinates"),
        ("vt 1e30 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n", "texture coordinates"),
    ],
)
def test_meshes(faces, message, tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(SQUARE + faces)
    with pytest.raises(InputError, match=message):
        meshes.read(path, 1.0, "a.obj")
    path.write_text(SQUARE + "vt 0 0\nf 1/1 2/1 10/1\nf 1/1 2/1 3/1\n".replace("10/1", "4/1"))
    assert len(meshes.read(path, 1.0, "a.obj")[0].faces) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROOM.format("nan", "1"), "line 1: radius is nan"),
        (ROOM.format("-3", "1"), "a finite length above 0"),
        ("<scene>" * 20_000, "levels deep"),
        ('<?xml version="1.0" encoding="latin-1"?><scene/>', "save it as UTF-8"),
        (b'<scene a="\xe9"/>', "not UTF-8"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><scene/>', "entities"),
        ("<scene", "not well-formed XML"),
        ('<scene><bsdf><float name="alpha" value="-3"/></bsdf></scene>', "a roughness from 0 to 1"),
    ],
)
def test_mitsuba_scenes(text, message, tmp_path):
    path = tmp_path / "a.xml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message):
        dasim.load_scene(path)
    (tmp_path / "outer.xml").write_text('<scene><include filename="a.xml"/></scene>')
    with pytest.raises(InputError, match=message):
        dasim.load_scene(tmp_path / "outer.xml")


@pytest.mark.parametrize(
    "outer",
    [
        '<scene><path value="parts"/><include filename="a.xml"/></scene>',
        '<scene><default name="which" value="parts/a"/><include filename="$which.xml"/></scene>',
        '<scene><default name="where" value="parts"/><path value="$where"/><include filename="a.xml"/></scene>',
        '<scene><include filename="parts/b.xml"/></scene>',
    ],
)
def test_files_that_a_mitsuba_scene_includes_are_checked_wherever_they_are(outer, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "outer.xml").write_text(outer)
    (tmp_path / "parts" / "a.xml").write_text("<scene>" * 20_000)
    (tmp_path / "parts" / "b.xml").write_text('<scene><include filename="a.xml"/></scene>')
    with pytest.raises(InputError, match="levels deep"):
        dasim.load_scene(tmp_path / "outer.xml")
    (tmp_path / "parts" / "a.xml").unlink()
    os.mkfifo(tmp_path / "parts" / "a.xml")
    with pytest.raises(InputError, match="not a regular file"):
        dasim.load_scene(tmp_path / "outer.xml")


def test_pipe_as_a_spectrum_of_a_mitsuba_scene_is_refused(tmp_path):
    """Rationale: Mitsuba opens it while it parses the scene, and waits for ever."""
    os.mkfifo(tmp_path / "light.spd")
    text = ROOM.format("1", "1").replace('<rgb name="radiance" value="1"/>', '<spectrum filename="light.spd"/>')
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(InputError, match=r"line 1: spectrum light.spd: is not a regular file"):
        dasim.load_scene(tmp_path / "a.xml")


def test_defaults_of_a_mitsuba_scene_are_checked(tmp_path):
    text = ROOM.format("$r", "1").replace("<shape", '<default name="r" value="nan"/><shape', 1)
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(InputError, match="radius is nan"):
        dasim.load_scene(tmp_path / "a.xml")
    dasim.load_scene(tmp_path / "a.xml", define={"r": "2"})


def test_scene_in_utf_8_is_read(tmp_path):
    (tmp_path / "a.xml").write_text("<?xml version='1.0' encoding='utf-8'?>" + ROOM.format("$r", "1"))
    assert dasim.load_scene(tmp_path / "a.xml", define={"r": "2"}).name == "a"
    with pytest.raises(InputError, match="radius is nan"):
        dasim.load_scene(tmp_path / "a.xml", define={"r": "nan"})
