"""Frames divided into tiles have the same levels as undivided ones."""

import numpy as np
import pytest

from recon.depth import raw_levels, scores, tiles
from recon.depth.channels import Channel, Leak
from recon.picture import mosaic
from recon.settings import PRESETS
from tests.support import recon_scenes

# Levels, and the share of the confident samples that keeps within; the rest are near ties. Far below an estimate's own
# error of 0.1 to 0.5. The likelihood has a constant that depends a little on the grid of frequencies; the colour
# line's filters are not limited to a band and reach farther, and so do those of narrow bands.
SAME = {"paper": (0.005, 0.999), "likelihood": (0.1, 0.99), "bands": (0.1, 0.98), "chakrabarti-zickler": (0.05, 0.98)}
SAME_SIGNAL = 1e-3  # of the noise, or relative
SAME_SCORE = 2e-3  # of a natural logarithm, or relative


@pytest.fixture(scope="module")
def channels():
    scene = recon_scenes.make(recon_scenes.slanted(384, 512, 1, 22), white_e=4000)
    camera, bank = scene.capture.camera, recon_scenes.bank()
    raw_e, _ = mosaic.linearise(scene.capture)
    phases, planes = mosaic.phases(camera), mosaic.planes(raw_e, camera)
    variances = raw_levels.variances(raw_e, scene.capture)
    return [Channel(planes[n], phases[n], variances[n], bank.kernel[0, :, i]) for n, i in (("IR", 3), ("G", 1))]


@pytest.mark.parametrize("preset", [name for name in PRESETS if PRESETS[name].score != "joint"])
def test_levels_in_tiles_equal_those_of_the_whole(channels, preset):
    whole = tiles.best_levels(*channels, PRESETS[preset])
    parts = tiles.best_levels(*channels, PRESETS[preset], size=100, halo=96)
    sure = whole.confidence > 0.5
    assert sure.mean() > 0.2
    level, share = SAME.get(preset, SAME["paper"])
    assert (np.abs(parts.level - whole.level)[sure] < level).mean() > share
    np.testing.assert_allclose(parts.snr[sure], whole.snr[sure], rtol=SAME_SIGNAL, atol=SAME_SIGNAL)


@pytest.mark.parametrize("alike", [True, False])
def test_scores_of_a_few_samples_are_those_of_all(channels, alike):
    """Expectation: other samples are not scored, and those that are have the same score but for rounding, which the
    largest differences of energies enlarge.
    """
    rows, columns, settings = np.arange(2, 192, 7), np.array([0, 3, 250]), PRESETS["best"]
    settings = settings.model_copy(update={"alike": alike})
    few, every = (
        scores.scores(*channels, [], settings, leak=Leak(0.1, 0.5), at=at)[0] for at in ((rows, columns), None)
    )
    np.testing.assert_allclose(few, every[:, rows[:, None], columns], rtol=SAME_SCORE, atol=SAME_SCORE)


def test_tiles_of_a_finer_grid_cover_it_once():
    count = np.zeros((33 * 8, 51 * 8), int)
    for part in tiles.tiles((33, 51), 10, 3):
        finer = part.finer(8)
        count[finer.core] += 1
        assert count[finer.box][finer.inner].shape == count[finer.core].shape
        assert finer.core[0].start == 8 * part.core[0].start
    assert (count == 1).all()


def test_tiles_cover_a_frame_once():
    count = np.zeros((333, 517), int)
    for part in tiles.tiles(count.shape, 100, 30):
        count[part.core] += 1
        assert count[part.box][part.inner].shape == count[part.core].shape
        assert all(s.stop - s.start <= 100 for s in part.core)
    assert (count == 1).all()
