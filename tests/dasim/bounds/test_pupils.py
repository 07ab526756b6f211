"""Transfer functions of pupils by FFT, against the simulator's kernels, Hopkins's integral and Bessel functions."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.bounds import cramer_rao, pupils
from dasim.camera import geometry, pointspread, stops
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import illuminants
from tests.support.transfers import kernel_transfer
from validation.references.transfer import hopkins_otf
from validation.studies.shape.infrared_stop import with_mask

BLURS = np.array([3.0, 14.0, 30.0, 47.0])
SHAPE, SPACING_PX = (32, 32), 2.0
# Kernels end 40 px beyond the blur and are scaled to unit sum there: 2 / pi^2 of lambda N / 40 px of a disc's light
# lies beyond, 1.3 % of infrared's, which all frequencies above 0 lack; the longer rim of a ring diffracts as much.
TRANSFER_TOLERANCE = 0.014
DRAWN_TOLERANCE = 0.01  # of a rim drawn in cells of a hundredth of the radius


@pytest.fixture(scope="module")
def camera() -> dasim.Camera:
    return cameras.refocused(dasim.load_camera("da-mobile"), 0.4)


def round_stop(camera: dasim.Camera, stop: stops.Stop) -> np.ndarray:
    spectrum = illuminants.illuminant("D65")
    alone = camera.model_copy(update={"stops": (stop,)})
    return cramer_rao.round_transfers(alone, BLURS, spectrum, SHAPE, spacing_px=SPACING_PX)


@pytest.mark.parametrize(
    "stop",
    [
        stops.Disc(name="hole", radius_ratio=0.46, passes_nm=((650, 830),)),
        stops.Annulus(name="hole", shape="annulus", inner_ratio=0.4, outer_ratio=0.8, passes_nm=((650, 830),)),
    ],
)
def test_transfer_functions_of_a_drawn_stop_are_those_of_its_radial_kernels(
    camera: dasim.Camera, stop: stops.Stop
) -> None:
    amplitude = pupils.stop_amplitude(stop)
    pupil = pupils.pupil(camera, stop, "D65", BLURS, len(amplitude), SHAPE, spacing_px=SPACING_PX)
    transfer = pupils.transfers(pupil, amplitude, stops.open_area(stop) * np.pi)
    infrared = sensors.channels(camera.sensor).index("IR")
    exact = round_stop(camera, stop)
    transfer, exact = (
        one[:, infrared].reshape(len(BLURS), -1)[:, 1:] for one in (transfer, exact)
    )  # without frequency 0
    np.testing.assert_allclose(transfer, exact, atol=TRANSFER_TOLERANCE)


def test_one_wavelength_is_hopkins_closed_form() -> None:
    """A single band of the grid against the integral, along an axis, without kernels or spectra."""
    scale_px, blur = 1.2, 20.0
    grid = pupils._grid(np.ones(1), scale_px, np.array([blur]), 256, 32, 2.0, 192)
    disc = pupils.stop_amplitude(stops.Disc(name="disc", radius_ratio=0.5))
    transfer = pupils.transfers(pupils.Pupil((grid,), (32, 32), np.ones(1)), disc, 0.25 * np.pi)[0, 0, 0]
    frequency = np.fft.rfftfreq(32, 2.0)
    exact = hopkins_otf(frequency * scale_px / 0.5, blur * 0.5 / (8 * scale_px / 0.5)) * np.sinc(frequency)
    np.testing.assert_allclose(
        transfer[1:], exact[1:], atol=2e-3
    )  # the rim is drawn in cells of 1/128 of the lens's radius


def test_a_mask_off_the_axis_has_the_phase_of_the_simulators_kernel(camera: dasim.Camera) -> None:
    """Sign and axes of the phase of an off-axis part of the lens, against the kernel on the pixel grid."""
    cells = 32
    mask = np.zeros((cells, cells))
    mask[6:12, 20:28] = 1.0
    masked = with_mask(camera, mask)
    depth_m = float(geometry.depth_of_blur_m(camera, 14.0))
    kernel = pointspread.psf(masked, depth_m, "IR", "D65", size=91)
    expected = kernel_transfer(kernel, SHAPE, spacing_px=SPACING_PX)
    transfer, _ = pupils.stop_transfers(masked, np.array([14.0]), "D65", SHAPE, spacing_px=SPACING_PX)
    infrared = sensors.channels(camera.sensor).index("IR")
    outside = 1 - kernel.sum()  # light outside the frame
    np.testing.assert_allclose(transfer[0, infrared], expected, atol=TRANSFER_TOLERANCE + outside)
    mirrored = np.conj(transfer[0, infrared]) - expected
    assert np.abs(mirrored).max() > 10 * (TRANSFER_TOLERANCE + outside)


def test_discs_off_the_axis_have_the_pupils_transform() -> None:
    """The closed form of each of Bando's discs, against the transform of the disc drawn in cells."""
    bando = cameras.refocused(dasim.load_camera("bando"), 0.4)
    for stop in bando.stops:
        assert isinstance(stop, stops.Disc)
        assert stop.centre_ratio != (0.0, 0.0)
        amplitude = pupils.stop_amplitude(stop)
        pupil = pupils.pupil(bando, stop, "D65", BLURS, len(amplitude), SHAPE, spacing_px=SPACING_PX, fine_cells=192)
        transfer = pupils.transfers(pupil, amplitude, stops.open_area(stop) * np.pi)
        exact, electrons = pupils.disc_transfers(bando, stop, BLURS, "D65", SHAPE, SPACING_PX)
        lit = electrons > 0.01 * electrons.max()
        result, exact = (one[:, lit].reshape(len(BLURS), -1) for one in (transfer, exact))
        np.testing.assert_allclose(result[:, 1:], exact[:, 1:], atol=DRAWN_TOLERANCE)


@pytest.mark.parametrize(
    ("part", "change"), [("lens", {"wavefront_nm": {"spherical": 80.0}}), ("hole", {"phase_nm": 265.0})]
)
def test_wavefronts_are_refused(camera: dasim.Camera, part: str, change: dict) -> None:
    """Rationale: a bound that leaves an aberration out is up to three times too small."""
    data = camera.model_dump()
    (data["lens"] if part == "lens" else data["stops"][1]).update(change)
    aberrated = dasim.Camera.model_validate(data)
    with pytest.raises(InputError, match="neither wavefront_nm nor phase_nm"):
        pupils.camera_transfers(aberrated, BLURS, "D65", SHAPE)


def test_many_waves_of_defocus_and_narrow_bands(camera: dasim.Camera) -> None:
    """Set-up: 60 px of blur at f/1.4 and 5 um, 60 waves; a stop that passes 8 nm; a stop that passes nothing.

    Expectation: Hopkins's integral and the radial kernels agree to 0.001; the narrow stop has its own light alone.
    """
    lens, wide = {"lens.focal_length_mm": 25.0, "lens.f_number": 1.4}, {"sensor.pixel_pitch_um": 5.0}
    fast = dasim.with_values(camera, lens | wide | {"lens.focus_distance_m": 2.0})
    by_pupil, _ = pupils.camera_transfers(fast, [60.0], "D65", (16, 16))
    by_kernel, _ = cramer_rao.camera_transfers(fast, np.array([60.0]), "D65", (16, 16))
    np.testing.assert_allclose(by_pupil, by_kernel, atol=1e-3)
    band = dasim.with_values(camera, {"stops.hole.passes_nm.0.0": 701.0, "stops.hole.passes_nm.0.1": 709.0})
    hole = band.stops[1].model_copy(update={"edge_width_nm": 0.1})
    narrow, _ = pupils.camera_transfers(band.model_copy(update={"stops": (hole,)}), [5.0], "D65", (16, 16))
    assert np.isfinite(narrow).all()
    dark = dasim.with_values(camera, {"sensor.cutoff_nm": 600.0, "sensor.cutoff_width_nm": 0.1})
    with pytest.raises(InputError, match="no light of D65 passes stop 'hole'"):
        pupils.camera_transfers(dark.model_copy(update={"stops": (hole,)}), [5.0], "D65", (16, 16))
