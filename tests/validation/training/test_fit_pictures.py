"""The network of the training is that of the prediction, and learns. Skipped without the extra ``learn``."""

from __future__ import annotations

import numpy as np
import pytest

from recon.sharp import restoration

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from validation.training import fit_pictures  # noqa: E402 - needs PyTorch

SIDE = 176
INPUTS = 39


def made(count):
    """Examples whose draft is the truth with noise."""
    random = np.random.default_rng(0)
    found = []
    for _ in range(count):
        truth = np.ones((3, SIDE, SIDE)) * random.uniform(0.2, 1, (3, 1, 1))
        noisy = np.concatenate([truth, truth[:1]]) + 0.1 * random.standard_normal((4, SIDE, SIDE))
        maps = {"stack": noisy, "draft": noisy, "truth": truth, "level": np.full((SIDE, SIDE), 2.0)}
        maps |= {"sd": np.full((SIDE, SIDE), 0.5), "clipped": np.zeros((SIDE, SIDE), bool)}
        maps |= {f"mistaken_{name}": maps[name] for name in fit_pictures.OF_LEVELS}
        maps |= {"noise": np.full(4, 0.1, np.float32), "sparse": np.array(0, np.float32)}
        found.append({name: torch.tensor(value) for name, value in maps.items()})
    return found


def test_prediction_and_training_compute_the_same(monkeypatch):
    torch.manual_seed(3)
    net = fit_pictures.Net(np.zeros(INPUTS, np.float32), np.ones(INPUTS, np.float32)).eval()
    arrays = {name: array.astype(np.float32) for name, array in net.arrays().items()}
    monkeypatch.setattr(restoration, "networks", lambda: (arrays, arrays))
    example = made(1)[0]
    parts = [example[name].float().numpy() for name in ("stack", "draft", "level", "sd")]
    picture = restoration.Picture(*parts, example["noise"].numpy(), np.ones(4, np.float32), False)
    found = restoration.restored(picture, {"G": (0, 0), "R": (0, 1), "B": (1, 0), "IR": (1, 1)})
    batch = {name: value[None].float() for name, value in example.items()}
    with torch.no_grad():
        expected = restoration.expanded(net(*fit_pictures.inputs_of(batch))[0].numpy())
    np.testing.assert_allclose(np.moveaxis(found, -1, 0), np.maximum(expected, 0), atol=2e-3)


@pytest.mark.slow
def test_training_lowers_the_loss():
    """Expectation: after 32 passes, half of the noise is gone, which is 6 dB in each of the two halves of the loss."""
    examples = made(16)
    losses = []
    net = fit_pictures.fit(examples, 32, report=lambda epoch, loss, net: losses.append(loss))
    draft = [{**example, "stack": example["stack"]} for example in examples[:2]]
    before = np.mean([float(_loss_of_draft(example)) for example in draft])
    assert fit_pictures.mean_loss(net, draft) < before - 6


@pytest.mark.slow
def test_a_network_is_trained_on_from_given_weights():
    """Set-up: the wider network of seed 1. Expectation: the weights that it begins with are the given ones, and every
    weight of the result lies in the middle between before and after.
    """
    examples = made(6)
    mean, sd = np.zeros(INPUTS, np.float32), np.ones(INPUTS, np.float32)
    begin = fit_pictures.Net(mean, sd, fit_pictures.WIDTHS[1]).arrays()
    same = fit_pictures.Net.of(begin).arrays()
    after: dict = {}
    found = fit_pictures.fit(examples, 2, begin=begin, report=lambda epoch, loss, net: after.update(net.arrays()))
    for name, array in found.arrays().items():
        np.testing.assert_array_equal(same[name], begin[name])
        middle = (begin[name].astype(float) + after[name]) / 2
        np.testing.assert_allclose(array, middle, rtol=2e-3, atol=1e-4)
    assert any((after[name] != begin[name]).any() for name in begin)


def _loss_of_draft(example):
    batch = {name: value[None].float() for name, value in example.items()}
    _, base = fit_pictures.inputs_of(batch)
    return fit_pictures.loss(base, batch)


def test_mirrored_patches_keep_the_phase_of_the_mosaic():
    """Set-up: one pixel in four of every map is 1. Expectation: the same pixels of all patches."""
    example = made(1)[0]
    mark = torch.zeros(SIDE, SIDE)
    mark[::2, 1::2] = 1
    example |= {"stack": torch.stack([mark] * 4), "level": mark, "mistaken_level": mark}
    batch = fit_pictures._batch([example], np.zeros(12, int), np.random.default_rng(0))
    assert (batch["level"][:, ::2, 1::2] == 1).all() and float(batch["level"].mean()) == 0.25
    torch.testing.assert_close(batch["stack"][:, 0], batch["level"])
