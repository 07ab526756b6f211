"""The complete reconstruction of one capture: figures on a textured scene, and frames without content."""

import dataclasses

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import geometry, specification
from dasim.camera import noise as sensor
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.zernike import Wavefront
from dasim.values import Capture
from recon.depth import surface_net
from recon.picture import develop
from recon.settings import DEFAULT_PRESET
from recon.sharp import restoration
from tests.support import recon_scenes

MIN_GAIN_DB = 1.0  # of the all-in-focus picture, with the estimated levels, mosaic and photon noise
MIN_PICTURE_DB = 35.0  # captured against exact colours, white as peak; a picture off by one pixel has some 25
SEAM_LEVELS, SEAM_DN = 0.1, 0.5  # the project's own limits, of 8-bit digital numbers
MAX_LOSS_DB = 0.5  # near focus, where nothing is to gain


@pytest.fixture(scope="module")
def scene():
    return recon_scenes.make(recon_scenes.slanted(256, 384, 0, 20), white_e=4000)


@pytest.fixture(scope="module")
def result(scene):
    return recon.reconstruct(scene.capture, recon_scenes.bank())


def decibel(image, truth, mask):
    return -10 * np.log10(np.mean((image - truth)[mask] ** 2))


@pytest.mark.parametrize(("preset", "lowest"), [("bands", 0), ("paper", 3)])
def test_all_in_focus_gains_and_never_loses(scene, result, preset, lowest):
    """Above 3 px of blur the picture gains in every range; below, it loses at most MAX_LOSS_DB. The preset `paper` is
    judged above 3 px only, because its NCC overestimates levels near focus by three in the median.
    """
    if preset != DEFAULT_PRESET:
        result = recon.reconstruct(scene.capture, recon_scenes.bank(), recon.PRESETS[preset])
    alpha = specification.crosstalk(scene.capture.camera)
    truth = np.maximum(scene.sharp_e[..., :3] - alpha * scene.sharp_e[..., 3:], 0)
    inner = np.zeros(scene.level.shape, bool)
    inner[16:-16, 16:-16] = True
    per_level = geometry.level_blur_px(scene.capture.camera)[1]
    for low, high, gain in ((0, 3, -MAX_LOSS_DB), (3, 10, MIN_GAIN_DB), (10, 20, MIN_GAIN_DB), (20, 40, MIN_GAIN_DB)):
        mask = inner & (scene.level * per_level >= max(low, lowest)) & (scene.level * per_level < high)
        if not mask.any():
            continue
        before = decibel(result.linear_e, truth, mask)
        assert decibel(result.sharp_e, truth, mask) > before + gain, (low, high)


@pytest.mark.slow
def test_a_large_frame_in_tiles_has_no_seams(monkeypatch):
    """Set-up: a frame of an odd number of nodes, beyond the network's reach, and tiles of a few of them.

    Expectation: levels and pictures are those of the whole frame everywhere, not at the borders of tiles alone.
    """
    capture = recon_scenes.make(recon_scenes.slanted(98, 1010, 1, 20), white_e=4000).capture
    whole = recon.reconstruct(capture, recon_scenes.bank())
    monkeypatch.setattr(surface_net, "TILE", 30)
    monkeypatch.setattr(restoration, "TILE_PX", 200)
    monkeypatch.setattr(develop, "STRIP_PX", 40)
    tiled = recon.reconstruct(capture, recon_scenes.bank())
    assert np.abs(tiled.level - whole.level).max() <= SEAM_LEVELS
    np.testing.assert_array_equal(tiled.rgb, whole.rgb)
    assert 255 * np.abs(tiled.sharp_rgb - whole.sharp_rgb).max() <= SEAM_DN


def test_tiles_too_small_to_be_blended_are_refused(scene):
    with pytest.raises(InputError, match="tiles of 63 px are too small; allowed are 64 px and more"):
        recon.reconstruct(scene.capture, recon_scenes.bank(), tile_px=63)


def test_levels_and_depths(scene, result):
    sure = np.isfinite(result.level_raw)
    assert np.median(np.abs(result.level_raw - scene.level)[sure]) < 0.8
    assert np.median(np.abs(result.level - scene.level)) < 1.5
    depths = geometry.depth_of_blur_m(
        scene.capture.camera, result.level * geometry.level_blur_px(scene.capture.camera)[1]
    )
    # the bank's depths interpolated linearly between levels, against the lens equation
    np.testing.assert_allclose(result.depth_m, depths, rtol=0.01)


def test_the_4x4_mosaic_shows_the_same_levels():
    """The same light sampled by the 4x4 mosaic, reconstructed with the same bank (kernels do not depend on the mosaic),
    gives the same levels and picture.
    """
    scene = recon_scenes.make(recon_scenes.slanted(128, 256, 2, 16), white_e=4000)
    four = cameras.cropped(cameras.load_camera("da-4x4"), 256, 128)
    raw, _ = sensor.expose(
        electronic_crosstalk(sensor.mosaic(scene.mean_e.astype(float), four), four), four.sensor, 0.02, 1
    )
    result = recon.reconstruct(Capture(raw, four, 0.02, 1.0, 1), recon_scenes.bank())
    sure = np.isfinite(result.level_raw)
    assert sure.mean() > 0.25
    assert np.median(np.abs(result.level_raw - scene.level)[sure]) < 0.8
    alpha = specification.crosstalk(four)
    exact = scene.mean_e[..., :3] - alpha * scene.mean_e[..., 3:]
    inner = np.zeros(scene.level.shape, bool)
    inner[16:-16, 16:-16] = True
    peak = 20 * np.log10(4000)
    assert peak + decibel(result.linear_e, exact, inner) > MIN_PICTURE_DB


def test_everything_is_finite_and_in_range(result):
    for name in ("rgb", "sharp_rgb", "linear_e", "sharp_e", "ir_e", "level", "depth_m", "confidence"):
        image = getattr(result, name)
        assert image.dtype == np.float32 and np.isfinite(image).all() and image.min() >= 0, name
    assert result.rgb.max() <= 1 and result.sharp_rgb.max() <= 1 and result.confidence.max() <= 1
    assert result.settings == recon.DEFAULT.model_dump()


def test_the_simulator_cannot_leak_into_the_estimate(scene, result):
    """A capture with another light name, seed and provenance gives the same result, bit for bit; this also shows that
    the reconstruction is deterministic.
    """
    other = dataclasses.replace(scene.capture, illuminant="A", seed=99, provenance={"scene": "x"})
    reports = []
    again = recon.reconstruct(other, recon_scenes.bank(), progress=lambda name, share: reports.append((name, share)))
    np.testing.assert_array_equal(again.sharp_rgb, result.sharp_rgb)
    np.testing.assert_array_equal(again.level, result.level)
    assert [name for name, _ in reports] == [*result.timings_s, "done"]
    assert [share for _, share in reports] == sorted(share for _, share in reports)


@pytest.mark.parametrize("value", [0, 64, 300, 1023])
def test_frames_without_any_texture(value):
    """Black, constant and saturated frames give finite pictures, no confidence and no estimate."""
    camera = recon_scenes.da_mobile(96, 64)
    capture = Capture(np.full((64, 96), value, np.uint16), camera, 0.01, 1.0, 0)
    result = recon.reconstruct(capture, recon_scenes.bank())
    assert np.isnan(result.level_raw).all()
    assert not result.confidence.any()
    for name in ("rgb", "sharp_rgb", "linear_e", "sharp_e", "ir_e", "level", "depth_m"):
        assert np.isfinite(getattr(result, name)).all(), name


def test_a_bank_of_another_focus_or_camera_is_refused(scene):
    bank = recon_scenes.bank()
    moved = dataclasses.replace(scene.capture, camera=cameras.refocused(scene.capture.camera, 0.12))
    with pytest.raises(InputError, match=r"focused at 0\.4 m"):
        recon.reconstruct(moved, bank)
    sensor = scene.capture.camera.sensor.model_copy(update={"pixel_pitch_um": 3.0})
    other = dataclasses.replace(scene.capture, camera=scene.capture.camera.model_copy(update={"sensor": sensor}))
    with pytest.raises(InputError, match=r"does not match.*pixel_pitch_um"):
        recon.reconstruct(other, bank)
    sensor = scene.capture.camera.sensor.model_copy(update={"cutoff_nm": 700.0})
    other = dataclasses.replace(scene.capture, camera=scene.capture.camera.model_copy(update={"sensor": sensor}))
    with pytest.raises(InputError, match="differ in cutoff_nm"):
        recon.reconstruct(other, bank)


def test_other_values_than_capture_and_bank_are_refused(scene):
    for arguments, message in (
        ((scene.capture, None), "bank: must be a PsfBank, not None"),
        ((recon_scenes.bank(), scene.capture), "capture: must be a Capture, not a PsfBank"),
    ):
        with pytest.raises(InputError, match=message):
            recon.reconstruct(*arguments)


def test_a_bank_of_another_kind_of_sensor_is_refused(scene):
    """Expectation: the message names what differs: response curves, pixels, or the channels of the mosaic."""
    bank, mine = recon_scenes.bank(), scene.capture.camera
    sensor = bank.camera.sensor.model_copy(update={"cutoff_nm": 700.0})
    other = dataclasses.replace(bank, camera=bank.camera.model_copy(update={"sensor": sensor}))
    with pytest.raises(InputError, match=r"differ in cutoff_nm; .*'dasim calibrate"):
        recon.reconstruct(scene.capture, other)
    moved = dataclasses.replace(bank, camera=bank.camera.model_copy(update={"stops": mine.stops[:1]}))
    with pytest.raises(InputError, match="differ in stops"):
        recon.reconstruct(scene.capture, moved)
    thin = bank.camera.sensor.model_copy(update={"silicon_um": 3.0})
    blurred = bank.camera.lens.model_copy(update={"wavefront_nm": Wavefront(coma=50.0)})
    for changed, name in (({"sensor": thin}, "silicon_um"), ({"lens": blurred}, "wavefront_nm")):
        other = dataclasses.replace(bank, camera=bank.camera.model_copy(update=changed))
        with pytest.raises(InputError, match=f"differ in {name};"):
            recon.reconstruct(scene.capture, other)


@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_windows_without_saturated_pixels_count_at_any_limit(scene, preset):
    """Expectation: frames without a saturated pixel have the same levels with a share of 0 allowed as by default."""
    small = crop(scene.capture, 128, 96)
    settings = [recon.PRESETS[preset].model_copy(update={"saturated_share": share}) for share in (0.0, 0.05)]
    one, other = (recon.reconstruct(small, recon_scenes.bank(), of) for of in settings)
    np.testing.assert_array_equal(one.level_raw, other.level_raw)
    assert np.isfinite(one.level_raw).any()


def test_an_alpha_that_leaves_no_visible_light_is_refused(scene):
    settings = recon.PRESETS["fast"].model_copy(update={"crosstalk": (0.3, 0.3, 9.0)})
    with pytest.raises(InputError, match="alpha of B leaves no visible light of white under D65; it must be below"):
        recon.reconstruct(crop(scene.capture, 64, 64), recon_scenes.bank(), settings)


def test_a_bank_of_another_light_gives_a_note(scene, result):
    """A picture under D65 is reconstructed with a bank of lamps only, and a note says so; a bank with both lights gives
    no note.
    """
    bank = recon_scenes.bank()
    lamp = dataclasses.replace(bank, kernel=bank.kernel[1:], lights=bank.lights[1:], signature=bank.signature[1:])
    small = crop(scene.capture, 128, 64)
    assert len(result.notes) == 1 and result.notes[0].startswith("the side of the focus is assumed")
    note, _ = recon.reconstruct(small, lamp).notes
    assert "far from every light of the bank (A)" in note and "--illuminant" in note


def test_many_saturated_pixels_give_a_note(scene, result):
    assert not any("saturated" in note for note in result.notes)
    raw = scene.capture.raw_dn.copy()
    raw[:, : raw.shape[1] // 4] = 1023
    clipped = recon.reconstruct(
        dataclasses.replace(scene.capture, raw_dn=raw), recon_scenes.bank(), recon.PRESETS["paper"]
    )
    assert any(note.startswith("25% of the pixels are saturated") for note in clipped.notes), clipped.notes


def test_a_bank_of_another_place_gives_a_note(scene):
    """Set-up: a frame about the axis; kernels of the axis, of a place 5 degrees off it and of 31 degrees.

    Expectation: a note at 31 degrees alone, where 1/cos^3 is 1.59.
    """
    bank, small = recon_scenes.bank(), crop(scene.capture, 64, 64)
    focal_px = geometry.intrinsic_matrix(small.camera)[0, 0]
    for angle_deg, expected in ((0, 0), (5, 0), (31, 1)):
        place = (float(focal_px * np.tan(np.radians(angle_deg))), 0.0)
        notes = recon.reconstruct(small, dataclasses.replace(bank, field_px=place)).notes
        assert len(notes) == expected + 1, notes  # and one on the side of the focus
    assert "at 31.0 degrees off the axis" in notes[0] and "37% narrower" in notes[0] and "field_px = (0, 0)" in notes[0]


def crop(capture, width, height):
    camera = recon_scenes.da_mobile(width, height)
    return dataclasses.replace(capture, raw_dn=capture.raw_dn[:height, :width], camera=camera)


def test_a_frame_smaller_than_the_kernels(scene):
    """A frame of 64 x 64 pixels with kernels of 75 x 75 is reconstructed: values in range, and levels where there is
    texture.
    """
    small = crop(scene.capture, 64, 64)
    assert recon_scenes.bank().kernel.shape[-1] > 64
    result = recon.reconstruct(small, recon_scenes.bank())
    for name in ("rgb", "sharp_rgb", "linear_e", "sharp_e", "ir_e", "level", "depth_m", "confidence"):
        assert np.isfinite(getattr(result, name)).all(), name
    assert np.isfinite(result.level_raw).any()


def test_tiny_frames_are_refused():
    camera = recon_scenes.da_mobile(8, 8)
    with pytest.raises(InputError, match="at least"):
        recon.reconstruct(Capture(np.full((8, 8), 100, np.uint16), camera, 0.01, 1.0, 0), recon_scenes.bank())
