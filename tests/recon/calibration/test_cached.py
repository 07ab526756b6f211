"""PSF banks in the cache; tests/dasim/base checks that a bank is measured again after a change of code or data."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import dasim
import recon
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry
from dasim.camera import specification as cameras
from recon.calibration import cached, psf_bank

OPTIONS = {"lights": ("D55",), "diffraction": "off"}
ROUNDING = 1e-5  # of sums of a few thousand 32-bit floats


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.refocused(da_mobile, 0.4)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def bank(camera):
    return recon.calibrate(dasim.calibration_captures(camera, **OPTIONS), cache=False)


@pytest.fixture
def measured(bank, monkeypatch):
    """List of the cameras whose banks were measured; all tests share one real measurement."""
    calls = []

    def measure(pictures, camera, *, diffraction, field_px):
        calls.append(camera)
        return replace(bank, camera=camera, field_px=field_px)

    measure.__module__, measure.__qualname__ = psf_bank.__name__, "calibrate"
    monkeypatch.setattr(psf_bank, "calibrate", measure)
    return calls


def cached_bank(camera, **changes):
    return recon.calibrate(dasim.calibration_captures(camera, **OPTIONS | changes))


def test_bank_is_of_the_camera(bank, camera):
    assert bank.lights == ("D55",) and bank.camera == camera and bank.diffraction == "off"
    assert bank.kernel.shape[:3] == (1, cameras.BLUR_LEVELS, 4)
    np.testing.assert_allclose(bank.kernel.sum(axis=(-1, -2)), 1, atol=ROUNDING)
    np.testing.assert_allclose(bank.blur_px, geometry.level_blur_px(camera), rtol=1e-6)


def test_pictures_can_be_counted_and_taken_again(camera):
    """Expectation: the iteration yields the announced number of pictures, and the same ones each time."""
    pictures = dasim.calibration_captures(camera, ("D55",), frames=1, diffraction="off")
    first, second = list(pictures), list(pictures)
    assert len(first) == len(pictures) == cameras.BLUR_LEVELS * 4 * 3
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.frames_dn, b.frames_dn)


def test_progress_counts_the_pictures(camera):
    shares = []
    pictures = dasim.calibration_captures(camera, ("D55",), frames=1, diffraction="off")
    assert list(cached._with_progress(pictures, lambda stage, share: shares.append(share)))
    assert shares[0] == 0.0 and max(shares) < 1.0 and len(shares) == len(pictures)


def test_cached_bank_is_the_same_without_photographing_again(camera, bank, measured):
    first = cached_bank(camera)
    assert len(measured) == 1
    second = cached_bank(camera)
    assert len(measured) == 1
    for name in ("kernel", "signature", "depth_m", "blur_px"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert (second.lights, second.camera, second.diffraction) == (bank.lights, camera, "off")
    recon.calibrate(dasim.calibration_captures(camera, **OPTIONS), cache=False)
    assert len(measured) == 2


@pytest.mark.parametrize("content", [b"", b"rubbish", None])
def test_damaged_cached_bank_is_made_anew(cache, camera, measured, content):
    cached_bank(camera)
    (file,) = (cache / "banks").iterdir()
    file.write_bytes(file.read_bytes()[:5000] if content is None else content)
    assert cached_bank(camera).kernel.shape[1] == cameras.BLUR_LEVELS and len(measured) == 2
    cached_bank(camera)
    assert len(measured) == 2, "the new one is kept"


def test_cached_file_that_is_a_bank_of_something_else_is_made_anew(cache, camera, measured):
    """Rationale: the cache is a folder of the user's and may hold any file, also one of which only the metadata is
    damaged.
    """
    cached_bank(camera)
    (file,) = (cache / "banks").iterdir()
    with np.load(file) as data:
        arrays = dict(data)
    about = json.loads(str(arrays["about"]))
    np.savez(file, **(arrays | {"about": np.array(json.dumps({"schema": about["schema"]}))}))
    cached_bank(camera)
    assert len(measured) == 2


def test_cache_that_cannot_be_written_is_no_error(cache, camera, measured):
    cache.mkdir()
    (cache / "banks").write_text("a file where the folder should be")
    with pytest.warns(UserWarning, match="cannot be stored in the cache"):
        assert cached_bank(camera).lights == ("D55",)


def changed(camera, **changes):
    """The camera with new values for the keys given as ``part__name``."""
    data = camera.model_dump()
    for key, value in changes.items():
        part, name = key.split("__")
        if part == "stops":
            data["stops"] = [s | {name: value} if s["radius_ratio"] < 1 else s for s in data["stops"]]
        else:
            data[part][name] = value
    return parse(cameras.Camera, data, "changed camera")


def test_key_ignores_the_frame_and_nothing_that_decides_the_kernels(camera, measured):
    """Expectation: a camera with another frame size finds the bank, also a window off the axis for the same place; one
    with another focus, hole, pixel, light, diffraction model or place does not.
    """
    cached_bank(camera)
    cached_bank(cameras.cropped(camera, 64, 48))
    window = cameras.cropped(camera, 64, 48, at_px=(1892, 1244))
    cached_bank(window, field_px=(0.0, 0.0))
    assert len(measured) == 1
    others = [
        changed(camera, lens__focus_distance_m=0.41),
        changed(camera, lens__f_number=2.0),
        changed(camera, stops__radius_ratio=0.5),
        changed(camera, sensor__pixel_pitch_um=1.6),
        changed(camera, sensor__cutoff_nm=800.0),
    ]
    for count, other in enumerate(others, start=2):
        cached_bank(other)
        assert len(measured) == count, other
    assert cached_bank(window).field_px == (900.0, 500.0)
    cached_bank(camera, field_px=(900.0, 500.0))
    others = ({"lights": ("D65",)}, {"diffraction": "wave"}, {"frames": 3}, {"seed": 1}, {"field_px": (900.0, 501.0)})
    for count, change in enumerate(others, start=len(measured) + 1):
        cached_bank(camera, **change)
        assert len(measured) == count, change


def test_bank_from_the_cache_has_the_frame_of_the_pictures(camera, measured):
    cached_bank(cameras.cropped(camera, 64, 48))
    assert cached_bank(camera).camera == camera and len(measured) == 1


def test_pictures_of_ones_own_need_a_camera(camera):
    pictures = dasim.calibration_captures(camera, ("D55",))
    with pytest.raises(InputError, match="give camera="):
        recon.calibrate(iter(pictures))
    with pytest.raises(InputError, match="leave it out"):
        recon.calibrate(pictures, cameras.refocused(camera, 0.5))
