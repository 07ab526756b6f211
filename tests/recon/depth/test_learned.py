"""The learned depth estimate: what the network sees, the weights that come with the package, and wrong files.

What needs PyTorch is skipped without the extra ``learn``.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.values import Capture
from recon.depth import learned
from tests.support import recon_scenes
from validation.methods import named

needs_torch = pytest.mark.skipif(
    not (find_spec("torch") and find_spec("safetensors")),
    reason="PyTorch or safetensors is not installed; they come with the extra 'learn'",
)
TIME_S = 0.03
CARD = Path(__file__).parents[3] / "docs" / "how" / "learned.md"


def flat(electrons=(900.0, 1500.0, 700.0, 500.0)):
    """A capture of a uniform surface with the given electrons of R, G, B and IR."""
    camera = recon_scenes.da_mobile(128, 96)
    mean = noise.mosaic(np.broadcast_to(electrons, (96, 128, 4)).astype(float), camera)
    raw, _ = noise.expose(mean, camera.sensor, TIME_S, 3)
    return Capture(raw, camera, TIME_S, 1.0, 3)


def test_blurs_are_spaced_by_a_pixel_and_then_by_an_eighth():
    grid = learned.blur_grid()
    assert grid[:9].tolist() == list(range(9))
    np.testing.assert_allclose(grid[9:] / grid[8:-1], 1.125)
    assert grid[-2] < learned.LAST_PX <= grid[-1]


def test_the_card_says_what_the_code_has():
    """Expectation: the numbers of the model card in docs/how/learned.md are those of the code and of its defaults."""
    from dasim.cli.learn import EPOCHS, ROOMS
    from validation.training import depth_examples

    card = CARD.read_text()
    grid = learned.blur_grid()
    assert f"probabilities of {len(grid)} diameters of the visible blur from 0 to {grid[-1]:.0f} px" in card
    width, height = depth_examples.SIZE_PX
    lenses = ROOMS // depth_examples.PER_LENS
    assert f"{ROOMS} random rooms of {width} x {height} px" in card
    assert f"behind {lenses} lenses with Hopkins's transfer functions, seed 0, in {EPOCHS} passes" in card
    low, high = depth_examples.HOLE
    far, near = (1 / dioptre for dioptre in depth_examples.FOCUS_DIOPTRE)
    dim, bright = depth_examples.GREEN_E
    assert f"hole {low:g} to {high:g} of the lens, focus {near:g} to {far:g} m, four lights" in card
    assert f"{dim:,.0f} to {bright:,.0f} electrons of white in green" in card and len(depth_examples.LIGHTS) == 4


def test_the_stated_noise_is_that_of_a_uniform_surface():
    """Set-up: no texture, so that all that varies is noise. Expectation: the planes, freed of infrared, vary by the
    constants beside them. Limit: 5 %, four standard errors of 3,072 samples.
    """
    shown = learned.images(flat(), 0.46)
    assert shown.shape == (learned.IMAGES, 48, 64)
    for plane, stated in zip(shown[:4], shown[4:8], strict=True):
        assert np.ptp(stated) == 0
        assert plane.std() == pytest.approx(float(np.exp(stated[0, 0])), rel=0.05)
    assert (shown[8] == np.float32(0.46)).all()


def test_exposure_does_not_change_what_is_seen_but_for_noise():
    """Set-up: ten times the light. Expectation: planes of the same mean but for the curvature of the logarithm, half of
    the relative variance (4 % in red at 90 electrons), with less noise.
    """
    dim, bright = learned.images(flat((90.0, 150.0, 70.0, 50.0)), 0.46), learned.images(flat(), 0.46)
    np.testing.assert_allclose(dim[:4].mean((1, 2)), bright[:4].mean((1, 2)), atol=0.04)
    assert (dim[4:8] > bright[4:8] + 0.5).all()


def test_the_hole_is_measured_in_the_kernels():
    """Limit: 0.03, by which diffraction widens the infrared kernel of 24 px."""
    bank = recon_scenes.bank()
    assert learned.hole_of(bank) == pytest.approx(0.46, abs=0.03)
    visible = bank.kernel.copy()
    visible[:, :, 3] = visible[:, :, 1]
    assert learned.hole_of(replace(bank, kernel=visible)) == pytest.approx(1)


def test_without_pytorch_one_line_says_what_to_install(monkeypatch, capsys, tmp_path):
    from dasim.cli import run

    monkeypatch.setattr(learned, "find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"^the learned depth estimate needs PyTorch.*pip install -c constraints.txt -e '\.\[learn\]'$"
    ):
        named(["best", "learned"])
    with pytest.raises(InputError, match="needs PyTorch"):
        learned.estimate(flat(), recon_scenes.bank())
    for command in (["train", "--out", f"{tmp_path}/a.safetensors"], ["predict", "x", "--out", f"{tmp_path}/p"]):
        assert run(["learn", *command]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "pip install -c constraints.txt -e '.[learn]'" in error


@needs_torch
def test_the_network_of_the_package_is_small_and_says_what_it_was_trained_with():
    from safetensors import safe_open

    assert learned.FILE.stat().st_size < learned.MOST_BYTES
    weights = sum(weight.numel() for weight in learned.network(learned.FILE).parameters())
    assert weights < 1_000_000
    assert f"{round(weights, -3):,} weights" in CARD.read_text()
    with safe_open(learned.FILE, "pt") as file:
        assert "rooms of validation.training" in file.metadata()["about"]


@needs_torch
def test_a_staircase_is_read_as_one():
    """Set-up: a photograph of gravel behind the simulated lens, which the training does not know, in strips of 2,
    6, 10 and 14 levels. Expectation: the levels rise from strip to strip, the mean error is below 0.8 of that of the
    best constant map, and two stated standard deviations hold most errors. Strong blur is read too small (14 as 10):
    rooms have little of it.
    """
    level = recon_scenes.staircase(192, 256, 2.0, 14.0, 4)
    found = learned.estimate(recon_scenes.make(level, photo="gravel").capture, recon_scenes.bank())
    assert found.joined
    assert found.coverage == 1
    medians = [np.median(found.level[level == one]) for one in np.unique(level)]
    assert (np.diff(medians) > 1).all()
    error = np.abs(found.level - level)
    assert error.mean() < 0.8 * np.abs(level - np.median(level)).mean()
    assert np.mean(error < 2 * found.sd) > 0.6


@needs_torch
def test_frames_of_any_even_size_have_an_estimate_of_their_size():
    camera = recon_scenes.da_mobile(74, 50)
    capture = replace(flat(), camera=camera, raw_dn=flat().raw_dn[:50, :74])
    found = learned.estimate(capture, recon_scenes.bank())
    assert found.shape == (50, 74)
    assert (found.sd >= 0).all()
    assert found.level.max() <= len(recon_scenes.bank().depth_m) - 1


@needs_torch
@pytest.mark.parametrize("content", [b"", b"not weights at all", b"\x08\0\0\0\0\0\0\0{}      "])
def test_a_file_without_a_network_is_refused_in_one_line(tmp_path, content):
    file = tmp_path / "wrong.safetensors"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"wrong\.safetensors: holds no network of 'dasim learn train'") as error:
        learned.network(file)
    assert "\n" not in str(error.value)
