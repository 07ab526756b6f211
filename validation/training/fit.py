"""Fit :mod:`recon.depth.surface_net` to examples; needs the extra ``learn`` (PyTorch), prediction does not.

The loss is the cross entropy of each sample's posterior, plus the absolute error of its mean relative to the scene's
spread of levels. Parts of the evidence are left out at random, so that the network does without them too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from recon.depth.evidence import BLOCK, LAST, NODE, SCORES, SIGNALS, level_grid
from recon.depth.surface_net import AROUND, DILATIONS

CHANNELS = 64
BATCH = 8
RATE, DECAY, WARM_UP = 2e-3, 1e-2, 0.1
MEAN_WEIGHT, LEAST_SPREAD = 0.5, 0.3
MISSING = 0.1  # probability that a part of the evidence is left out
LONE = 0.15  # that the large windows are the only scores, as in the preset ``fast``
LARGE = 1  # index of their scores
FLOOR = 1e-6

LEVELS = level_grid(int(LAST))


class Examples(NamedTuple):
    """Inputs [example, h, w, input] and true levels [example, NODE h, NODE w], float16."""

    inputs: NDArray[np.float16]
    level: NDArray[np.float16]


def load(files: Sequence[Path]) -> Examples:
    """Examples of :mod:`validation.training.examples`."""
    parts = [np.load(file, allow_pickle=False) for file in files]
    return Examples(np.stack([part["inputs"] for part in parts]), np.stack([part["level"] for part in parts]))


class Net(nn.Module):
    """The network of :mod:`recon.depth.surface_net` on images [batch, channel, h, w]."""

    def __init__(self, mean: NDArray, sd: NDArray) -> None:
        super().__init__()
        inputs, levels = len(mean), len(LEVELS)
        self.register_buffer("mean", torch.tensor(mean).view(1, -1, 1, 1))
        self.register_buffer("sd", torch.tensor(sd).view(1, -1, 1, 1))
        self.first = nn.Conv2d(inputs, CHANNELS, 1)
        self.a = nn.ModuleList([nn.Conv2d(CHANNELS, CHANNELS, 3, dilation=dilation) for dilation in DILATIONS])
        self.b = nn.ModuleList([nn.Conv2d(CHANNELS, CHANNELS, 1) for _ in DILATIONS])
        self.level = nn.Conv2d(CHANNELS, levels, 1)
        self.mix = nn.Conv2d(CHANNELS, AROUND * NODE**2, 1)
        self.skip = nn.Conv2d(SCORES * levels, levels, 1, bias=False)
        with torch.no_grad():  # begin at the posterior of smooth surfaces
            self.skip.weight.zero_()[:, -levels:, 0, 0] = torch.eye(levels)
            for layer in (self.level, *self.b):
                layer.weight.mul_(0.1)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of the levels and of the weights between nodes."""
        hidden = self.first((inputs - self.mean) / self.sd)
        for a, b, dilation in zip(self.a, self.b, DILATIONS, strict=True):
            padded = functional.pad(functional.relu(hidden), (dilation,) * 4, mode="replicate")
            hidden = hidden + b(functional.relu(a(padded)))
        hidden = functional.relu(hidden)
        return self.level(hidden) + self.skip(inputs[:, : self.skip.in_channels]), self.mix(hidden)

    def arrays(self) -> dict[str, NDArray]:
        """The arrays that :mod:`recon.depth.surface_net` reads, float16 but for the mean and the deviation."""
        found = {"mean": self.mean.flatten(), "sd": self.sd.flatten(), "skip": self.skip.weight[..., 0, 0].T}
        layers = {"in": self.first, "level": self.level, "mix": self.mix}
        layers |= {f"b{index}": layer for index, layer in enumerate(self.b)}
        for name, layer in layers.items():
            found |= {name: layer.weight[..., 0, 0].T, f"{name}_bias": layer.bias}
        for index, layer in enumerate(self.a):
            found |= {f"a{index}": layer.weight.permute(2, 3, 1, 0), f"a{index}_bias": layer.bias}
        exact = ("mean", "sd")
        return {k: v.detach().numpy().astype(np.float32 if k in exact else np.float16) for k, v in found.items()}


def fit(
    examples: Examples, epochs: int, seed: int = 0, report: Callable[[int, float, Net], None] = lambda *_: None
) -> Net:
    """Train for a number of passes; ``report`` gets the pass, its mean loss and the network."""
    torch.manual_seed(seed)
    random = np.random.default_rng(seed)
    sample = examples.inputs[::7].reshape(-1, examples.inputs.shape[-1]).astype(np.float32)
    net = Net(sample.mean(axis=0), sample.std(axis=0) + np.float32(1e-3))
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    steps = epochs * (len(examples.level) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps, pct_start=WARM_UP)
    for epoch in range(epochs):
        net.train()
        losses = []
        for inputs, level in _batches(examples, random):
            value = loss(net(inputs), level)
            optimiser.zero_grad()
            value.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            losses.append(float(value.detach()))
        net.eval()
        report(epoch, float(np.mean(losses)), net)
    return net


def loss(output: tuple[Tensor, Tensor], level: Tensor) -> Tensor:
    """Cross entropy and relative error of the mean; true levels [batch, h, w] lie between two of the network's."""
    probability = _posterior(*output)
    grid = torch.tensor(LEVELS, dtype=torch.float32)
    level = level.clamp(0, float(grid[-1])).contiguous()
    low = torch.bucketize(level, grid[1:-1], right=True)
    share = (level - grid[low]) / (grid[low + 1] - grid[low])
    log = torch.log(probability + FLOOR)
    both = [log.gather(1, index[:, None])[:, 0] for index in (low, low + 1)]
    entropy = -((1 - share) * both[0] + share * both[1]).mean()
    error = (torch.einsum("blhw,l->bhw", probability, grid) - level).abs()
    spread = level.flatten(1).std(1).view(-1, 1, 1) + LEAST_SPREAD
    return entropy + MEAN_WEIGHT * (error / spread).mean()


def mean_loss(net: Net, examples: Examples) -> float:
    """Mean loss over examples, with all of the evidence."""
    total = []
    with torch.no_grad():
        for inputs, level in zip(*examples, strict=True):
            image = torch.tensor(inputs.astype(np.float32)).permute(2, 0, 1)[None]
            total.append(float(loss(net(image), torch.tensor(level.astype(np.float32))[None])))
    return float(np.mean(total))


def _posterior(logits: Tensor, mix: Tensor) -> Tensor:
    """Probability of each level at each sample, [batch, level, NODE h, NODE w]."""
    batch, levels, height, width = logits.shape
    own = functional.softmax(logits, 1)
    around = functional.unfold(functional.pad(own, (1, 1, 1, 1), mode="replicate"), 3)
    share = functional.softmax(mix.view(batch, AROUND, NODE * NODE, height, width), 1)
    mean = torch.einsum("blkhw,bkshw->blshw", around.view(batch, levels, AROUND, height, width), share)
    blocks = mean.view(batch, levels, NODE, NODE, height, width).permute(0, 1, 4, 2, 5, 3)
    return blocks.reshape(batch, levels, NODE * height, NODE * width)


def _batches(examples: Examples, random: np.random.Generator) -> Iterator[tuple[Tensor, Tensor]]:
    """All examples in a random order, mirrored and transposed at random, parts of the evidence left out."""
    order = random.permutation(len(examples.level))
    for start in range(0, len(order) - BATCH + 1, BATCH):
        chosen = np.sort(order[start : start + BATCH])
        inputs = torch.tensor(examples.inputs[chosen].astype(np.float32)).permute(0, 3, 1, 2)
        level = torch.tensor(examples.level[chosen].astype(np.float32))
        inputs, level = _turned(inputs, level, *(random.random(3) < 0.5))
        yield _thinned(inputs, random), level


def _turned(inputs: Tensor, level: Tensor, across: bool, down: bool, transpose: bool) -> tuple[Tensor, Tensor]:
    """Mirror across and down, and transpose, the blocks of samples too."""
    batch, _, height, width = inputs.shape
    rest, blocks = inputs[:, :-BLOCK], inputs[:, -BLOCK:].reshape(batch, -1, NODE, NODE, height, width)
    axes = [axis for axis, wanted in ((0, down), (1, across)) if wanted]
    rest, level = rest.flip([2 + axis for axis in axes]), level.flip([1 + axis for axis in axes])
    blocks = blocks.flip([part + axis for axis in axes for part in (2, 4)])
    if transpose:
        rest, level = rest.transpose(2, 3), level.transpose(1, 2)
        blocks = blocks.permute(0, 1, 3, 2, 5, 4)
    return torch.cat([rest, blocks.reshape(batch, BLOCK, *rest.shape[2:])], 1), level


def _thinned(inputs: Tensor, random: np.random.Generator) -> Tensor:
    """Leave parts of the evidence out at random, per example: zeros, as of scores that tell no level from another."""
    levels = len(LEVELS)
    ends = np.cumsum([0, *[levels] * SCORES, SIGNALS, BLOCK])
    for example in inputs:
        missing = random.random(len(ends) - 1) < MISSING
        if random.random() < LONE:
            missing[:SCORES] = np.arange(SCORES) != LARGE
        for part in np.flatnonzero(missing):
            example[ends[part] : ends[part + 1]] = 0
    return inputs
