"""A noise model of one's own: noise of the columns' amplifiers and random telegraph signals.

    dasim render desk --noise examples/noise_model.py:column_and_telegraph --out shot

or, in Python, ``dasim.simulate(scene, camera, noise=column_and_telegraph)``. See ``dasim.camera.noise.NoiseModel``.
"""

import numpy as np

from dasim.camera import noise

COLUMN_E = 2.0  # standard deviation of a column's offset in one frame, electrons
TELEGRAPH_SHARE, TELEGRAPH_E = 0.01, 20.0  # pixels with a trap in the amplifier, and the size of its step


def column_and_telegraph(mean_e, sensor, time_s, seed, gain):
    """Raw numbers uint16 [h, w] of mean electrons [h, w], and how many pixels are saturated."""
    random = np.random.default_rng((seed, 1))
    electrons = random.poisson(mean_e + noise.dark_e(sensor, time_s)).astype(float)
    full = electrons >= sensor.full_well_e
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += random.normal(0.0, sensor.read_noise_e, mean_e.shape)
    electrons += random.normal(0.0, COLUMN_E, mean_e.shape[1])  # one offset for each column
    trap = random.random(mean_e.shape) < TELEGRAPH_SHARE
    electrons += TELEGRAPH_E * trap * random.integers(0, 2, mean_e.shape)  # empty or filled in this frame

    raw = np.rint(electrons / noise.electrons_per_dn(sensor, gain)) + sensor.black_level_dn
    top = 2**sensor.adc_bits - 1
    return np.clip(raw, 0, top).astype(np.uint16), int(np.count_nonzero(full | (raw >= top)))
