"""Fit :mod:`recon.depth.surface_net` to examples; needs the extra ``learn`` (PyTorch), prediction does not.

The loss is the cross entropy of each sample's posterior, plus the absolute error of its mean relative to the scene's
spread of levels. Parts of the evidence are dropped at random, so that the network also works without them. Most
pictures are those of an upright camera.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from recon.depth.evidence import FITS, LAST, NODE, ROW, SCORES, SIGNALS, level_grid, row_of_nodes
from recon.depth.surface_net import BACK_DILATIONS, DILATIONS, MIDDLE_DILATIONS
from validation.training.network import (
    Training,
    average,
    constant,
    constant_arrays,
    convolution,
    further,
    layer_arrays,
    reduced,
    set_layers,
    train,
)

FINE, MIDDLE, WIDE = 24, 48, 80  # channels at samples, pairs of samples and nodes
BATCH = 8
TRAINING = Training(rate=2e-3, decay=1e-2, warm_up=0.1)
MEAN_WEIGHT, LEAST_SPREAD = 0.5, 0.3
MISSING = 0.1  # probability that a part of the evidence is left out
LONE = 0.15  # that the large windows are the only scores, as in the preset ``fast``
LARGE = 1  # index of their scores
MIRRORED, TURNED = 0.5, 0.1  # that pictures are mirrored across; upside down, or on their side

LEVELS = level_grid(int(LAST))


class Examples(NamedTuple):
    """Inputs [example, h, w, input], pictures [example, NODE h, NODE w, channel] and levels, as large; float16."""

    inputs: Tensor
    picture: Tensor
    level: Tensor


def load(files: Sequence[Path]) -> Examples:
    """Examples of :mod:`validation.training.level_examples`."""
    parts = [np.load(file, allow_pickle=False) for file in files]
    return Examples(*(torch.tensor(np.stack([part[name] for part in parts])) for name in Examples._fields))


def count(examples: Examples) -> int:
    """Number of examples."""
    return len(examples.level)


class Net(nn.Module):
    """The network of :mod:`recon.depth.surface_net` on images [batch, channel, h, w]."""

    def __init__(self, mean: NDArray, sd: NDArray, picture_mean: NDArray, picture_sd: NDArray) -> None:
        super().__init__()
        levels = len(LEVELS)
        self.mean, self.sd = constant(mean), constant(sd)
        self.picture_mean, self.picture_sd = constant(picture_mean), constant(picture_sd)
        layers = {"fine": convolution(len(picture_mean), FINE), "fine_in": convolution(FINE, FINE)}
        layers |= {"middle": nn.Conv2d(4 * FINE, MIDDLE, 1), "middle_in": convolution(MIDDLE, MIDDLE)}
        layers |= {"in": nn.Conv2d(len(mean), WIDE, 1), "picture_in": nn.Conv2d(4 * MIDDLE, WIDE, 1)}
        for index, dilation in enumerate(DILATIONS):
            layers |= {f"a{index}": convolution(WIDE, WIDE, dilation), f"b{index}": nn.Conv2d(WIDE, WIDE, 1)}
        layers |= {"middle_back": nn.Conv2d(WIDE, 4 * MIDDLE, 1), "fine_back": nn.Conv2d(MIDDLE, 4 * FINE, 1)}
        for name, dilations in (("middle", MIDDLE_DILATIONS), ("back", BACK_DILATIONS)):
            for index, dilation in enumerate(dilations):
                layers |= {f"{name}_a{index}": convolution(MIDDLE, MIDDLE, dilation)}
                layers |= {f"{name}_b{index}": nn.Conv2d(MIDDLE, MIDDLE, 1)}
        for name, channels in (("middle_out", MIDDLE), ("fine_out", FINE)):
            layers |= {f"{name}_a": convolution(channels, channels), f"{name}_b": nn.Conv2d(channels, channels, 1)}
        layers |= {"level": nn.Conv2d(WIDE, levels, 1), "sample": nn.Conv2d(FINE, levels, 1)}
        self.layers = nn.ModuleDict(layers)
        self.skip = nn.Conv2d(SCORES * levels, levels, 1, bias=False)
        with torch.no_grad():  # begin near the posterior of smooth surfaces
            self.skip.weight.zero_()[:, -levels:, 0, 0] = torch.eye(levels) / 2
            for name, layer in layers.items():
                if name in ("level", "sample") or name.endswith("_b") or re.search(r"b\d+$", name):
                    layer.weight.mul_(0.1)

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray]) -> Net:
        """The network of :meth:`arrays`."""
        net = cls(*(arrays[name] for name in ("mean", "sd", "picture_mean", "picture_sd")))
        with torch.no_grad():
            set_layers(net.layers, arrays)
            net.skip.weight.copy_(torch.tensor(arrays["skip"].T.astype(np.float32))[..., None, None])
        return net

    def forward(self, inputs: Tensor, picture: Tensor) -> Tensor:
        """Log probabilities of the levels at the samples, [batch, level, NODE h, NODE w], less a constant each."""
        layer, relu = self.layers, functional.relu
        fine = relu(layer["fine"]((picture - self.picture_mean) / self.picture_sd))
        fine = relu(layer["fine_in"](fine))
        middle = relu(layer["middle"](functional.pixel_unshuffle(fine, 2)))
        middle = layer["middle_in"](middle)
        for index in range(len(MIDDLE_DILATIONS)):
            middle = self._block(middle, f"middle_a{index}", f"middle_b{index}")
        middle = relu(middle)
        hidden = layer["in"]((inputs - self.mean) / self.sd)
        hidden = hidden + layer["picture_in"](functional.pixel_unshuffle(middle, 2))
        for index in range(len(DILATIONS)):
            hidden = self._block(hidden, f"a{index}", f"b{index}")
        hidden = relu(hidden)
        nodes = layer["level"](hidden) + self.skip(inputs[:, : self.skip.in_channels])
        middle = relu(functional.pixel_shuffle(layer["middle_back"](hidden), 2) + middle)
        for index in range(len(BACK_DILATIONS)):
            middle = self._block(middle, f"back_a{index}", f"back_b{index}")
        middle = self._refined(relu(middle), "middle_out")
        fine = self._refined(relu(functional.pixel_shuffle(layer["fine_back"](middle), 2) + fine), "fine_out")
        return layer["sample"](fine) + functional.interpolate(nodes, scale_factor=NODE, mode="bilinear")

    def _block(self, image: Tensor, first: str, second: str) -> Tensor:
        inner = self.layers[first](functional.relu(image))
        return image + self.layers[second](functional.relu(inner))

    def _refined(self, image: Tensor, name: str) -> Tensor:
        inner = functional.relu(self.layers[f"{name}_a"](image))
        return functional.relu(image + self.layers[f"{name}_b"](inner))

    def arrays(self) -> dict[str, NDArray]:
        """The arrays that :mod:`recon.depth.surface_net` reads, float16 but for means and deviations."""
        exact = {name: getattr(self, name) for name in ("mean", "sd", "picture_mean", "picture_sd")}
        skip = self.skip.weight[..., 0, 0].T.detach().cpu().numpy().astype(np.float16)
        return {"skip": skip} | layer_arrays(self.layers) | constant_arrays(exact)


def fit(
    examples: Examples,
    epochs: int,
    seed: int = 0,
    report: Callable[[int, float, Net], None] = lambda *_: None,
    device: str = "cpu",
    begin: Mapping[str, NDArray] | None = None,
) -> Net:
    """Train for a number of passes; ``report`` gets the pass, its mean loss and the network.

    All examples are kept on the ``device``, by PyTorch's name of it, where the network stays. ``begin`` are arrays of a
    trained network, which is trained on; the result has the mean of its weights before and after. By default a new
    network is trained.
    """
    torch.manual_seed(seed)
    random = np.random.default_rng(seed)
    if begin is None:
        net = Net(*_statistics(examples.inputs[::7]), *_statistics(examples.picture[::7])).to(device)
    else:
        net = Net.of(begin).to(device)
    examples = Examples(*(part.to(device) for part in examples))

    def loss_of(inputs: Tensor, picture: Tensor, level: Tensor) -> Tensor:
        with reduced(device):
            output = net(inputs, picture)
        return loss(output, level)

    passes = (_batches(examples, random) for _ in range(epochs))
    training = TRAINING if begin is None else further(TRAINING)
    train(net, training, passes, epochs * (len(examples.level) // BATCH), loss_of, report)
    if begin is not None:
        average(net, Net.of(begin).to(device))
    return net


def _statistics(images: Tensor) -> tuple[NDArray, NDArray]:
    """Mean and standard deviation of each channel, the last axis."""
    sample = images.flatten(0, -2).float().numpy()
    return sample.mean(axis=0), sample.std(axis=0) + np.float32(1e-3)


def loss(logits: Tensor, level: Tensor) -> Tensor:
    """Cross entropy and relative error of the mean; true levels [batch, h, w] lie between two of the network's."""
    grid = torch.tensor(LEVELS, dtype=torch.float32, device=level.device)
    level = level.clamp(0, float(grid[-1])).contiguous()
    low = torch.bucketize(level, grid[1:-1], right=True)
    share = (level - grid[low]) / (grid[low + 1] - grid[low])
    log = functional.log_softmax(logits.float(), 1)
    both = [log.gather(1, index[:, None])[:, 0] for index in (low, low + 1)]
    entropy = -((1 - share) * both[0] + share * both[1]).mean()
    error = (torch.einsum("blhw,l->bhw", log.exp(), grid) - level).abs()
    spread = level.flatten(1).std(1).view(-1, 1, 1) + LEAST_SPREAD
    return entropy + MEAN_WEIGHT * (error / spread).mean()


def mean_loss(net: Net, examples: Examples) -> float:
    """Mean loss over examples, with all of the evidence."""
    total = []
    with torch.no_grad():
        for parts in zip(*examples, strict=True):
            inputs, picture, level = (_ordered(part[None].to(net.mean.device)) for part in parts)
            total.append(float(loss(net(inputs, picture), level)))
    return float(np.mean(total))


def _ordered(images: Tensor) -> Tensor:
    """Images [batch, h, w] or [batch, h, w, channel] as PyTorch orders them, float32."""
    images = images.float()
    return images if images.ndim == 3 else images.permute(0, 3, 1, 2)


def _batches(examples: Examples, random: np.random.Generator) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """All examples in a random order, mirrored and turned at random, parts of the evidence left out."""
    order = random.permutation(len(examples.level))
    for start in range(0, len(order) - BATCH + 1, BATCH):
        chosen = torch.tensor(np.sort(order[start : start + BATCH]), device=examples.level.device)
        turn = random.random(3) < (MIRRORED, TURNED, TURNED)
        inputs, picture, level = (_turned(_ordered(part[chosen]), *turn) for part in examples)
        row = torch.tensor(row_of_nodes(inputs.shape[2:])[..., 0])  # a picture's own, whatever it shows
        inputs[:, ROW] = row.to(inputs.device)
        yield _thinned(inputs, picture, random), picture, level


def _turned(images: Tensor, across: bool, down: bool, transpose: bool) -> Tensor:
    """Mirror across and down, and transpose."""
    images = images.flip([axis for axis, wanted in ((-2, down), (-1, across)) if wanted])
    return images.transpose(-2, -1) if transpose else images


def _thinned(inputs: Tensor, picture: Tensor, random: np.random.Generator) -> Tensor:
    """Leave parts of the evidence and of the picture out at random, per example, in place: zeros, as of scores that
    tell no level from another.
    """
    ends = np.cumsum([0, *[len(LEVELS)] * SCORES, FITS + SIGNALS, 1])
    for example, channels in zip(inputs, picture, strict=True):
        missing = random.random(len(ends) - 1) < MISSING
        if random.random() < LONE:
            missing[:SCORES] = np.arange(SCORES) != LARGE
        for part in np.flatnonzero(missing):
            example[ends[part] : ends[part + 1]] = 0
        channels[random.random(len(channels)) < MISSING] = 0
    return inputs
