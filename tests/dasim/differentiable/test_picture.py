"""Pictures of layers: those of the path tracer, of conserved energy, with slopes as gradients.

Skipped without the extra ``learn``.
"""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import geometry, noise
from dasim.camera import specification as cameras
from dasim.scene.specification import Scene

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from dasim.differentiable import picture as pictures  # noqa: E402 - needs PyTorch
from dasim.differentiable import stop as stops  # noqa: E402

NEAR_M, FAR_M, FOCUS_M = 0.2, 0.3, 0.8
SIDE = 128
EDGE = 0.025  # of the contrast: 1.1 % for the layers, and noise of 16 rows of 256 samples


@pytest.fixture(scope="module")
def camera():
    camera = cameras.cropped(cameras.load_camera("da-mobile"), 64, 48)
    return camera.model_copy(update={"lens": camera.lens.model_copy(update={"focus_distance_m": FOCUS_M})})


def scene(material, behind):
    """A card before a board, lit from far behind the camera, so that its shadow is hidden."""
    return Scene.model_validate(
        {
            "name": "card",
            "objects": [
                {"name": "board", "shape": "plane", "size_cm": [20, 20], "position_cm": [0, 0, 100 * FAR_M],
                 "material": behind},
                {"name": "card", "shape": "plane", "size_cm": [5, 20], "position_cm": [-2.35, 0, 100 * NEAR_M],
                 "material": material},
            ],
            "lights": [{"kind": "lamp", "illuminant": "D65", "lux": 1000, "position_cm": [0, 0, -5000],
                        "target_cm": [0, 0, 20], "radius_cm": 5}],
        }
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("card", "board"), [("carbon-black", "white-paper"), ("white-paper", "carbon-black")])
def test_a_card_before_a_board_is_that_of_the_path_tracer(camera, card, board):
    """Set-up: the edge of a card with 10 px of visible blur before a board with 6. The layers are the simulator's
    pinhole pictures of both, their mask follows from it. Expectation: the profile of the edge in each channel.
    """
    truth = dasim.simulate(scene(card, board), camera, 0, spp=256).truth
    sharp = truth.sharp_e[16:32].mean(axis=0, dtype=np.float64)
    near, far = sharp[:8].mean(axis=0), sharp[-8:].mean(axis=0)
    mask = np.pad(((sharp - far) / (near - far))[:, 1], (SIDE - 64) // 2, mode="edge")
    blurs = geometry.blur_px(camera, np.array([FAR_M, NEAR_M]))
    transfer, _ = stops.fixed_stops(camera, "D65", blurs, SIDE)
    radiance = torch.tensor(np.stack([far, near]), dtype=torch.float32)[..., None, None].expand(2, 4, SIDE, SIDE)
    masks = torch.stack([torch.ones(SIDE, SIDE), torch.tensor(mask, dtype=torch.float32).expand(SIDE, SIDE)])
    middle = slice((SIDE - 64) // 2, (SIDE + 64) // 2)
    found = pictures.picture(radiance, masks, transfer)[:, SIDE // 2, middle].numpy()
    expected = truth.mean_e[16:32].mean(axis=0, dtype=np.float64).T
    contrast = np.abs(near - far)[:, None]
    np.testing.assert_allclose(found / contrast, expected / contrast, atol=EDGE)
    assert np.abs(expected - sharp.T).max() > 0.3 * contrast.max()  # the sharp picture would not do


def test_equal_radiance_stays_equal_whatever_the_depths(camera):
    transfer, _ = stops.fixed_stops(camera, "D65", [2.0, 9.0, 20.0], 64, dtype=torch.float64)
    masks = torch.rand((3, 64, 64), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    masks[0] = 1
    found = pictures.picture(torch.full((3, 4, 64, 64), 7.0, dtype=torch.float64), masks, transfer)
    torch.testing.assert_close(found, torch.full_like(found, 7.0), rtol=1e-6, atol=0)


def test_gradients_are_finite_differences(camera):
    """From the cells of a stop, the radiance and the mask to the picture with noise, in double precision."""
    free = stops.free_stop(camera, camera.stops[1], "D65", [2.0, 5.0], 4, 8, fine_cells=8, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    amplitude, radiance, mask = (
        torch.rand(shape, generator=generator, dtype=torch.float64).requires_grad_()
        for shape in ((4, 4), (2, 4, 8, 8), (2, 8, 8))
    )

    def signal(amplitude, radiance, mask):
        light = stops.electrons(free, amplitude)[:, None, None]
        mean_e = 100 * light * pictures.picture(radiance, mask, stops.transfers(free, amplitude))
        return pictures.noisy(mean_e, camera, 0.03, generator=torch.Generator().manual_seed(2))

    assert torch.autograd.gradcheck(signal, (amplitude, radiance, mask), atol=1e-4)


def test_the_nearest_layer_hides_what_is_behind():
    mask = torch.tensor([[[1.0, 1.0, 1.0]], [[0.0, 1.0, 1.0]], [[0.0, 0.0, 0.5]]])
    found = pictures.nearest(mask, torch.tensor([1.0, 2.0, 4.0]))
    torch.testing.assert_close(found, torch.tensor([[1.0, 2.0, 3.0]]))


def test_planes_are_the_pixels_of_the_mosaic(camera):
    image = np.random.default_rng(0).uniform(size=(48, 64, 4))
    mosaic = noise.mosaic(image, camera)
    found = pictures.planes(torch.tensor(np.moveaxis(image, -1, 0)), camera).numpy()
    expected = [mosaic[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    np.testing.assert_array_equal(found, np.stack(expected))


def test_noise_has_the_variance_of_the_data_sheet(camera):
    """Limit: four standard errors of a variance from 40,000 numbers, sqrt(2 / n) = 0.7 %."""
    mean_e = torch.full((200, 200), 900.0, dtype=torch.float64)
    found = pictures.noisy(mean_e, camera, 0.03, generator=torch.Generator().manual_seed(5))
    expected = float(noise.variance(camera.sensor, 0.03).at(900.0))
    assert float(found.var()) == pytest.approx(expected, rel=0.03)
    assert float(found.mean()) == pytest.approx(900, abs=4 * np.sqrt(expected / 40_000))


def test_planes_need_a_mosaic_of_two_by_two():
    camera = cameras.cropped("da-4x4", 16, 16)
    with pytest.raises(InputError, match="'da-4x4' is 4x4; it must be 2x2"):
        pictures.planes(torch.zeros(4, 16, 16), camera)
