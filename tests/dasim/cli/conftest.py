"""Fixtures of the commands' tests: a chain of small results that commands made, and a check of what is refused."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import pytest
import trimesh

from dasim.base.cache import cache_dir
from dasim.cli import run
from dasim.files.captures import load_capture
from tests.support.commands import CAMERA, SCENE, TINY
from tests.support.shared import shared


@shared
def made(renderer: str) -> dict[str, bytes]:
    """Files of a capture, a bank of one light and a reconstruction, all made by commands, and of their cache folder.

    The renderer is chosen before, with the user's own cache: trying the variants out takes a while.
    """
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        folder = Path(name)
        patch.setenv("DASIM_CACHE_DIR", str(folder / "cache"))
        patch.setenv("DASIM_VARIANT", renderer)
        model = "airy" if renderer.startswith("scalar") else "wave"
        assert run(["render", "desk", *TINY, "--seed", "5", "--out", str(folder / "shot")]) == 0
        focus = str(load_capture(folder / "shot").camera.lens.focus_distance_m)
        lights = ["--illuminant", "D55", "--focus", focus, "--diffraction", model]
        assert run(["calibrate", *lights, "--out", str(folder / "bank.npz")]) == 0
        arguments = ["--bank", str(folder / "bank.npz"), "--out", str(folder / "result")]
        assert run(["recon", str(folder / "shot"), *arguments]) == 0
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def shop(renderer, tmp_path_factory):
    """A folder with a capture, a bank of one light and a reconstruction; a cache of its own."""
    folder = tmp_path_factory.mktemp("shop")
    for name, data in made(renderer).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASIM_CACHE_DIR", str(folder / "cache"))
        patch.setenv("DASIM_VARIANT", renderer)
        yield folder


@pytest.fixture
def here(shop, tmp_path, monkeypatch):
    """An empty working folder with a scene of the user's own, and the shop's capture, bank and result."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(shop / "shot", tmp_path / "shot")
    shutil.copytree(shop / "result", tmp_path / "result")
    shutil.copy(shop / "bank.npz", tmp_path / "bank.npz")
    shutil.copy(CAMERA, tmp_path / "camera.toml")
    (tmp_path / "mine.toml").write_text(SCENE)
    trimesh.creation.icosphere(subdivisions=2, radius=1.0).export(tmp_path / "thing.obj")
    return tmp_path


def tree(*folders: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() if p.is_file() else b"" for f in folders for p in sorted(f.rglob("*"))}


@pytest.fixture
def refused(here, capfd):
    """Run a command that must fail: status 2, one line on stderr with all of ``message_part``, and nothing written."""

    def begun(*arguments, **options):
        raise AssertionError("the work has begun with this input")

    def check(*arguments: str, message_part: tuple[str, ...] = ()) -> str:
        before = tree(here, cache_dir())
        capfd.readouterr()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dasim.render.passes.stop_ratios", begun)
            patch.setattr("dasim.render.passes.sharp_pass", begun)
            patch.setattr("dasim.camera.pointspread.pixel_kernels", begun)
            status = run(list(arguments))
        printed = capfd.readouterr()
        assert status == 2, f"exit status {status}\n{printed.out}{printed.err}"
        assert tree(here, cache_dir()) == before, "something was written"
        assert "Traceback" not in printed.out + printed.err
        lines = printed.err.splitlines()
        assert lines and lines[-1].startswith("dasim: "), printed.err
        for part in message_part:
            assert part in lines[-1], lines[-1]
        assert len(lines) == 1, printed.err
        assert "arning" not in printed.out, printed.out
        return lines[0]

    return check
