"""Training of the learned depth estimate: pictures and blurs stay together, the loss falls, files and commands work.

Skipped without the extra ``learn``.
"""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera import specification as cameras
from dasim.values import Capture
from tests.support import datasets, recon_scenes

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
pytest.importorskip("safetensors", reason="safetensors is not installed; it comes with the extra 'learn'")
from recon.depth import learned  # noqa: E402
from validation.training import depth_examples, fit_depth  # noqa: E402 - needs PyTorch
from validation.training import learned as training  # noqa: E402

HEIGHT, WIDTH = 32, 48


def capture(mean, camera=None):
    """A capture without noise of mean electrons [h, w, channel]."""
    camera = camera or recon_scenes.da_mobile(mean.shape[1], mean.shape[0])
    raw, _ = noise.expose(noise.mosaic(mean, camera), camera.sensor, 0.03, 0, noise="off")
    return Capture(raw, camera, 0.03, 1.0, 0)


@pytest.mark.parametrize(
    ("name", "height", "message"),
    [
        ("bayer-mobile", HEIGHT, "camera 'bayer-mobile' has no IR pixels"),
        ("da-mobile", 24, "is smaller than 32 pixels"),
    ],
)
def test_a_sample_that_cannot_be_learned_from_is_named(monkeypatch, name, height, message):
    camera = cameras.cropped(name, WIDTH, height)
    taken = Capture(np.zeros((height, WIDTH), np.uint16), camera, 0.03, 1.0, 0)
    monkeypatch.setattr(training, "capture_of", lambda *_: taken)
    sample = SimpleNamespace(index=3, meta={}, raw_dn=taken.raw_dn, truth={"depth_m": np.full((height, WIDTH), 0.3)})
    with pytest.raises(InputError, match=f"000000003: {message}"):
        training.of_sample(sample)


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("name", ["da-mobile", "da-4x4"])
def test_mirrored_colours_stay_apart_in_every_pixel(name, down, across):
    """Expectation: of an even picture whose channels differ, the mirror image is the same in every pixel."""
    mean = np.full((HEIGHT, WIDTH, 4), 400.0) * np.array([1.0, 2.0, 0.7, 0.4])
    taken, blur = capture(mean, cameras.cropped(name, WIDTH, HEIGHT)), np.zeros((HEIGHT // 2, WIDTH // 2))
    plain, found = (fit_depth.mirrored(taken, blur, 0.5, *turned) for turned in ((False, False), (down, across)))
    np.testing.assert_array_equal(found.images, plain.images)


def test_a_pattern_that_is_not_its_mirror_image_is_not_mirrored():
    """Set-up: rows of four kinds, of which no shift of the mirror image is the pattern."""
    assert fit_depth._mirrored_order(np.array([["R"], ["G"], ["B"], ["IR"]]), HEIGHT) is None


@pytest.mark.parametrize(("down", "across"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_mirrored_mosaic_keeps_its_pattern_and_its_blurs(down, across):
    """Set-up: every channel has a level of its own, and light and blur rise along both axes. Expectation: the channels
    are still told apart, which their noise shows, and light and blur still rise together. Limit: noise differs by 0.3
    or more between the channels; the border, where pixels are repeated, moves the means by 4 %.
    """
    y, x = np.indices((HEIGHT, WIDTH))
    mean = (20 * y + 10 * x + 300.0)[..., None] * np.array([1.0, 2.0, 0.7, 0.4])
    blur = (2.0 * y + x)[::2, ::2]
    plain = fit_depth.mirrored(capture(mean), blur, 0.5, False, False)
    found = fit_depth.mirrored(capture(mean), blur, 0.5, bool(down), bool(across))
    np.testing.assert_allclose(found.images[4:, 0, 0], plain.images[4:, 0, 0], atol=0.05)
    assert np.corrcoef(np.exp(found.images[1]).ravel(), found.blur_px.ravel())[0, 1] > 0.99
    assert (found.blur_px[0, 0] > found.blur_px[-1, 0]) == bool(down)


def test_the_loss_is_least_at_the_truth_and_passes_over_unknown_pixels():
    grid = learned.blur_grid()
    blur = torch.tensor([[[grid[3], np.nan, grid[10]]]], dtype=torch.float32)
    logits = torch.full((1, len(grid), 1, 3), -50.0)
    logits[0, 3, 0, 0] = logits[0, 10, 0, 2] = 50.0
    assert float(fit_depth.loss(logits, blur)) == pytest.approx(0, abs=1e-6)
    logits[0, :, 0, 1] = torch.arange(len(grid))
    assert float(fit_depth.loss(logits, blur)) == pytest.approx(0, abs=1e-6)
    assert float(fit_depth.loss(logits, torch.full_like(blur, torch.nan))) == 0
    assert float(fit_depth.loss(torch.zeros_like(logits), blur)) > np.log(len(grid)) - 1e-3


def sources(count=16):
    """Examples whose blur is written into their first image."""
    random = np.random.default_rng(0)

    def one(level):
        shown = random.standard_normal((learned.IMAGES, 16, 16)).astype(np.float32)
        shown[0] = level / 10
        return lambda generator: fit_depth.Shown(shown, np.full((16, 16), level, np.float32))

    return [one(level) for level in random.uniform(0, 30, count)]


def test_training_lowers_the_loss_and_weights_survive_their_file(tmp_path):
    data, losses = sources(), []
    net = fit_depth.fit(data, 12, report=lambda number, loss, net: losses.append(loss))
    assert losses[-1] < 0.7 * losses[0]
    path = tmp_path / "weights.safetensors"
    fit_depth.write(net, path, {"trained_on": "nothing"})
    shown = torch.from_numpy(data[0](None).images[None])
    with torch.no_grad():
        torch.testing.assert_close(learned.network(path)(shown), net(shown), rtol=0.02, atol=0.05)


def test_examples_of_a_batch_are_cropped_together():
    """Set-up: the blur of a sample is its column. Expectation: the crop of a larger example has the same in both."""
    columns = np.broadcast_to(np.arange(40, dtype=np.float32), (24, 40))
    shown = fit_depth.Shown(np.repeat(columns[None], learned.IMAGES, 0), columns)
    small = fit_depth.Shown(shown.images[:, :16, :16], columns[:16, :16])
    ((images, blur),) = fit_depth._batches([lambda r: shown, lambda r: small], np.random.default_rng(0))
    assert blur.shape == (2, 16, 16)
    torch.testing.assert_close(images[:, 0], blur)


@pytest.mark.slow
def test_rooms_depend_on_seed_and_number_alone(monkeypatch):
    monkeypatch.setattr(depth_examples, "SIZE_PX", (48, 32))
    two, one = depth_examples.make(2), depth_examples.make(1)
    np.testing.assert_array_equal(two[0].mean, one[0].mean)
    assert two[0].mean.shape == (32, 48)
    assert two[0].blur_px.shape == (16, 24)
    assert 0 < float(two[0].mean.mean()) < 1
    other = depth_examples.make(1, seed=1)
    assert other[0].hole != one[0].hole
    first, second = (depth_examples.exposed(one[0], np.random.default_rng(seed)) for seed in (0, 1))
    assert not np.array_equal(first.raw_dn, second.raw_dn)


def test_the_hole_of_a_camera_is_what_its_kernels_show():
    """Rationale: training states the hole from the data sheet, prediction measures it in a bank. Limit: 0.01, a
    fiftieth of it.
    """
    bank = recon_scenes.bank()
    assert depth_examples.hole_of(bank.camera) == pytest.approx(learned.hole_of(bank), abs=0.01)


@pytest.mark.slow
def test_a_dataset_is_learned_and_predicted_by_the_commands(tmp_path, capsys):
    """Set-up: six pictures of a wall. Expectation: weights, and a depth map that the scores read for every sample."""
    from dasim.cli import run
    from validation.scores.depth_files import read_depth

    out = tmp_path / "ds"
    (tmp_path / "other.toml").write_text(datasets.WALL)  # no scene may be in two splits
    scenes = ["wall.toml", "other.toml"]
    spec = datasets.spec_file(tmp_path, files=scenes, top="[splits]\ntrain = 0.5\ntest = 0.5")
    spec.write_text(spec.read_text().replace("size_px = [32, 24]", "size_px = [64, 48]"))
    for file in (tmp_path / name for name in scenes):
        file.write_text(file.read_text().replace("position_cm = [0, 0, 50]", "position_cm = [0, 0, 30]"))
    datasets.make_dataset(spec, out)
    weights, maps = tmp_path / "mine.safetensors", tmp_path / "maps"
    assert run(["learn", "train", str(out), "--out", str(weights), "--epochs", "2"]) == 0
    assert re.search(r"pass 2 of 2: loss \d", capsys.readouterr().out)
    assert run(["learn", "predict", str(out), "--weights", str(weights), "--out", str(maps)]) == 0
    files = sorted((maps / "depth").glob("*.npy"))
    assert len(files) == 3
    assert read_depth(files[0]).shape == (48, 64)
    assert [file.name for file in sorted((maps / "sd").iterdir())] == [file.name for file in files]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "w.npz"], "--out w.npz: must end in .safetensors"),
        (["--out", "w.safetensors", "--epochs", "0"], "--epochs 0: must be 1 or more"),
        (["--out", "w.safetensors", "--rooms", "0"], "training: neither a dataset nor rooms"),
        (["nowhere", "--out", "w.safetensors"], "nowhere"),
        (["--out", "w.safetensors", "--device", "tpu9"], "--device tpu9"),
        (["--out", "/proc/w.safetensors"], "/proc is not a folder that can be written to"),
        (["--out", f"{__file__}/w.safetensors"], "is not a folder that can be written to"),
    ],
)
def test_wrong_options_of_the_training_are_refused_in_one_line(options, message, capsys, tmp_path, monkeypatch):
    """Expectation: at once, before an example is made, which takes minutes."""
    from dasim.cli import run

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(depth_examples, "make", lambda *_: pytest.fail("rooms were made"))
    assert run(["learn", "train", *options]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    assert not list(tmp_path.iterdir())


def test_a_processor_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="--device tpu9"):
        training.fitted(training.Examples(sources(2), [], ""), 1, 0, "tpu9")
