"""The network of the training is that of the prediction, and learns. Skipped without the extra ``learn``."""

from __future__ import annotations

import numpy as np
import pytest

from recon.depth import evidence, surface_net

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from validation.training import fit  # noqa: E402 - needs PyTorch

LEVELS = evidence.level_grid(28)
INPUTS = evidence.SCORES * len(LEVELS) + evidence.SIGNALS + evidence.BLOCK


def made(count=16, shape=(6, 8)):
    """Examples of one level each, whose posterior stands for it, with noise."""
    random = np.random.default_rng(0)
    level = random.uniform(0, 20, count)
    inputs = 0.1 * random.standard_normal((count, *shape, INPUTS))
    ends = (evidence.SCORES - 1) * len(LEVELS), evidence.SCORES * len(LEVELS)
    inputs[..., ends[0] : ends[1]] -= np.abs(LEVELS - level[:, None, None, None] * 0.5)  # wrong by a factor of two
    truth = np.ones((count, evidence.NODE * shape[0], evidence.NODE * shape[1])) * level[:, None, None]
    return fit.Examples(inputs.astype(np.float16), truth.astype(np.float16))


def test_prediction_and_training_compute_the_same(monkeypatch):
    torch.manual_seed(3)
    data = made(2)
    net = fit.Net(np.zeros(INPUTS, np.float32), np.ones(INPUTS, np.float32))
    arrays = {name: array.astype(np.float32) for name, array in net.arrays().items()}
    monkeypatch.setattr(surface_net, "weights", lambda: arrays)
    monkeypatch.setattr(surface_net, "SHARE", 1.0)
    inputs = data.inputs[0].astype(np.float32)
    found = surface_net.posterior(inputs, LEVELS, 28)
    with torch.no_grad():
        probability = fit._posterior(*net(torch.tensor(inputs).permute(2, 0, 1)[None]))[0].numpy()
    np.testing.assert_allclose(found.level, np.tensordot(probability, LEVELS, (0, 0)), atol=0.02)


def test_training_lowers_the_loss():
    data = made()
    losses = []
    fit.fit(data, 16, report=lambda epoch, loss, net: losses.append(fit.mean_loss(net, data)))
    assert losses[-1] < 0.7 * losses[0]


def test_mirrors_and_turns_keep_inputs_and_levels_together():
    """Set-up: a picture block and its level hold the same numbers. Expectation: so they do after every turn."""
    shape = (3, 5)
    level = torch.rand(2, evidence.NODE * shape[0], evidence.NODE * shape[1])
    blocks = level.reshape(2, shape[0], evidence.NODE, shape[1], evidence.NODE).permute(0, 2, 4, 1, 3)
    inputs = torch.cat([torch.zeros(2, 4, *shape), *[blocks.reshape(2, -1, *shape)] * 2], 1)
    for across, down, transpose in np.ndindex(2, 2, 2):
        turned, found = fit._turned(inputs, level, bool(across), bool(down), bool(transpose))
        height, width = turned.shape[2:]
        part = turned[:, -evidence.BLOCK :].reshape(2, 2, evidence.NODE, evidence.NODE, height, width)[:, 1]
        whole = part.permute(0, 3, 1, 4, 2).reshape(2, evidence.NODE * height, evidence.NODE * width)
        torch.testing.assert_close(whole, found)
