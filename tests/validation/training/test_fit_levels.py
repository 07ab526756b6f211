"""The network of the training is that of the prediction, and learns. Skipped without the extra ``learn``."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from recon.depth import evidence, surface_net

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from validation.training import fit_levels  # noqa: E402 - needs PyTorch

LEVELS = evidence.level_grid(28)
INPUTS = evidence.SCORES * len(LEVELS) + evidence.FITS + evidence.SIGNALS + 1
CHANNELS = 4


def made(count=16, shape=(6, 8)):
    """Examples of one level each, whose posterior stands for it, with noise."""
    random = np.random.default_rng(0)
    level = random.uniform(0, 20, count)
    inputs = 0.1 * random.standard_normal((count, *shape, INPUTS))
    ends = (evidence.SCORES - 1) * len(LEVELS), evidence.SCORES * len(LEVELS)
    inputs[..., ends[0] : ends[1]] -= np.abs(LEVELS - level[:, None, None, None] * 0.5)  # wrong by a factor of two
    samples = (count, evidence.NODE * shape[0], evidence.NODE * shape[1])
    picture = random.standard_normal((*samples, CHANNELS))
    truth = np.ones(samples) * level[:, None, None]
    return fit_levels.Examples(*(torch.tensor(array).half() for array in (inputs, picture, truth)))


def test_prediction_and_training_compute_the_same():
    torch.manual_seed(3)
    data = made(2)
    zeros, ones = (np.full(INPUTS, value, np.float32) for value in (0, 1))
    net = fit_levels.Net(zeros, ones, zeros[:CHANNELS], ones[:CHANNELS])
    arrays = {name: array.astype(np.float32) for name, array in net.arrays().items()}
    inputs, picture = (part[0].float().numpy() for part in (data.inputs, data.picture))
    found = surface_net.log_probabilities(arrays, inputs, picture, len(LEVELS))
    with torch.no_grad():
        logits = net(fit_levels._ordered(data.inputs[:1]), fit_levels._ordered(data.picture[:1]))
    np.testing.assert_allclose(np.moveaxis(found, -1, 0), logits[0].numpy(), atol=0.02)


@pytest.mark.slow
def test_training_lowers_the_loss():
    data = made()
    losses = []
    fit_levels.fit(data, 16, report=lambda epoch, loss, net: losses.append(fit_levels.mean_loss(net, data)))
    assert losses[-1] < 0.7 * losses[0]


@pytest.mark.slow
def test_a_network_that_is_trained_on_is_the_mean_of_both_and_better():
    """Set-up: a network after a few passes is trained on. Expectation: read from its arrays, it has these arrays; the
    loss is lower, and every weight lies in the middle between before and after.
    """
    data = made()
    begin = fit_levels.fit(data, 4).arrays()
    same = fit_levels.Net.of(begin).arrays()
    after: dict = {}
    found = fit_levels.fit(data, 8, begin=begin, report=lambda epoch, loss, net: after.update(net.arrays()))
    for name, array in found.arrays().items():
        np.testing.assert_array_equal(same[name], begin[name])
        middle = (begin[name].astype(float) + after[name]) / 2
        np.testing.assert_allclose(array, middle, rtol=2e-3, atol=1e-4)
    assert fit_levels.mean_loss(found, data) < fit_levels.mean_loss(fit_levels.Net.of(begin), data)


def test_turned_pictures_have_the_rows_of_their_own_frame():
    """Set-up: all pictures turned, of 6 x 8 nodes. Expectation: row -1 is at the top, 1 at the bottom."""
    random = mock.Mock(wraps=np.random.default_rng(0))
    random.random.side_effect = lambda count=None: np.zeros(count) if count == 3 else np.ones(count or 1)
    ((inputs, _, level),) = fit_levels._batches(made(8), random)
    assert inputs.shape[2:] == (8, 6)
    assert level.shape[1:] == (8 * evidence.NODE, 6 * evidence.NODE)
    np.testing.assert_allclose(inputs[0, evidence.ROW, :, 2], np.linspace(-1, 1, 8), atol=1e-6)


def test_mirrors_and_turns_keep_pictures_and_levels_together():
    """Set-up: a channel of the picture and its level hold the same numbers. Expectation: after every turn too."""
    level = torch.rand(2, 3, 5)
    picture = torch.stack([torch.zeros_like(level), level], 1)
    for across, down, transpose in np.ndindex(2, 2, 2):
        turn = bool(across), bool(down), bool(transpose)
        torch.testing.assert_close(fit_levels._turned(picture, *turn)[:, 1], fit_levels._turned(level, *turn))
