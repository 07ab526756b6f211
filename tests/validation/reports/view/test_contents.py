"""What a page says of a reconstruction and of a capture."""

from dataclasses import replace

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.camera.specification import refocused
from recon.depth.peak import confidence_of
from recon.levels import level_sd_of
from recon.picture.develop import develop
from tests.support import viewed
from validation.reports.view import contents
from validation.reports.view.packing import unpacked


@pytest.fixture(scope="module")
def shown():
    example = viewed.example()
    return contents.of_reconstruction(example.result, example.bank, [], example.capture, example.truth)


def values(packed):
    numbers = unpacked(packed["data"], (viewed.HEIGHT, viewed.WIDTH)).astype(np.float64)
    return packed["low"] + (numbers - 1) * packed["step"]


def test_names_of_pictures_and_maps_differ(shown):
    """Rationale: menus of the page list both."""
    names = [p.id for p in shown.pictures] + [*shown.maps, "sd", "error", "refocused"]
    assert len(set(names)) == len(names)


def test_maps_hold_depth_and_confidence(shown):
    example = viewed.example()
    assert 1 / values(shown.maps["depth"]) == pytest.approx(example.result.depth_m, rel=1e-4)
    assert 1 / values(shown.maps["true_depth"]) == pytest.approx(example.truth.depth_m, rel=1e-4)
    assert values(shown.maps["confidence"]) == pytest.approx(example.result.confidence, abs=1e-5)


def test_confidence_becomes_the_standard_deviation_that_it_came_from(shown):
    """Expectation: the page's formula inverts ``confidence_of`` and ``level_sd_of``."""
    example = viewed.example()
    depth_m, sd_m = example.result.depth_m, 0.05 * example.result.depth_m
    confidence = confidence_of(level_sd_of(sd_m, depth_m, example.bank.depth_m))
    sd_levels = shown.sd["at_half"] * np.sqrt(1 / confidence - 1)
    assert sd_levels * shown.sd["dioptres_per_level"] * depth_m**2 == pytest.approx(sd_m, rel=1e-5)


def test_mosaic_gives_numbers_and_electrons(shown):
    example = viewed.example()
    sensor = example.capture.camera.sensor
    raw = unpacked(shown.mosaic["data"], (viewed.HEIGHT, viewed.WIDTH))
    assert np.array_equal(raw, example.capture.raw_dn)
    full = (2**sensor.adc_bits - 1 - sensor.black_level_dn) * shown.mosaic["e_per_dn"]
    assert full == pytest.approx(sensor.full_well_e)
    assert shown.mosaic["pattern"] == [["G", "R"], ["B", "IR"]]


def test_parts_that_are_missing_are_left_out():
    example = viewed.example()
    alone = contents.of_reconstruction(example.result, example.bank, [], None, None)
    assert alone.mosaic is None and set(alone.maps) == {"depth", "confidence"}
    assert [p.id for p in alone.pictures] == ["captured", "all-in-focus"]


def test_capture_alone():
    example = viewed.example()
    shown = contents.of_capture(example.capture, develop(example.capture), example.truth)
    assert [p.id for p in shown.pictures] == ["captured", "truth"]
    assert [p.id for p in shown.channels] == ["R", "G", "B", "IR"]
    assert set(shown.maps) == {"true_depth"} and not shown.stack and shown.sd is None
    assert contents.of_capture(example.capture, develop(example.capture), None).maps == {}


def test_capture_of_another_camera_is_refused():
    example = viewed.example()
    contents.check_same(example.result, example.capture, "shot")
    other = replace(example.capture, camera=refocused(example.capture.camera, 0.7))
    with pytest.raises(InputError, match=r"shot.*0\.7 m"):
        contents.check_same(example.result, other, "shot")
