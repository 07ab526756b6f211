"""The derivatives of Chakrabarti and Zickler's score."""

import numpy as np

from recon.depth import colour_line


def test_the_four_derivatives_are_those_of_a_turned_grid():
    """At every frequency the two diagonal derivatives together have the energy of those along x and y; the published
    pair does not.
    """
    shape = (32, 48)
    right = colour_line.directional(shape, "right")
    power = [np.abs(f) ** 2 for f in right]
    np.testing.assert_allclose(power[0] + power[1], power[2] + power[3], atol=1e-5)
    wrong = [np.abs(f) ** 2 for f in colour_line.directional(shape, "published")]
    assert np.abs(wrong[0] + wrong[1] - wrong[2] - wrong[3]).max() > 0.1
