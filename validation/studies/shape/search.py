"""Search for the mask of the near-infrared stop: a grey or binary mask of a given light budget, by gradients.

Topology optimisation with projection (Wang, Lazarov and Sigmund, Struct. Multidiscip. Optim. 43, 2011): the latent
values x of the cells are averaged over a cone of the smallest feature's radius, y = F x, and projected to amplitudes

    a = 1 / (1 + exp(-2 beta (y - eta))),

with eta chosen at every step such that the mask has exactly its light budget. The search is then unconstrained except
for 0 <= x <= 1 (L-BFGS-B). beta rises until the mask is nearly binary; the mask is then thresholded at its light
budget, opened and closed by a disc of the smallest feature's diameter. A grey mask stays at a small beta, with latent
values unbounded. Closed parts need no bridges: the stop is a coating on glass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage, optimize, special

from dasim.camera import stops
from dasim.typing import FloatArray, ShareDone
from validation.studies.shape import free_stop, masks
from validation.studies.shape.designs import Design
from validation.studies.shape.free_stop import FreeStop

Symmetry = Literal["none", "half-turn"]

SHARPNESS = (2.0, 4.0, 8.0, 16.0, 32.0)  # beta, in this order; y is within 0..1
GREY_SHARPNESS = 2.0


@dataclass(frozen=True)
class Search:
    """A search: its mask and its effort."""

    cells: int  # across the lens
    budget: float  # open area over that of the lens
    feature_cells: float  # diameter of the smallest feature
    grey: bool = False
    symmetry: Symmetry = "none"
    iterations: int = 20  # at each beta


def optimised(stop: FreeStop, search: Search, seed: int, progress: ShareDone = lambda share: None) -> Design:
    """The mask found from one start: seed 0 a disc, 1 a ring, 2 a disc at the rim, others random."""
    x = start(search, seed)
    whole = masks.inside(search.cells)
    history: list[float] = []
    steps: list[int] = []
    stages = (GREY_SHARPNESS,) if search.grey else SHARPNESS
    rounds = search.iterations * (len(SHARPNESS) if search.grey else 1)
    bounds = None if search.grey else [(0.0, 1.0)] * int(whole.sum())
    for number, beta in enumerate(stages):
        steps.append(len(history))

        def cost(values: FloatArray, beta: float = beta, number: int = number) -> tuple[float, FloatArray]:
            latent = np.zeros(whole.shape)
            latent[whole] = values
            amplitude, back = projected(latent, search, beta)
            logarithm, slope = free_stop.value_and_gradient(stop, amplitude)
            history.append(float(np.exp(logarithm)))
            progress(min((number + (len(history) - steps[-1]) / (1.3 * rounds)) / len(stages), 1.0))
            return logarithm, back(slope)[whole]

        limits = {"maxiter": rounds, "maxfun": 2 * rounds}
        x[whole] = optimize.minimize(cost, x[whole], jac=True, bounds=bounds, method="L-BFGS-B", options=limits).x
    amplitude = projected(x, search, stages[-1])[0] if search.grey else thresholded(filtered(x, search), search)
    kind = "grey" if search.grey else "binary"
    symmetric = ", symmetric" if search.symmetry == "half-turn" else ""
    return Design(f"{kind}{symmetric}, seed {seed}", amplitude, tuple(history), tuple(steps))


def start(search: Search, seed: int) -> FloatArray:
    """Initial latent values of a seed, 0..1, [cells, cells]."""
    random = np.random.default_rng((seed, search.cells))
    place = stops.cell_centres(search.cells)
    radius = np.hypot(place[:, None], place[None, :])
    alpha = np.sqrt(search.budget)
    if seed == 0:
        bump = 1 - radius / (2 * alpha)
    elif seed == 1:
        bump = 1 - np.abs(radius - (1 + np.sqrt(np.clip(1 - search.budget, 0, 1))) / 2)
    elif seed == 2:
        bump = 1 - np.hypot(place[:, None], place[None, :] - (1 - alpha)) / (2 * alpha)
    else:
        bump = ndimage.gaussian_filter(random.normal(size=radius.shape), search.cells / random.uniform(8, 24))
        bump = 0.5 + 0.2 * bump / bump.std()
    bump = bump + random.normal(0, 0.02, radius.shape)
    return np.clip(bump, 0.02, 0.98) * masks.inside(search.cells)


def filtered(latent: FloatArray, search: Search) -> FloatArray:
    """Latent values y averaged over a cone of the smallest feature's radius, within the lens, [cells, cells]."""
    whole = masks.inside(len(latent)).astype(np.float64)
    if search.symmetry == "half-turn":
        latent = (latent + latent[::-1, ::-1]) / 2
    cone = _cone(search.feature_cells)
    weight = np.maximum(ndimage.convolve(whole, cone, mode="constant"), 1e-12)
    return np.asarray(ndimage.convolve(latent * whole, cone, mode="constant") / weight * whole)


def _filter_adjoint(slope: FloatArray, search: Search) -> FloatArray:
    """Adjoint of :func:`filtered`: gradient by y to gradient by latent value."""
    whole = masks.inside(len(slope)).astype(np.float64)
    cone = _cone(search.feature_cells)
    weight = np.maximum(ndimage.convolve(whole, cone, mode="constant"), 1e-12)
    back = ndimage.convolve(slope * whole / weight, cone, mode="constant") * whole
    return np.asarray((back + back[::-1, ::-1]) / 2 if search.symmetry == "half-turn" else back)


def _cone(diameter: float) -> FloatArray:
    """Weights that fall linearly to 0 at the radius; at least the cell itself."""
    radius = max(diameter / 2, 0.51)
    reach = int(np.ceil(radius))
    place = np.arange(-reach, reach + 1)
    return np.clip(radius - np.hypot(place[:, None], place[None, :]), 0.0, None)


def projected(latent: FloatArray, search: Search, beta: float) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
    """Amplitudes of exactly the light budget, and the adjoint: gradient by amplitude to gradient by latent value.

    eta changes with y such that the budget stays constant: d eta = sum(a h dy) / sum(a h), h = da/dy.
    """
    whole = masks.inside(len(latent))
    y = filtered(latent, search)[whole]
    cell = (2 / search.cells) ** 2 / np.pi

    def excess(eta: float) -> float:
        return float((special.expit(2 * beta * (y - eta)) ** 2).sum() * cell - search.budget)

    reach = 20 / beta
    eta = optimize.brentq(excess, float(y.min()) - reach, float(y.max()) + reach, xtol=1e-13)
    inner = special.expit(2 * beta * (y - eta))
    amplitude = np.zeros(whole.shape)
    amplitude[whole] = inner
    h = 2 * beta * inner * (1 - inner)

    def back(slope: FloatArray) -> FloatArray:
        half_slope = slope[whole]
        by_filtered = np.zeros(whole.shape)
        by_filtered[whole] = h * (half_slope - (half_slope * h).sum() / max((inner * h).sum(), 1e-300) * inner)
        return _filter_adjoint(by_filtered, search)

    return amplitude, back


def thresholded(smooth: FloatArray, search: Search) -> FloatArray:
    """The binary mask closest to the light budget: a threshold of ``smooth``, opened and closed by the feature size."""
    whole = masks.inside(len(smooth))
    diameter = max(1, int(np.ceil(search.feature_cells - 0.05)))  # an excess of a twentieth of a cell is ignored
    levels = np.unique(smooth[whole])[::-1]

    def at_level(index: int) -> FloatArray:
        return masks.smoothed((smooth >= levels[index]) & whole, diameter, whole).astype(np.float64)

    low, high = 0, len(levels) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if masks.budget(at_level(middle)) <= search.budget else (low, middle)
    return min((at_level(low), at_level(high)), key=lambda mask: abs(masks.budget(mask) - search.budget))


def best_of(stop: FreeStop, search: Search, seeds: Sequence[int], progress: ShareDone) -> Design:
    """The best mask of several starts."""
    designs = []
    for number, seed in enumerate(seeds):
        designs.append(optimised(stop, search, seed, lambda share, n=number: progress((n + share) / len(seeds))))  # type: ignore[misc]
    return min(designs, key=lambda design: free_stop.value(stop, design.amplitude))
