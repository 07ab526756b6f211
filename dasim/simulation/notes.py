"""Notes on a frame: saturation, approximations, and rendering noise beside the sensor's.

Tested in tests/dasim/simulation/test_exposure.py and tests/dasim/simulation/test_simulate.py.
"""

from __future__ import annotations

from typing import Any

NOTED_NOISE = 0.5  # rendering noise over the sensor's own, in one pixel of twenty, from which a note says so
# Samples per pixel below which ratios of few rays are noted: silhouettes are off by 1.5 % at 8, 3.5 at 4, 7 at 2.
UNBIASED_SPP = 8
NOTED_SATURATION = 0.05  # share of saturated pixels from which a note says so


def frame_notes(about: dict[str, Any], saturated: float) -> list[str]:
    """Notes on a frame: the share ``saturated`` of its pixels, approximations, and rendering noise beside the sensor's.

    ``about`` has the entries of the provenance on sampling.
    """
    notes = [f"{saturated:.0%} of the pixels are saturated"] if saturated > NOTED_SATURATION else []
    return notes + sampling_notes(about)


def sampling_notes(sampling: dict[str, Any]) -> list[str]:
    """Notes on an approximation, on much rendering noise, and where its target was not reached."""
    notes = []
    if "airy_errors" in sampling:
        worst = {name: max(row) for name, row in sampling["airy_errors"]["encircled_energy"].items()}
        listed = ", ".join(f"{name} {value:.2f}" for name, value in worst.items())
        notes.append(
            f"diffraction 'airy' is approximate: encircled energy is off by up to {listed} (by level in meta.json); "
            "a JIT variant renders 'wave'"
        )
    spp = sampling.get("spp")
    if sampling.get("diffraction") == "wave" and isinstance(spp, int) and spp < UNBIASED_SPP:
        notes.append(
            f"{spp} samples per pixel are few: beside steps in depth, light is off by some per cent beyond its noise; "
            f"take {UNBIASED_SPP} or more"
        )
    wanted = sampling.get("rendering_noise_share_wanted")
    if wanted is None:
        return notes + noise_notes(sampling)
    reached = sampling.get("rendering_noise_share_reached", {})
    missed = {name: share for name, share in reached.items() if share > wanted}
    if missed:
        listed = ", ".join(f"{name} {share:.2f}" for name, share in missed.items())
        samples, at = max(sampling["spp"].values()), sampling["rendering_noise_at"]
        notes.append(
            f"{samples} samples were not enough: rendering noise over the sensor's own is {listed} at percentile "
            f"{at:g} of the pixels, above the target of {wanted:g}; render again with a larger --spp, or raise "
            "--noise-share"
        )
    return notes


def noise_notes(sampling: dict[str, Any]) -> list[str]:
    """A note where a given number of samples leaves rendering noise above half of the sensor's in many pixels."""
    shares = sampling.get("rendering_noise_share", {})
    high = {name: share for name, share in shares.get("95", {}).items() if share > NOTED_NOISE}
    if not high:
        return []
    listed = ", ".join(f"{name} {share:.2f} (median {shares['50'][name]:.2f})" for name, share in high.items())
    return [
        f"rendering noise exceeds half of the sensor's own at percentile 95 of the pixels: {listed}, with "
        f"{sampling['spp']} samples; take more, or spp 'auto' with noise_at 95 (--spp auto --noise-at 95)"
    ]
