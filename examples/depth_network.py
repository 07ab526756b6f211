"""Train a small network on a dataset of one's own, and run it as a depth method.

python examples/depth_network.py DATASET WEIGHTS
DEPTH_NETWORK=WEIGHTS dasim dataset score DATASET --method mine=examples/depth_network.py:network best
"""

import os
import sys

import numpy as np
import torch
from torch import nn

import dasim
from dasim.values import Capture, DepthEstimate, PsfBank

WIDTH, BLOCKS = 32, 6
EPOCHS, BATCH, RATE = 40, 8, 1e-3


def planes(raw_dn: np.ndarray) -> torch.Tensor:
    """The four planes of a 2x2 mosaic as square roots, which makes photon noise even, [4, h/2, w/2]."""
    raw = np.sqrt(raw_dn.astype(np.float32) / 1024)
    return torch.from_numpy(np.stack([raw[y::2, x::2] for y in (0, 1) for x in (0, 1)]))


def model() -> nn.Module:
    """Convolutions of growing dilation: each estimate sees a square of 194 pixels of the frame."""
    layers: list[nn.Module] = [nn.Conv2d(4, WIDTH, 3, padding=1), nn.ReLU()]
    for block in range(BLOCKS):
        layers += [nn.Conv2d(WIDTH, WIDTH, 3, padding=2 ** min(block, 4), dilation=2 ** min(block, 4)), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(WIDTH, 1, 1))


def train(dataset: str, weights: str) -> None:
    """Fit the network to the levels of the split ``train``; NaN in the truth counts for nothing."""
    torch.manual_seed(0)
    samples = [
        (planes(s.raw_dn), torch.from_numpy(s.truth["level"][::2, ::2].astype(np.float32)))
        for s in dasim.open_dataset(dataset, "train")
    ]
    loader = torch.utils.data.DataLoader(samples, batch_size=BATCH, shuffle=True)
    net = model()
    optimiser = torch.optim.Adam(net.parameters(), RATE)
    for epoch in range(EPOCHS):
        errors = []
        for raw, level in loader:
            difference = (net(raw)[:, 0] - level).abs()
            loss = difference[difference.isfinite()].mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            errors.append(loss.item())
        print(f"epoch {epoch + 1}: mean error {np.mean(errors):.2f} levels", flush=True)
    torch.save(net.state_dict(), weights)


def network(capture: Capture, bank: PsfBank) -> DepthEstimate:
    """The blur level of each pixel by the trained network, whose file the variable DEPTH_NETWORK names."""
    net = model()
    net.load_state_dict(torch.load(os.environ["DEPTH_NETWORK"], weights_only=True))
    with torch.no_grad():
        level = net(planes(capture.raw_dn)[None])[0, 0].numpy()
    return DepthEstimate(level=np.maximum(level, 0).repeat(2, axis=0).repeat(2, axis=1))


if __name__ == "__main__":
    train(sys.argv[1], sys.argv[2])
