"""Fit :mod:`recon.sharp.restoration` to examples; needs the extra ``learn`` (PyTorch), prediction does not.

The loss of a patch is the logarithm of its mean squared error in dB, so that clean and noisy examples both count. It is
computed from linear and from compressed electrons, so that bright and dark parts both count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from recon.sharp.restoration import BLOCKS, COMPRESSION, LARGEST, LEAST_SD, RANGE
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

# Channels at 2, 4, 8 and 16 pixels, by the seed of the training; larger seeds have those of seed 0.
WIDTHS = ((40, 80, 128, 160), (48, 96, 160, 224))
PATCH_PX, PATCHES, BATCH = 160, 4, 24  # side, number per example and pass, and per step
TRAINING = Training(rate=2e-3, decay=1e-3, warm_up=0.05)
FLOOR = 1e-6  # mean squared error of a patch below which it hardly counts, relative to bright white
CLIPPED_NEAR_PX = 3  # pixels around clipped ones that do not count
STATISTICS = 200  # patches that means and deviations of the inputs are taken from
SMALL = 0.1  # factor on the initial weights of the added output, so that training starts at the draft

MISTAKEN = 0.25  # share of patches whose levels have mistakes

MAPS = ("stack", "draft", "truth", "level", "sd", "clipped")
OF_LEVELS = ("draft", "level")  # maps that are there with mistakes, too
Example = Mapping[str, Tensor]
Batch = dict[str, Tensor]


def load(files: Sequence[Path]) -> list[Example]:
    """Examples of :mod:`validation.training.picture_examples`."""
    return [{name: torch.tensor(part) for name, part in np.load(file, allow_pickle=False).items()} for file in files]


def count(examples: list[Example]) -> int:
    """Number of examples."""
    return len(examples)


class Net(nn.Module):
    """The network of :mod:`recon.sharp.restoration` on images [batch, channel, h, w]."""

    def __init__(self, mean: NDArray, sd: NDArray, widths: Sequence[int] = WIDTHS[0]) -> None:
        super().__init__()
        self.mean, self.sd = constant(mean), constant(sd)
        fine, middle, coarse, deep = widths
        of_resolution = {"fine": fine, "middle": middle, "coarse": coarse, "deep": deep}
        layers = {
            "in": convolution(len(mean), fine),
            "down1": nn.Conv2d(4 * fine, middle, 1),
            "down2": nn.Conv2d(4 * middle, coarse, 1),
            "down3": nn.Conv2d(4 * coarse, deep, 1),
            "up3": nn.Conv2d(deep, 4 * coarse, 1),
            "up2": nn.Conv2d(coarse, 4 * middle, 1),
            "up1": nn.Conv2d(middle, 4 * fine, 1),
            "out": convolution(fine, 12),
        }
        for name, blocks in BLOCKS.items():
            width = of_resolution[name.removesuffix("_up")]
            for index in range(blocks):
                layers |= {
                    f"{name}{index}_a": convolution(width, width),
                    f"{name}{index}_b": nn.Conv2d(width, width, 1),
                }
        self.layers = nn.ModuleDict(layers)
        with torch.no_grad():
            for name, layer in layers.items():
                if name == "out" or name.endswith("_b"):
                    layer.weight.mul_(SMALL)
                    layer.bias.zero_()

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray]) -> Net:
        """The network of :meth:`arrays`."""
        widths = [arrays[name].shape[-1] for name in ("in", "down1", "down2", "down3")]
        net = cls(arrays["mean"], arrays["sd"], widths)
        with torch.no_grad():
            set_layers(net.layers, arrays)
        return net

    def forward(self, inputs: Tensor, base: Tensor) -> Tensor:
        """The sharp picture, compressed, [batch, 3, 2 h, 2 w]: the draft ``base`` and what the network adds to it."""
        layer, relu = self.layers, functional.relu
        fine = self._blocks(layer["in"]((inputs - self.mean) / self.sd), "fine")
        middle = self._blocks(layer["down1"](functional.pixel_unshuffle(relu(fine), 2)), "middle")
        coarse = self._blocks(layer["down2"](functional.pixel_unshuffle(relu(middle), 2)), "coarse")
        deep = self._blocks(layer["down3"](functional.pixel_unshuffle(relu(coarse), 2)), "deep")
        coarse = self._blocks(functional.pixel_shuffle(layer["up3"](relu(deep)), 2) + coarse, "coarse_up")
        middle = self._blocks(functional.pixel_shuffle(layer["up2"](relu(coarse)), 2) + middle, "middle_up")
        fine = self._blocks(functional.pixel_shuffle(layer["up1"](relu(middle)), 2) + fine, "fine_up")
        return functional.pixel_shuffle(layer["out"](relu(fine)), 2).float() + base

    def _blocks(self, image: Tensor, name: str) -> Tensor:
        relu = functional.relu
        for index in range(BLOCKS[name]):
            inner = relu(self.layers[f"{name}{index}_a"](relu(image)))
            image = image + self.layers[f"{name}{index}_b"](inner)
        return image

    def arrays(self) -> dict[str, NDArray]:
        """The arrays that :mod:`recon.sharp.restoration` reads, float16 but for means and deviations."""
        return layer_arrays(self.layers) | constant_arrays({"mean": self.mean, "sd": self.sd})


def fit(
    examples: list[Example],
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
    net = (_new(examples, seed, random) if begin is None else Net.of(begin)).to(device)
    examples = [{name: part.to(device) for name, part in example.items()} for example in examples]

    def loss_of(batch: Batch) -> Tensor:
        inputs, base = inputs_of(batch)
        with reduced(device):
            output = net(inputs.contiguous(memory_format=torch.channels_last), base)
        return loss(output, batch)

    passes = (((batch,) for batch in _batches(examples, random)) for _ in range(epochs))
    training = TRAINING if begin is None else further(TRAINING)
    train(net, training, passes, epochs * (len(examples) * PATCHES // BATCH), loss_of, report)
    if begin is not None:
        average(net, Net.of(begin).to(device))
    return net


def _new(examples: list[Example], seed: int, random: np.random.Generator) -> Net:
    """A network with random weights; means and deviations of its inputs are those of the examples."""
    sample, _ = inputs_of(_batch(examples, random.integers(0, len(examples), STATISTICS), random))
    widths = WIDTHS[seed if seed < len(WIDTHS) else 0]
    return Net(sample.mean((0, 2, 3)).numpy(), sample.std((0, 2, 3)).numpy() + np.float32(1e-3), widths)


def inputs_of(batch: Batch) -> tuple[Tensor, Tensor]:
    """Inputs [batch, input, h/2, w/2] as :func:`recon.sharp.restoration.inputs_of` orders them, and the compressed
    colours of the draft [batch, 3, h, w].
    """
    stack, draft = (_compressed(batch[name]) for name in ("stack", "draft"))
    level, sd = torch.log1p(batch["level"].abs()), torch.log(LEAST_SD + batch["sd"])
    maps = functional.avg_pool2d(torch.stack([level, sd], 1), 2)
    frame = torch.cat([torch.log(batch["noise"]), batch["sparse"][:, None]], 1)[:, :, None, None]
    parts = [functional.pixel_unshuffle(image, 2) for image in (stack, draft)]
    return torch.cat([*parts, maps, frame.expand(-1, -1, *maps.shape[2:])], 1), draft[:, :3]


def loss(output: Tensor, batch: Batch) -> Tensor:
    """Mean over the patches of the error in dB, half of linear and half of compressed electrons."""
    near = 2 * CLIPPED_NEAR_PX + 1
    counts = 1 - functional.max_pool2d(batch["clipped"][:, None], near, 1, CLIPPED_NEAR_PX)
    weight = counts / (counts.mean((1, 2, 3), keepdim=True) + 1e-3)
    linear = torch.sinh(float(RANGE) * output.clamp(-1, float(LARGEST))) / float(COMPRESSION)
    errors = linear - batch["truth"], output - _compressed(batch["truth"])
    return sum(5 * torch.log10((error**2 * weight).mean((1, 2, 3)) + FLOOR).mean() for error in errors)


def mean_loss(net: Net, examples: list[Example]) -> float:
    """Mean loss over whole examples."""
    total = []
    with torch.no_grad():
        for example in examples:
            batch = {name: part[None].to(net.mean.device).float() for name, part in example.items()}
            total.append(float(loss(net(*inputs_of(batch)), batch)))
    return float(np.mean(total))


def _compressed(relative: Tensor) -> Tensor:
    return torch.asinh(float(COMPRESSION) * relative) / float(RANGE)


def _batches(examples: list[Example], random: np.random.Generator) -> Iterator[Batch]:
    """``PATCHES`` patches of every example in a random order."""
    order = random.permutation(np.repeat(np.arange(len(examples)), PATCHES))
    for start in range(0, len(order) - BATCH + 1, BATCH):
        yield _batch(examples, order[start : start + BATCH], random)


def _batch(examples: list[Example], chosen: NDArray, random: np.random.Generator) -> Batch:
    """A random patch of each chosen example, mirrored at random so that the mosaic keeps its phase."""
    parts: dict[str, list[Tensor]] = {name: [] for name in (*MAPS, "noise", "sparse")}
    for number in chosen:
        example = examples[number]
        mirrored = random.random(2) < 0.5
        box, axes = [], [axis for axis, there in zip((-2, -1), mirrored, strict=True) if there]
        for size, there in zip(example["level"].shape, mirrored, strict=True):
            start = 2 * int(random.integers(0, (size - PATCH_PX) // 2)) + int(there)
            box.append(slice(size - start - PATCH_PX, size - start) if there else slice(start, start + PATCH_PX))
        mistaken = random.random() < MISTAKEN
        for name in MAPS:
            source = f"mistaken_{name}" if mistaken and name in OF_LEVELS else name
            parts[name].append(example[source][..., *box].flip(axes))
        for name in ("noise", "sparse"):
            parts[name].append(example[name])
    return {name: torch.stack(part).float() for name, part in parts.items()}
