"""The network of :mod:`recon.depth.learned`, in PyTorch.

Its first layer is fixed: the logarithmic planes are split into octaves (differences of a pyramid of means), and the
energy of every plane in every octave, and the correlation of each visible plane with infrared and of red with green,
are averaged in windows of two sizes at every fourth sample. Blur removes energy from the fine octaves of the visible
planes first; how much more it removes there than in infrared indicates the blur diameter. Only a small residual network
on these maps is trained, h <- h + B relu(A * relu(h)) with 3 x 3 convolutions A and linear maps B of the channels.

Tested in tests/recon/depth/test_learned.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from recon.depth.learned import IMAGES, STEP, blur_grid

PLANES = 4
OCTAVES = 4
PAIRS = ((0, 3), (1, 3), (2, 3), (0, 1))  # of planes that are correlated
WINDOWS = (3, 9)  # sides in steps of ``STEP`` samples
LEAST_ENERGY = 1e-6
WIDTH = 64
DILATIONS = (1, 2, 4, 1)
FEATURES = len(WINDOWS) * OCTAVES * (PLANES + len(PAIRS)) + PLANES + IMAGES - PLANES


def features(images: Tensor) -> Tensor:
    """Maps that the network learns from, [batch, FEATURES, h / STEP, w / STEP], of images [batch, IMAGES, h, w]."""
    planes, constants = images[:, :PLANES], images[:, PLANES:]
    finer, found = planes, []
    for octave in range(OCTAVES):
        coarser = functional.avg_pool2d(finer, 2)
        band = finer - functional.interpolate(coarser, scale_factor=2, mode="bilinear")
        products = torch.cat([band**2, *(band[:, a : a + 1] * band[:, b : b + 1] for a, b in PAIRS)], 1)
        if octave < 2:
            products = functional.avg_pool2d(products, STEP >> octave)
        elif octave > 2:
            products = functional.interpolate(products, scale_factor=2 ** (octave - 2), mode="nearest")
        for window in WINDOWS:
            mean = functional.avg_pool2d(products, window, 1, window // 2, count_include_pad=False)
            energy = mean[:, :PLANES] + LEAST_ENERGY
            found.append(energy.log() / 2)
            found += [mean[:, PLANES + i : PLANES + i + 1] / (energy[:, a : a + 1] * energy[:, b : b + 1]).sqrt()
                      for i, (a, b) in enumerate(PAIRS)]  # fmt: skip
        finer = coarser
    return torch.cat([*found, *(functional.avg_pool2d(part, STEP) for part in (planes, constants))], 1)


class Block(nn.Module):
    """A residual block."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.wide = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation, padding_mode="replicate")
        self.mix = nn.Conv2d(width, width, 1)
        with torch.no_grad():
            self.mix.weight.mul_(0.2)

    def forward(self, hidden: Tensor) -> Tensor:
        """Of maps [batch, channel, h, w], as large."""
        return hidden + self.mix(functional.relu(self.wide(functional.relu(hidden))))


class Network(nn.Module):
    """From images [batch, IMAGES, h, w] to the logarithms of the blurs' probabilities, [batch, class, h, w], less a
    constant each; h and w are multiples of ``recon.depth.learned.MULTIPLE``.
    """

    def __init__(self) -> None:
        super().__init__()
        self.norm = nn.BatchNorm2d(FEATURES, affine=False)
        self.first = nn.Conv2d(FEATURES, WIDTH, 1)
        self.mix = nn.Conv2d(WIDTH, WIDTH, 1)
        self.blocks = nn.Sequential(*(Block(WIDTH, dilation) for dilation in DILATIONS))
        self.last = nn.Conv2d(WIDTH, len(blur_grid()), 1)

    def forward(self, images: Tensor) -> Tensor:
        """Log probabilities, less a constant."""
        hidden = self.mix(functional.relu(self.first(self.norm(features(images)))))
        logits = self.last(functional.relu(self.blocks(hidden)))
        return functional.interpolate(logits, scale_factor=STEP, mode="bilinear")


def of_arrays(arrays: Mapping[str, Tensor]) -> Network:
    """The network of stored weights, in single precision; RuntimeError for those of another network."""
    net = Network()
    net.load_state_dict({name: array.float() for name, array in arrays.items()})
    return net.eval()
