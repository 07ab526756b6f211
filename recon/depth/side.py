"""Which side of the focus a surface lies on, where axial colour makes the blur of both sides differ.

With a focal length that increases with wavelength, red and infrared are blurred more than green in front of the focus
and less behind it; blue behaves the other way round. The joint likelihood of all four channels
(:mod:`recon.depth.joint_likelihood`) is therefore computed at the levels of each side, and the difference between the
two largest values is the evidence for a side. The evidence of one window is weak, that of a whole surface is
sufficient: it is combined over neighbours (:mod:`recon.depth.surfaces`, with two states separated by a step) before a
side is chosen. Compare the ranking of blur in the colour channels by Trouve et al. (Applied Optics 52, 2013).

Without axial colour and with stops centred on the axis, both sides have the same kernels, and the near side is assumed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dasim.typing import BoolArray, Float32Array, FloatArray
from dasim.values import PsfBank, Side
from recon.depth import cross_spectra, evidence, surfaces
from recon.depth.best import Map
from recon.depth.channels import Channel, Leak, kernels_without_infrared
from recon.depth.cross_spectra import Window
from recon.depth.joint_likelihood import log_likelihood

# Small windows resolve narrow surfaces, large ones are better in dim light. Chosen on boards with other textures at
# levels -6 to 8, one or two boards at a time, at 1,000 and 30 lux.
WINDOWS = (Window(10.0, 8), Window(28.0, 8))  # at the same places
# Weight of the evidence of each window, relative to the evidence for a level: these windows are farther apart than
# those from which levels are combined.
WEIGHT = 1.5
APART = 1e3  # distance between the two states, levels: so large that only a step connects them
GUIDE_BLUR = 1.0  # standard deviation in samples
PRIOR_BEHIND = 0.2  # cameras are focused at what is near; a surface without evidence is in front


def probability_behind(
    near: Sequence[Channel], far: Sequence[Channel], leaks: Sequence[Leak], clipped: BoolArray, most: float
) -> Float32Array:
    """Probability that each sample of the planes lies behind the focus, [h, w].

    Args:
        near: R, G, B and IR with the kernels in front of the focus.
        far: with those behind it, from the focus outwards.
        leaks: infrared in R, G and B.
        clipped: samples that are clipped, [h, w].
        most: largest share of clipped samples in a window that counts.
    """
    planes, phases = [channel.plane for channel in near], [channel.phase for channel in near]
    variances, alpha = [channel.variance for channel in near], [leak.alpha for leak in leaks]
    measured = cross_spectra.measured(planes, phases, variances, alpha, WINDOWS)
    rows, columns = nodes = cross_spectra.nodes(near[-1].variance.shape, WINDOWS[0].step)
    tables = [_table(side, leaks) for side in (near, far)]
    found = np.zeros((len(rows), len(columns), 2), np.float32)
    for window, spectra in zip(WINDOWS, measured, strict=True):
        # All bands count in the fit: with four channels, those that tell the sides apart are the ones that fit badly.
        scores = [log_likelihood(spectra, table, reweighted=False).max(axis=-1) for table in tables]
        usable = evidence.share_in_window(clipped, window.sigma_px)[np.ix_(*nodes)] <= most + evidence.SHARE_ROUNDING
        found += np.float32(WEIGHT) * np.stack(scores, axis=-1) * usable[..., None]
    across, down = surfaces.step_probability(evidence.log_channels(near, GUIDE_BLUR)[:, rows[:, None], columns])
    joined = surfaces.posterior(found, np.array([0.0, APART]), across, down)
    behind = PRIOR_BEHIND * joined[..., 1]
    behind /= behind + (1 - PRIOR_BEHIND) * joined[..., 0]
    return evidence.on_samples(behind, nodes, near[-1].variance.shape)


def signed(near: Map, far: Map, behind: Float32Array) -> Map:
    """Signed levels, from the maps of either side and the probability ``behind`` of the far one, [h, w].

    The standard deviation holds the doubt about the side: with the probability q of the other side, at a distance d of
    levels, its square is (1 - q) sd^2 + q (sd'^2 + d^2).
    """
    level, sd = _chosen(near.level, near.sd, far.level, far.sd, behind)
    return Map(level, sd, *_chosen(near.window_level, near.window_sd, far.window_level, far.window_sd, behind))


def side_note(side: Side, level: NDArray, bank: PsfBank, method: str | None = None) -> str:
    """A sentence for the user on how the side of the focus is known; ``method`` is the name of a user's method."""
    focus_m = bank.camera.lens.focus_distance_m
    if side == "estimated":
        share, how = float((level < 0).mean()), f"by method '{method}'" if method else "from axial colour"
        return f"the side of the focus at {focus_m:g} m is estimated {how}: {share:.1%} of pixels behind it"
    why = "the bank has no levels behind it; only axial colour tells the sides apart"
    if bank.behind is not None:
        why = "this method does not tell the sides apart"
    return f"the side of the focus is assumed: everything is taken to be nearer than {focus_m:g} m ({why})"


def _table(channels: Sequence[Channel], leaks: Sequence[Leak]) -> FloatArray:
    """Expected cross-spectra at the levels of a side, and between them where they are few."""
    *visible, infrared = channels
    clean = [kernels_without_infrared(channel, leak, infrared) for channel, leak in zip(visible, leaks, strict=True)]
    kernels = np.stack([*clean, infrared.kernels], axis=1).astype(np.float32)
    levels = evidence.level_grid(len(kernels) - 1)
    levels = levels[levels <= len(kernels) - 1]
    low = np.minimum(levels.astype(int), len(kernels) - 2)
    part = (levels - low)[:, None, None, None].astype(np.float32)
    mixed = (1 - part) * kernels[low] + part * kernels[low + 1]
    return cross_spectra.expected(mixed, [channel.phase for channel in channels])


def _chosen(
    near: Float32Array, near_sd: Float32Array, far: Float32Array, far_sd: Float32Array, behind: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Signed level of the likelier side, and its standard deviation including the uncertainty about the side.

    The standard deviation is infinite where the likelier side is unknown. If that of the other side is infinite, as
    may happen with few levels, the distance between both sides alone accounts for the uncertainty about the side.
    """
    is_far = behind > 0.5
    level = np.where(is_far, -far, near)
    sd, other = np.where(is_far, far_sd, near_sd), np.where(is_far, near_sd, far_sd)
    doubt = np.minimum(behind, 1 - behind)
    other = np.where(np.isfinite(other), other, np.float32(0))
    return level, np.sqrt((1 - doubt) * sd**2 + doubt * (other**2 + (near + far) ** 2))
