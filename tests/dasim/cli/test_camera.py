"""The command camera: a page per camera, and one line for wrong input; the figures: tests/validation/reports/camera."""

from __future__ import annotations

import pytest

from dasim.cli import run

SMALL = "\n[levels]\ncount = 2\nmax_blur_px = 3\n"


def test_camera_of_the_users_own(here, capsys):
    """Expectation: the description on the screen, a page in the folder of the camera's name."""
    (here / "camera.toml").write_text((here / "camera.toml").read_text() + SMALL)
    assert run(["camera", "camera.toml", "--focus", "0.2"]) == 0
    printed = capsys.readouterr().out
    assert "focused at 20 cm" in printed and "page: out/cameras/camera/report.html" in printed
    assert (here / "out/cameras/camera/report.html").is_file()


def test_list_plots_every_camera(here, capsys, monkeypatch):
    (here / "camera.toml").write_text((here / "camera.toml").read_text() + SMALL)
    monkeypatch.setattr("dasim.camera.specification.camera_names", lambda: ["camera.toml"])
    assert run(["list", "cameras", "--plot", "--out", "pages"]) == 0
    assert "page: pages/camera.toml/report.html" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("camera", "da-mobil"), ("camera 'da-mobil'", "did you mean 'da-mobile'")),
        (("camera", "--focus", "0"), ("focus", "0")),
        (("camera", "--out", "mine.toml"), ("mine.toml", "is a file")),
        (("camera", "--out", "shot"), ("shot", "did not write")),
        (("list", "scenes", "--plot"), ("--plot", "cameras")),
        (("list", "cameras", "--plot", "--out", "mine.toml"), ("mine.toml",)),
    ],
)
def test_camera_refuses_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)
