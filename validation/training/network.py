"""What the networks of the training have in common; needs the extra ``learn`` (PyTorch).

Tested in tests/validation/training/test_fit_levels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

LARGEST_GRADIENT = 1.0  # norm of a step's gradient
FURTHER_RATE = 0.3  # rate of a network that is trained on, relative to a new one's


N = TypeVar("N", bound=nn.Module)


class Training(NamedTuple):
    """AdamW with one cycle of the rate (Smith and Topin, 2019).

    Attributes:
        rate: largest learning rate.
        decay: of the weights.
        warm_up: share of the steps in which the rate rises.
    """

    rate: float
    decay: float
    warm_up: float


def train(
    net: N,
    training: Training,
    passes: Iterable[Iterable[tuple[Any, ...]]],
    steps: int,
    loss_of: Callable[..., Tensor],
    report: Callable[[int, float, N], None],
) -> None:
    """Fit a network in place.

    Args:
        net: the network.
        training: rates.
        passes: the batches of each pass over the examples.
        steps: number of all batches.
        loss_of: loss of a batch, whose parts are the arguments.
        report: gets the number of the pass from 0, its mean loss and the network after it, which is set to evaluation.
    """
    net.to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), training.rate, weight_decay=training.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, training.rate, total_steps=steps, pct_start=training.warm_up
    )
    for number, batches in enumerate(passes):
        net.train()
        losses = []
        for batch in batches:
            value = loss_of(*batch)
            optimiser.zero_grad()
            value.backward()
            nn.utils.clip_grad_norm_(net.parameters(), LARGEST_GRADIENT)
            optimiser.step()
            schedule.step()
            losses.append(value.detach())  # a number of Python would wait for the device
        net.eval()
        report(number, float(torch.stack(losses).mean()), net)


def further(training: Training) -> Training:
    """How a trained network is trained on: at a lower rate."""
    return training._replace(rate=FURTHER_RATE * training.rate)


def average(net: nn.Module, before: nn.Module) -> None:
    """Set the weights of a network that was trained on to the mean of those and the ones ``before``, which forgets less
    of the first training (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).
    """
    with torch.no_grad():
        for weight, other in zip(net.parameters(), before.parameters(), strict=True):
            weight.lerp_(other, 0.5)


def reduced(device: str) -> torch.autocast:
    """The layers' precision in training on a device, by PyTorch's name."""
    return torch.autocast(torch.device(device).type, dtype=torch.bfloat16)


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
    return {name: value.detach().cpu().numpy().astype(np.float16) for name, value in found.items()}


def set_layers(layers: nn.ModuleDict, arrays: Mapping[str, NDArray]) -> None:
    """Set weights and biases to those of :func:`layer_arrays`."""
    for name, layer in layers.items():
        weight = torch.tensor(arrays[name].astype(np.float32))
        weight = weight if weight.ndim == 4 else weight[None, None]
        layer.weight.copy_(weight.permute(3, 2, 0, 1))
        layer.bias.copy_(torch.tensor(arrays[f"{name}_bias"].astype(np.float32)))


def constant_arrays(constants: Mapping[str, Tensor]) -> dict[str, NDArray]:
    """Constants per channel as :mod:`recon.convolution` reads them, float32."""
    return {name: value.flatten().cpu().numpy().astype(np.float32) for name, value in constants.items()}
