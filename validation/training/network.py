"""What the networks of the training have in common; needs the extra ``learn`` (PyTorch).

Tested in tests/validation/training/test_fit_levels.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn


def convolution(inputs: int, outputs: int, dilation: int = 1) -> nn.Conv2d:
    """A 3 x 3 convolution that repeats the border."""
    return nn.Conv2d(inputs, outputs, 3, dilation=dilation, padding=dilation, padding_mode="replicate")


def constant(values: NDArray) -> nn.Buffer:
    """A constant per channel of images [batch, channel, h, w]."""
    return nn.Buffer(torch.tensor(values).view(1, -1, 1, 1))


def layer_arrays(layers: nn.ModuleDict) -> dict[str, NDArray]:
    """Weights and biases as :mod:`recon.convolution` reads them, float16."""
    found: dict[str, Tensor] = {}
    for name, layer in layers.items():
        weight = layer.weight.permute(2, 3, 1, 0)
        found |= {name: weight[0, 0] if weight.shape[:2] == (1, 1) else weight, f"{name}_bias": layer.bias}
    return {name: value.detach().numpy().astype(np.float16) for name, value in found.items()}


def constant_arrays(constants: Mapping[str, Tensor]) -> dict[str, NDArray]:
    """Constants per channel as :mod:`recon.convolution` reads them, float32."""
    return {name: value.flatten().numpy().astype(np.float32) for name, value in constants.items()}
