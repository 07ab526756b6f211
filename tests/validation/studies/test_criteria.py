"""The closed forms of the criteria, against the general bound and the Wiener filter itself; and their speed."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import dasim
from dasim.bounds import cramer_rao
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from tests.support import pace
from validation.studies import criteria

BLURS = np.array([3.0, 14.0, 30.0, 47.0])
SHAPE, SPACING_PX = (32, 32), 2.0
BOUND_TOLERANCE = 0.015  # of the bound, which follows the slopes of the transfer functions
LIMIT = 0.5  # processor time over the reference work


@pytest.mark.parametrize("texture", ["known", "spectrum", "free"])
def test_the_closed_form_is_the_general_bound(camera: dasim.Camera, texture: str) -> None:
    """Against the inverse of the whole covariance matrix, with complex transfer functions of three channels."""
    random = np.random.default_rng(5)
    patch = criteria.texture_patch(camera, "A", 300.0, ("G", "R", "IR"))
    transfer, slope = random.normal(size=(2, 2, 3, 32, 17)) + 1j * random.normal(size=(2, 2, 3, 32, 17))
    variance, _ = criteria.blur_variance(transfer, slope, patch, texture)  # type: ignore[arg-type]
    expected = cramer_rao.blur_deviation(
        transfer, slope, patch.power, patch.noise, width=32, gain=patch.gain, texture=texture,  # type: ignore[arg-type]
        area_px=cramer_rao.window_area_px(31), spacing_px=2.0,
    )  # fmt: skip
    np.testing.assert_allclose(np.sqrt(variance), expected, rtol=1e-9)


def test_the_sharp_pictures_error_is_that_of_the_wiener_filter(camera: dasim.Camera) -> None:
    """Against the filter itself, applied to the covariances: tr(P - K C K^H), with partly independent textures."""
    patch, coherence = criteria.texture_patch(camera, "D65", 300.0), criteria.COHERENCE
    random = np.random.default_rng(6)
    transfer = random.normal(size=(1, 2, 32, 17)) + 1j * random.normal(size=(1, 2, 32, 17))
    error, _ = criteria.sharp_error(transfer, patch)
    s = np.moveaxis(patch.gain[:, None, None] * transfer[0], 0, -1)[..., None]
    alike = np.array([[1, coherence], [coherence, 1]])
    covariance = patch.power[..., None, None] * (s @ np.conj(np.swapaxes(s, -1, -2))) * alike + np.diag(patch.noise)
    across = patch.power[..., None, None] * np.conj(s) * np.array([1, coherence])[:, None]
    best = np.conj(np.swapaxes(across, -1, -2)) @ np.linalg.inv(np.conj(covariance)) @ across
    left = patch.power - best[..., 0, 0].real
    assert error[0] == pytest.approx(
        (left * patch.multiplicity).sum() / (patch.power * patch.multiplicity).sum(), rel=1e-9
    )


def test_the_bound_by_pupils_is_the_bound_by_kernels(camera: dasim.Camera) -> None:
    patch = criteria.texture_patch(camera, "D65", 5000.0)
    transfer, slope = cramer_rao.camera_transfers(camera, BLURS, "D65", SHAPE, spacing_px=SPACING_PX)
    pair = [sensors.channels(camera.sensor).index(name) for name in criteria.PLANES]
    expected = np.sqrt(criteria.blur_variance(transfer[:, pair], slope[:, pair], patch)[0])
    np.testing.assert_allclose(criteria.camera_bound(camera, BLURS), expected, rtol=BOUND_TOLERANCE)


def test_the_bound_of_a_camera_takes_half_the_reference_work(camera: dasim.Camera) -> None:
    """With tables loaded; the least of thirty runs, because other programs use the machine too."""
    displaced = cameras.refocused(dasim.load_camera("bando"), 0.4)
    for model, planes in ((camera, criteria.PLANES), (displaced, ("G", "R"))):
        bound = partial(criteria.camera_bound, model, np.linspace(3, 47, 8), planes=planes)
        assert pace.paces(bound, repeats=30) < LIMIT
