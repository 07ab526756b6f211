"""Examples of the training for all-in-focus pictures: what the network sees, and the picture in focus."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import dasim
from validation.training import captures, files, layered, picture_examples, traced

DETAIL_PX = 2.0  # sigma of the mean that detail deviates from
MAPS = {"stack": 4, "draft": 4, "truth": 3}


def detail_share(pictures, example):
    """The share of the truth's detail that pictures [3, h, w] show, by regression; independent noise does not count."""
    counts = ~example["clipped"]
    of_truth, of_pictures = (
        np.stack([plane - cv2.GaussianBlur(plane, (0, 0), DETAIL_PX) for plane in images.astype(np.float32)])[:, counts]
        for images in (example["truth"], pictures)
    )
    return np.sum(of_truth * of_pictures) / np.sum(of_truth**2)


@pytest.mark.slow
def test_an_example_is_a_capture_with_its_picture_in_focus(tmp_path):
    """Expectation: a second run gives the same file; the draft shows more of the truth's detail than the capture does,
    and at most a fifth too much; the levels with mistakes are others.
    """
    files.make(tmp_path, picture_examples.example, picture_examples.CONDITIONS, 0, count=1)
    for file in (tmp_path / "textured-0.npz", tmp_path / "plain-0.npz"):
        with np.load(file) as stored:
            example = dict(stored)
        for name, channels in MAPS.items():
            assert example[name].shape == (channels, 288, 384)
            assert np.isfinite(example[name].astype(float)).all()
        for name in ("level", "mistaken_level", "sd", "clipped"):
            assert example[name].shape == (288, 384)
        assert np.abs(example["mistaken_level"] - example["level"]).max() > 0
        captured, draft = (detail_share(example[name][:3], example) for name in ("stack", "draft"))
        assert 1.1 * captured < draft < 1.2
    before = (tmp_path / "textured-0.npz").read_bytes()
    (tmp_path / "textured-0.npz").unlink()
    files.make(tmp_path, picture_examples.example, picture_examples.CONDITIONS, 0, count=1)
    assert (tmp_path / "textured-0.npz").read_bytes() == before


@pytest.mark.slow
def test_a_room_in_focus_is_its_own_truth():
    """Set-up: a room at level 0 without noise. Expectation: the layered picture equals the picture in focus."""
    setup = captures.setups()[0]
    random = np.random.default_rng(3)
    conditions = picture_examples.CONDITIONS["plain"]
    shot = captures.drawn(random, "plain", conditions, (1.0, 0.0, 0.0, 0.0), [setup] * 3)
    shot = shot._replace(scene=shot.scene._replace(level=np.zeros_like(shot.scene.level)))
    lens = layered.without_pixel(setup.lenses[0])
    truth = picture_examples.in_focus(shot, lens, 1000.0)
    mean = layered._blurred(shot.scene, lens)[:3, layered.MARGIN : -layered.MARGIN, layered.MARGIN : -layered.MARGIN]
    visible = (lens.white[:3] - lens.leak * lens.white[3])[:, None, None] * mean
    np.testing.assert_allclose(1000 * visible, truth, rtol=1e-3, atol=0.5)


@pytest.mark.slow
def test_a_path_traced_example_is_scored_against_what_the_lens_shows_in_focus(tmp_path, monkeypatch):
    """Set-up: boards at several depths in place of a random scene; a corner of the truth sees nothing. Expectation: the
    means of truth and capture agree, infrared being in neither; the capture, nearly in focus, is far nearer to the
    truth than to the truth blurred; the corner does not count.
    """
    camera = dasim.cropped(dasim.load_camera("da-mobile"), *captures.SIZE_PX)
    shot = dasim.simulate(dasim.depth_steps(30, 12), camera, 1, spp=8)
    shot.truth.valid[:20, :30] = False
    monkeypatch.setattr(traced, "kept", lambda family, number, folder: (shot.capture, shot.truth))
    example = picture_examples.example("traced", 0, captures.setups(), tmp_path)
    assert example["clipped"][:20, :30].all()
    counts = ~example["clipped"]
    colours, truth = example["stack"][:3, counts], example["truth"][:, counts]
    np.testing.assert_allclose(colours.mean(axis=1), truth.mean(axis=1), rtol=0.03)
    blurred = np.stack([cv2.GaussianBlur(plane.astype(np.float32), (0, 0), 2.0) for plane in example["truth"]])
    apart, of_blurred = (np.mean((colours - other[:, counts]) ** 2) for other in (example["truth"], blurred))
    assert apart < 0.25 * of_blurred
