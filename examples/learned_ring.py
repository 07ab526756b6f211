"""Learn the infrared stop of a camera together with a network that estimates blur from its pictures.

The stop is a ring of two numbers, its inner and outer radius; at first it is the disc of da-mobile. Each step draws
textured cards before textured boards, photographs them through the stop (with occlusion, infrared in the visible
pixels, and noise), and updates the radii and the weights of the network by gradient descent on one loss. The light that
a ring passes follows from its area. The same network with the disc is trained beside, and both are compared on new
pictures.

python examples/learned_ring.py [STEPS]      600 steps take some minutes; needs the extra 'learn'
"""

import json
import sys

import numpy as np
import torch
from torch import nn

import dasim
from dasim.camera.stops import Annulus, Disc
from dasim.differentiable import picture, stop

LIGHT, EXPOSURE_S, WHITE_E = "D65", 0.03, 3000.0  # electrons of white in green
BLURS_PX = np.linspace(1.0, 28.0, 10)  # visible blur diameters of cards and boards
SIDE, MARGIN, BATCH = 96, 16, 12  # pixels of a picture and of its border that is cut off, pictures of a step
CELLS, SOFT = 48, 0.03  # cells across the lens; width of the ring's soft edges in radii of the lens
RATE, RADIUS_RATE = 2e-3, 2e-3
ALONE = 1 / 3  # of the steps, in which the network learns alone: until then its gradient is no guide for the stop


class Lens:
    """da-mobile with a ring in place of its hole."""

    def __init__(self) -> None:
        self.camera = dasim.cropped(dasim.load_camera("da-mobile"), SIDE, SIDE)
        visible, hole = self.camera.stops
        self.free = stop.free_stop(self.camera, hole, LIGHT, BLURS_PX, CELLS, SIDE, fine_cells=CELLS)
        rest = self.camera.model_copy(update={"stops": (visible,)})
        self.fixed, self.fixed_e = stop.fixed_stops(rest, LIGHT, BLURS_PX, SIDE)
        place = (torch.arange(CELLS) + 0.5) * 2 / CELLS - 1
        self.radius = torch.hypot(place[:, None], place)

    def amplitude(self, radii: torch.Tensor) -> torch.Tensor:
        """The ring between two radii with soft edges, [CELLS, CELLS]."""
        inner, outer = radii
        light = torch.sigmoid((outer - self.radius) / SOFT) * torch.sigmoid((self.radius - inner) / SOFT)
        return light.sqrt() * (self.radius <= 1)

    def photographed(self, radii: torch.Tensor, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Planes of noisy pictures, [BATCH, 4, h, w], and the blur that their pixels see, [BATCH, h, w]."""
        generator = torch.Generator().manual_seed(seed)
        amplitude = self.amplitude(radii)
        signal = stop.electrons(self.free, amplitude)
        white = self.fixed_e + signal
        share = (signal / white)[:, None, None]
        transfer = share * stop.transfers(self.free, amplitude) + (1 - share) * self.fixed
        level = torch.randint(len(BLURS_PX), (BATCH, 2), generator=generator).sort(dim=1).values  # the card is nearer
        mask = torch.stack([torch.ones(BATCH, SIDE, SIDE), cards(generator)], dim=1)
        radiance = textures(generator) * (WHITE_E * white / self.fixed_e[1])[:, None, None]
        mean_e = picture.picture(radiance, mask, transfer[level])
        noisy = picture.noisy(mean_e, self.camera, EXPOSURE_S, generator=generator)
        blur = picture.nearest(mask, torch.tensor(BLURS_PX, dtype=torch.float32)[level])
        inner = slice(MARGIN, -MARGIN)
        return picture.planes(noisy[..., inner, inner], self.camera), blur[..., inner, inner][..., ::2, ::2]


def cards(generator: torch.Generator) -> torch.Tensor:
    """Half of each picture, on one side of a random line, [BATCH, SIDE, SIDE]."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, SIDE), torch.linspace(-1, 1, SIDE), indexing="ij")
    turn = 2 * torch.pi * torch.rand((BATCH, 1, 1), generator=generator)
    offset = torch.rand((BATCH, 1, 1), generator=generator) - 0.5
    return (y * turn.sin() + x * turn.cos() > offset).float()


def textures(generator: torch.Generator) -> torch.Tensor:
    """Grey textures of power 1 / f^2, [BATCH, 2, 1, SIDE, SIDE], about 0.4 of white."""
    f = torch.hypot(torch.fft.fftfreq(SIDE)[:, None], torch.fft.rfftfreq(SIDE)).clamp(min=1 / SIDE)
    spectrum = torch.fft.rfft2(torch.randn((BATCH, 2, SIDE, SIDE), generator=generator)) / f
    image = torch.fft.irfft2(spectrum, (SIDE, SIDE))
    image = (image - image.mean((-2, -1), keepdim=True)) / image.std((-2, -1), keepdim=True)
    return (0.4 + 0.15 * image).clamp(0.03, 1.0)[:, :, None]


def network() -> nn.Module:
    """Blur in pixels and the logarithm of its expected absolute error, from the logarithms of four planes."""
    width, layers = 24, [nn.Conv2d(4, 24, 3, padding=1), nn.ReLU()]
    for dilation in (1, 2, 4, 8):
        layers += [nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(width, 2, 1))


def estimated(net: nn.Module, planes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Blur and the logarithm of its expected absolute error, [BATCH, h, w]."""
    logarithms = torch.log(planes.clamp(min=1.0))
    blur, error = net(logarithms - logarithms.mean((-2, -1), keepdim=True)).unbind(1)
    return 10 + 10 * blur, error


def train(lens: Lens, steps: int, learn_stop: bool) -> tuple[torch.Tensor, nn.Module]:
    """Radii and network after a number of steps; the loss is minus the log likelihood of a Laplace distribution."""
    torch.manual_seed(0)
    net = network()
    radii = torch.tensor([-0.1, 0.46], requires_grad=learn_stop)  # below 0, the ring is a disc
    groups = [{"params": net.parameters(), "lr": RATE}, {"params": [radii], "lr": RADIUS_RATE}]
    optimiser = torch.optim.Adam(groups if learn_stop else groups[:1])
    for step in range(steps):
        planes, blur = lens.photographed(radii if step >= ALONE * steps else radii.detach(), step)
        found, error = estimated(net, planes)
        loss = (error + (found - blur).abs() * torch.exp(-error)).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if (step + 1) % 50 == 0:
            print(f"step {step + 1}: radii {radii[0]:.3f} to {radii[1]:.3f}, loss {loss:.3f}", flush=True)
    return radii.detach(), net


def mean_error(lens: Lens, radii: torch.Tensor, net: nn.Module, first_seed: int = 10**6, pictures: int = 20) -> float:
    """Mean absolute error of the blur in pixels, on pictures that no step has seen."""
    errors = []
    with torch.no_grad():
        for seed in range(first_seed, first_seed + pictures):
            planes, blur = lens.photographed(radii, seed)
            errors.append(float((estimated(net, planes)[0] - blur).abs().mean()))
    return float(np.mean(errors))


def main(steps: int) -> None:
    """Train with the disc and with a free ring, and print both errors and the ring as a camera file states it."""
    lens = Lens()
    for name, learn_stop in (("disc", False), ("ring", True)):
        radii, net = train(lens, steps, learn_stop)
        error = mean_error(lens, radii, net)
        print(f"{name}: radii {max(float(radii[0]), 0):.3f} to {radii[1]:.3f}, mean error {error:.2f} px")
    inner, outer = (round(float(radius), 3) for radius in radii.clamp(0, 1))
    if inner > 0:
        made = Annulus(name="hole", shape="annulus", inner_ratio=inner, outer_ratio=outer, passes_nm=((650, 830),))
    else:
        made = Disc(name="hole", radius_ratio=outer, passes_nm=((650, 830),))
    keys = ("name", "shape", "radius_ratio") if inner == 0 else ("name", "shape", "inner_ratio", "outer_ratio")
    print(
        "[[stops]]",
        *(f"{key} = {json.dumps(getattr(made, key))}" for key in keys),
        "passes_nm = [[650, 830]]",
        sep="\n",
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 600)
