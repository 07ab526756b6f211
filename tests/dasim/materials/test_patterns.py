"""Procedural images have their stated statistics, are the same in every run, and do not alias."""

from __future__ import annotations

import hashlib
import itertools
import subprocess
import sys

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.materials import patterns
from dasim.materials.patterns import PATTERNS, SIZE_PX, pattern

HALF = 0.01  # of the mean of a pattern that is half bright: pixels on its edges


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns_are_weights_with_contrast(name):
    image = pattern(name)
    assert image.shape == (SIZE_PX, SIZE_PX) and image.dtype == np.float32
    assert image.min() >= 0 and image.max() <= 1 and np.isfinite(image).all()
    low, high = np.percentile(image, (1, 99))
    assert high - low > 0.5, "a texture that can be seen out of focus"


def test_patterns_are_the_same_in_every_run_and_differ_by_their_number():
    """Expectation: equal bytes in another process; other bytes for another number."""
    names = ["dead-leaves:3", "noise:1", "skin", "wood-grain:2"]
    program = (
        "import hashlib, sys; from dasim.materials.patterns import pattern\n"
        "for name in sys.argv[1:]: print(hashlib.sha256(pattern(name).tobytes()).hexdigest())"
    )
    done = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [hashlib.sha256(pattern(name).tobytes()).hexdigest() for name in names]
    for name, other in (("dead-leaves:3", "dead-leaves:4"), ("weave:10", "weave:20"), ("leaf-veins:4", "leaf-veins")):
        assert not np.array_equal(pattern(name), pattern(other))


def test_default_number_is_one_of_the_numbers():
    for name, kind in PATTERNS.items():
        assert pattern(name) is pattern(f"{name}:{kind.default}")


def test_checkerboard_has_its_squares():
    image = pattern("checkerboard:4")
    centres = (np.arange(4) * 2 + 1) * SIZE_PX // 8
    expected = np.add.outer(np.arange(4), np.arange(4)) % 2
    np.testing.assert_array_equal(image[np.ix_(centres, centres)], expected)
    assert image.mean() == pytest.approx(0.5, abs=HALF)


def test_stripes_run_upright_and_area_sampling_keeps_their_mean():
    """Set-up: 3 pairs, whose edges fall inside pixels (1024 / 6). Expectation: the mean in each column pair, and
    edge pixels that are neither black nor white.
    """
    image = pattern("stripes:3")
    assert np.ptp(image, axis=0).max() == 0
    assert np.count_nonzero(np.diff(np.sign(image[0] - 0.5))) == 5
    assert image.mean() == pytest.approx(0.5, abs=1e-3)
    assert ((image > 0) & (image < 1)).any()


@pytest.mark.parametrize("sectors", [8, 36])
def test_siemens_star_has_its_sectors_at_every_radius(sectors):
    """Expectation: along circles, the strongest frequency is the number of sectors, in phase."""
    image = pattern(f"siemens-star:{sectors}")
    turn = np.linspace(0, 2 * np.pi, 2048, endpoint=False)
    for radius in (0.2, 0.35, 0.48):
        place = ((0.5 + radius * np.stack([np.sin(turn), np.cos(turn)])) * SIZE_PX - 0.5).round().astype(int)
        spectrum = np.fft.rfft(image[place[0], place[1]] - 0.5)
        assert np.argmax(np.abs(spectrum)) == sectors
        assert np.angle(spectrum[sectors]) == pytest.approx(-np.pi / 2, abs=0.1)
    middle = SIZE_PX // 2
    assert image[middle, middle] == 0.5, "grey where nothing is resolved"


def test_dead_leaves_are_even_in_grey_and_alike_at_every_scale():
    """Expectation: mean and deviation of even grey levels, 1/2 and 1/sqrt(12) less edges; power that falls as about
    the second power of the frequency (Lee, Mumford and Huang 2001).
    """
    image = pattern("dead-leaves:0").astype(float)
    assert image.mean() == pytest.approx(0.5, abs=0.05)
    assert image.std() == pytest.approx(12**-0.5, rel=0.1)
    window = np.outer(np.hanning(SIZE_PX), np.hanning(SIZE_PX))
    power = np.abs(np.fft.fft2((image - image.mean()) * window)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIZE_PX), np.fft.fftfreq(SIZE_PX)))
    edges = np.geomspace(0.01, 0.1, 8)
    centres = np.sqrt(edges[1:] * edges[:-1])
    mean = [power[(frequency >= low) & (frequency < high)].mean() for low, high in itertools.pairwise(edges)]
    slope = np.polyfit(np.log(centres), np.log(mean), 1)[0]
    assert -3.0 < slope < -1.5


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("dead-leafs", ["'pattern:dead-leafs'", "siemens-star", "did you mean 'dead-leaves'"]),
        ("stripes:0", ["'pattern:stripes:0'", "pairs of stripes", "from 1 to 256"]),
        ("stripes:", ["pairs of stripes"]),
        ("stripes:4.5", ["must be whole"]),
        ("noise:-1", ["seed"]),
        ("", ["there are"]),
    ],
)
def test_a_pattern_that_is_none_is_refused(name, message):
    with pytest.raises(InputError) as caught:
        patterns.pattern(name)
    for part in message:
        assert part in str(caught.value)
