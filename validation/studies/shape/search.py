"""Search for the shape of the near-infrared stop: grey or binary masks of a given light budget, by gradients.

As in topology optimisation (Wang, Lazarov and Sigmund, Struct. Multidiscip. Optim. 43, 2011): latent values x of the
cells are averaged over a cone of the smallest feature's radius, y = F x, and projected to amplitudes

    a = 1 / (1 + exp(-2 beta (y - eta))),

eta such that the mask has its light budget, exactly and at every step; so the search itself is free of constraints
but 0 <= x <= 1 (L-BFGS-B). beta rises until the mask is black and white; then it is cut at eta, opened and closed by a
disc of the smallest feature's diameter. A grey mask stays at a small beta, its latent values unbounded. A closed part
needs no bridge: the stop is a coating on glass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import ndimage, optimize, special

from dasim.base.errors import InputError
from dasim.camera import stops
from dasim.typing import FloatArray, ShareDone
from validation.studies import criteria
from validation.studies.criteria import Bench
from validation.studies.shape import masks

Symmetry = Literal["none", "half-turn"]

SHARPNESS = (2.0, 4.0, 8.0, 16.0, 32.0)  # beta, one after the other; y is of 0..1
GREY_SHARPNESS = 2.0
SMALLEST_BUDGET, LARGEST_BUDGET = 0.01, 0.95


@dataclass(frozen=True)
class Design:
    """A mask and how it was found."""

    name: str
    amplitude: FloatArray
    history: tuple[float, ...] = ()  # of the objective, each step
    steps: tuple[int, ...] = ()  # of the history, where beta rose


@dataclass(frozen=True)
class Search:
    """What is searched for."""

    cells: int
    budget: float
    feature_cells: float = 3.0  # diameter of the smallest feature
    grey: bool = False
    symmetry: Symmetry = "none"
    iterations: int = 25  # at each beta


def check(search: Search) -> None:
    """InputError that names all that is wrong with a search."""
    wrong = []
    if not 8 <= search.cells <= stops.MOST_MASK_CELLS:
        wrong.append(f"cells {search.cells}: must be 8 to {stops.MOST_MASK_CELLS} across the lens")
    if not SMALLEST_BUDGET <= search.budget <= LARGEST_BUDGET:
        wrong.append(
            f"budget {search.budget:g}: must be {SMALLEST_BUDGET:g} to {LARGEST_BUDGET:g} of the lens's area; "
            "less lets no light through, more leaves no shape"
        )
    if not 1 <= search.feature_cells <= max(search.cells, 8) / 2:
        wrong.append(f"feature of {search.feature_cells:g} cells: must be one cell or more, and at most half the lens")
    if search.iterations < 1:
        wrong.append(f"iterations {search.iterations}: must be 1 or more")
    if wrong:
        raise InputError("; ".join(wrong))


def found(at: Bench, search: Search, seed: int, progress: ShareDone = lambda share: None) -> Design:
    """The mask that a start leads to: seed 0 a disc, 1 a ring, 2 a disc at the rim, others random."""
    check(search)
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
            one, slope = criteria.value_and_gradient(at, amplitude)
            history.append(float(np.exp(one)))
            progress(min((number + (len(history) - steps[-1]) / (1.3 * rounds)) / len(stages), 1.0))
            return one, back(slope)[whole]

        limits = {"maxiter": rounds, "maxfun": 2 * rounds}
        x[whole] = optimize.minimize(cost, x[whole], jac=True, bounds=bounds, method="L-BFGS-B", options=limits).x
    amplitude = projected(x, search, stages[-1])[0] if search.grey else cut(filtered(x, search), search)
    kind = "grey" if search.grey else "binary"
    turned = ", symmetric" if search.symmetry == "half-turn" else ""
    return Design(f"{kind}{turned}, seed {seed}", amplitude, tuple(history), tuple(steps))


def start(search: Search, seed: int) -> FloatArray:
    """Latent values to begin with, [cells, cells]."""
    random = np.random.default_rng((seed, search.cells))
    place = stops.cell_centres(search.cells)
    radius = np.hypot(place[:, None], place[None, :])
    own = np.sqrt(search.budget)
    if seed == 0:
        bump = 1 - radius / (2 * own)
    elif seed == 1:
        bump = 1 - np.abs(radius - (1 + np.sqrt(np.clip(1 - search.budget, 0, 1))) / 2)
    elif seed == 2:
        bump = 1 - np.hypot(place[:, None], place[None, :] - (1 - own)) / (2 * own)
    else:
        bump = ndimage.gaussian_filter(random.normal(size=radius.shape), search.cells / random.uniform(8, 24))
        bump = 0.5 + 0.2 * bump / bump.std()
    bump = bump + random.normal(0, 0.02, radius.shape)
    return np.clip(bump, 0.02, 0.98) * masks.inside(search.cells)


def filtered(latent: FloatArray, search: Search) -> FloatArray:
    """Latent values averaged over a cone of the feature's radius, within the lens."""
    whole = masks.inside(len(latent)).astype(np.float64)
    if search.symmetry == "half-turn":
        latent = (latent + latent[::-1, ::-1]) / 2
    cone = _cone(search.feature_cells)
    weight = np.maximum(ndimage.convolve(whole, cone, mode="constant"), 1e-12)
    return np.asarray(ndimage.convolve(latent * whole, cone, mode="constant") / weight * whole)


def _filter_back(slope: FloatArray, search: Search) -> FloatArray:
    whole = masks.inside(len(slope)).astype(np.float64)
    cone = _cone(search.feature_cells)
    weight = np.maximum(ndimage.convolve(whole, cone, mode="constant"), 1e-12)
    back = ndimage.convolve(slope * whole / weight, cone, mode="constant") * whole
    return np.asarray((back + back[::-1, ::-1]) / 2 if search.symmetry == "half-turn" else back)


def _cone(diameter: float) -> FloatArray:
    radius = max(diameter / 2, 0.51)
    reach = int(np.ceil(radius))
    place = np.arange(-reach, reach + 1)
    return np.clip(radius - np.hypot(place[:, None], place[None, :]), 0.0, None)


def projected(latent: FloatArray, search: Search, beta: float) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
    """Amplitudes with exactly the light budget, and the adjoint: gradient by amplitude to gradient by latent value.

    As eta moves with y so that the budget stays: d eta = sum(a h dy) / sum(a h), h = da/dy.
    """
    whole = masks.inside(len(latent))
    y = filtered(latent, search)[whole]
    cell = (2 / search.cells) ** 2 / np.pi

    def over(eta: float) -> float:
        return float((special.expit(2 * beta * (y - eta)) ** 2).sum() * cell - search.budget)

    reach = 20 / beta
    eta = optimize.brentq(over, float(y.min()) - reach, float(y.max()) + reach, xtol=1e-13)
    inner = special.expit(2 * beta * (y - eta))
    amplitude = np.zeros(whole.shape)
    amplitude[whole] = inner
    h = 2 * beta * inner * (1 - inner)

    def back(slope: FloatArray) -> FloatArray:
        own = slope[whole]
        along = np.zeros(whole.shape)
        along[whole] = h * (own - (own * h).sum() / max((inner * h).sum(), 1e-300) * inner)
        return _filter_back(along, search)

    return amplitude, back


def cut(smooth: FloatArray, search: Search) -> FloatArray:
    """The binary mask of the light budget: opened and closed by the smallest feature, at the level that gives it."""
    whole = masks.inside(len(smooth))
    diameter = max(1, int(np.ceil(search.feature_cells - 0.05)))  # a twentieth of a cell is no feature
    levels = np.unique(smooth[whole])[::-1]

    def at_level(index: int) -> FloatArray:
        return masks.smoothed((smooth >= levels[index]) & whole, diameter, whole).astype(np.float64)

    low, high = 0, len(levels) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if masks.budget(at_level(middle)) <= search.budget else (low, middle)
    return min((at_level(low), at_level(high)), key=lambda mask: abs(masks.budget(mask) - search.budget))


def best_of(at: Bench, search: Search, seeds: Sequence[int], progress: ShareDone = lambda share: None) -> list[Design]:
    """The masks of several starts, best first."""
    if not seeds:
        raise InputError("seeds: none; one start or more is needed")
    designs = []
    for number, seed in enumerate(seeds):
        designs.append(found(at, search, seed, lambda share, n=number: progress((n + share) / len(seeds))))  # type: ignore[misc]
    return sorted(designs, key=lambda design: criteria.value(at, design.amplitude))


def disc_name(budget: float) -> str:
    """What the disc of a light budget is called."""
    return f"disc {np.sqrt(budget):.2f}"


AT_RIM = "disc at the rim"  # moved as far out as it goes: infrared then shifts with defocus, and stays as sharp


def references(cells: int, budget: float) -> list[Design]:
    """What a search is compared with: the disc, rings, a disc at the rim, and published codes, at the same budget."""
    from validation.studies.shape import published_codes

    alpha = float(np.sqrt(budget))
    designs = [Design(disc_name(budget), masks.disc(cells, budget))]
    for inner in (0.25, 0.5, 0.75):
        if inner**2 + budget <= 1:
            designs.append(Design(f"ring from {inner:g}", masks.annulus(cells, budget, inner)))
    designs.append(Design(AT_RIM, masks.disc(cells, budget, (1 - alpha, 0.0))))
    # Two windows at opposite ends of the lens: a stereo pair in one lens, its two pictures on top of each other.
    half = budget / 2
    apart = 1 - float(np.sqrt(half))
    if apart > np.sqrt(half):
        two = masks.disc(cells, half, (apart, 0.0)) + masks.disc(cells, half, (-apart, 0.0))
        designs.append(Design("two discs at the rim", two))
    published = {
        "Levin 2007, rebuilt": published_codes.levin,
        "Veeraraghavan 2007, rebuilt": published_codes.veeraraghavan,
        "Zhou & Nayar 2009, rebuilt": published_codes.zhou_nayar,
    }
    designs += [Design(name, masks.square(code(), cells, budget)) for name, code in published.items()]
    return designs + [
        Design(f"{name}, as large as fits", masks.square(code(), cells))
        for name, code in published.items()
        if masks.budget(masks.square(code(), cells)) > 1.05 * budget
    ]


def ring_search(at: Callable[[int, float], Bench], cells: int, budget: float, count: int = 25) -> Design:
    """The ring of a light budget with the least objective, by its inner radius; 0 is a disc."""
    largest = float(np.sqrt(1 - budget))
    values = []
    for inner in np.linspace(0, largest, count):
        mask = masks.disc(cells, budget) if inner == 0 else masks.annulus(cells, budget, float(inner) * (1 - 1e-9))
        values.append((criteria.value(at(cells, budget), mask), float(inner), mask))
    _, inner, mask = min(values, key=lambda one: one[0])
    return Design(f"best ring, from {inner:.2f}", mask)


def refined(design: Design, cells: int) -> Design:
    """The same mask on a grid of more cells, a multiple of its own."""
    times, rest = divmod(cells, len(design.amplitude))
    if rest or times < 1:
        raise ValueError("the finer grid must be a multiple of the mask's")
    fine = np.kron(design.amplitude, np.ones((times, times)))
    return replace(design, amplitude=np.where(masks.inside(cells), fine, 0.0))
