"""Rebuilt codes, against random patterns by the criteria of their papers."""

from __future__ import annotations

import numpy as np

from validation.studies.shape import published_codes


def test_published_codes_are_the_best_of_their_searches() -> None:
    """Each beats all of 200 random patterns of its kind by its own criterion; their sizes are the papers'."""
    random = np.random.default_rng(0)
    code = published_codes.zhou_nayar()
    others = (random.random((200, 13, 13)) < 0.5).astype(float)
    assert published_codes._deblurring_error(code[None])[0] < published_codes._deblurring_error(others).min()
    assert published_codes._least_divergence(published_codes.levin()) > max(
        map(published_codes._least_divergence, others[:100])
    )
    seven = published_codes.veeraraghavan()
    assert seven.shape == (7, 7)
    assert seven.sum() in (24, 25)
    spectrum = np.abs(np.fft.rfft2(others[:, :7, :7], (16, 16))).min(axis=(1, 2)) / others[:, :7, :7].sum(axis=(1, 2))
    assert np.abs(np.fft.rfft2(seven, (16, 16))).min() / seven.sum() > spectrum.max()
