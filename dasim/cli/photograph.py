"""The commands render, calibrate, lens and emva.

Tested in tests/dasim/cli/test_render.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import AnyOut, Size, Whole, samples
from dasim.typing import Progress

if TYPE_CHECKING:
    from dasim.camera.specification import Camera
    from dasim.values import PsfBank


def render(
    scene: str,
    *,
    out: AnyOut = None,
    camera: str = "da-mobile",
    focus: float | None = None,
    seed: Whole = 0,
    size: Size | None = None,
    spp: Annotated[int | str | None, Parameter(converter=samples)] = None,
    noise_share: float = 0.25,
    noise_at: float = 50.0,
    independent_mean: Annotated[bool, Parameter(negative="")] = False,
    exposure: float | None = None,
    diffraction: str | None = None,
    noise: str | None = None,
    variant: str | None = None,
    unit_cm: float | None = None,
    near_infrared: str | None = None,
    illuminant: str | None = None,
    define: Annotated[list[str] | None, Parameter(name=("--define", "-D"), negative="")] = None,
) -> int:
    """Render a capture of a scene: a folder with raw.png, truth.exr and meta.json.

    Args:
        scene: a bundled name (see 'dasim list scenes'; staircase:14 is one of a family), a TOML file, a Mitsuba XML
            file, or a random scene: random:SEED:INDEX, or random:FILE.toml:SEED:INDEX with the distributions in
            FILE.toml; a random scene fills the field of view
        out: output capture folder, out/SCENE by default; an earlier capture there is replaced
        camera: a bundled name (see 'dasim list cameras') or a TOML file
        focus: focus distance in metres; by default the scene's, else the camera's
        seed: seed of all random numbers
        size: WxH pixels, a central crop of the sensor at unchanged pixel pitch
        spp: samples per pixel and stop, or auto: as many as --noise-share requires
        noise_share: target of --spp auto: ratio of rendering noise to sensor noise in each channel
        noise_at: percentile of the pixels at which --noise-share is meant: 50 is the median; at 95, one pixel in twenty
            has more rendering noise
        independent_mean: give mean_e samples of its own, so that its rendering noise is independent of that of raw.png;
            takes about twice as long
        exposure: exposure time in seconds; automatic by default
        diffraction: wave, airy or off
        noise: your own noise model, package.module:function or file.py:function, such as examples/noise_model.py
        variant: Mitsuba variant: auto, cuda_ad_spectral, llvm_ad_spectral or scalar_spectral
        unit_cm: for a Mitsuba XML file, the length of its unit in cm; 100 by default
        near_infrared: for a Mitsuba XML file, the rule for its RGB surfaces: print, dyed or achromatic (the default)
        illuminant: for a Mitsuba XML file, the spectrum of its RGB lights; D65 by default
        define: for a Mitsuba XML file, name=value: the value of its parameter $name (may be repeated)
    """
    import dasim
    from dasim.base.loading import load_function
    from dasim.base.toml import parse
    from dasim.files.folders import check_output
    from dasim.random_scenes.scene import by_name, is_random
    from dasim.render import backend
    from dasim.simulation.checks import check_camera, check_options

    out = options.default_out(scene) if out is None else out
    check_output(out, "capture")
    check_options(spp, seed, diffraction, noise_share, noise_at)
    choices: dict[str, Any] = {"unit_cm": unit_cm, "near_infrared": near_infrared, "illuminant": illuminant}
    choices["define"] = None if define is None else options.definitions(define)
    options_given = {name: value for name, value in choices.items() if value is not None}
    whole = view = dasim.load_camera(camera)
    if size is not None:
        view = dasim.cropped(whole, *options.size(size))
    described: dasim.Scene | dasim.MitsubaScene
    if is_random(scene) and not options_given:
        described, exposure_drawn = by_name(scene, view)
    else:
        described, exposure_drawn = dasim.load_scene(scene, camera=whole, **options_given), dasim.Exposure()
    view = dasim.focused(view, described) if focus is None else dasim.refocused(view, focus)
    chosen_options: dict[str, Any] = {} if spp is None else {"spp": spp}
    if noise is not None:
        chosen_options["noise"] = load_function(noise, "noise model")
    times = exposure_drawn if exposure is None else parse(dasim.Exposure, {"time_s": exposure}, "--exposure")
    check_camera(view, backend.choose(variant).variant)
    options.say_variant(variant)
    with options.progress() as progress:
        shot = dasim.simulate(
            described,
            view,
            seed,
            exposure=times,
            diffraction=diffraction,
            variant=variant,
            noise_share=noise_share,
            noise_at=noise_at,
            independent_mean=independent_mean,
            progress=progress,
            **chosen_options,
        )
    dasim.save_capture(out, shot.capture, shot.truth)
    options.print_capture(shot.capture, out)
    return 0


def calibrate(
    *,
    out: Path | None = None,
    camera: str = "da-mobile",
    focus: float | None = None,
    illuminant: Annotated[list[str] | None, Parameter(negative="")] = None,
    diffraction: str | None = None,
    captures: Path | None = None,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    print_distances: Annotated[bool, Parameter(negative="")] = False,
    save_captures: Path | None = None,
) -> int:
    """Measure a PSF bank from pictures of a point source, simulated or your own.

    Args:
        out: output file of the bank, out/CAMERA.npz by default; an earlier bank there is replaced
        camera: a bundled name or a TOML file
        focus: focus distance in metres; the camera's by default
        illuminant: for simulated pictures, a light of the bank (may be repeated); all lights by default
        diffraction: for simulated pictures: wave (the default), airy or off; use that of the captures
        captures: a folder with your own pictures: raw files, and captures.csv with one line per file (columns file,
            light, depth_m, exposure_s; optionally gain, and position if the source stood at several places)
        format_: for your own pictures: raw10, raw12, raw16 or left-aligned, see 'dasim recon --help'
        print_distances: print the distances from the lens at which to photograph the point source, and exit
        save_captures: write the simulated pictures to this folder in the format that --captures reads, and exit
    """
    import dasim
    import recon
    from dasim.files.banks import save_bank
    from dasim.files.folders import check_output
    from dasim.simulation.calibration import CALIBRATION_LIGHTS
    from dasim.simulation.checks import check_options
    from dasim.spectra import illuminants
    from recon.files.point_pictures import KIND

    model = dasim.load_camera(camera)
    if focus is not None:
        model = dasim.refocused(model, focus)
    if print_distances:
        return _print_distances(model)
    if captures is not None and (illuminant or diffraction or save_captures):
        raise InputError("--captures: your own pictures determine lights and diffraction; omit the other option")
    if save_captures is not None and out is not None:
        raise InputError("--save-captures: writes pictures and no bank; omit --out")
    if captures is None and format_ is not None:
        raise InputError("--format: applies to your own pictures; give their folder with --captures")
    lights = tuple(dict.fromkeys(illuminant or CALIBRATION_LIGHTS))
    for light in lights:
        illuminants.illuminant(light)
    check_options(None, 0, diffraction)
    if save_captures is not None:
        check_output(save_captures, KIND)
        return _save_captures(save_captures, model, lights, diffraction or "wave")
    if out is None:
        out = options.default_out(camera, ".npz")
    _check_bank_output(out)
    with options.progress() as progress:
        if captures is None:
            pictures = dasim.calibration_captures(model, lights, diffraction=diffraction or "wave")
            bank = recon.calibrate(pictures, progress=progress)
        else:
            bank, notes = _measured_bank(captures, model, format_, progress)
            for note in notes:
                print(f"note: {note}")
    save_bank(out, bank)
    print(f"bank: {out} ({', '.join(bank.lights)}; {len(bank.depth_m)} levels, {bank.depth_m[-1]:.3g} to "
          f"{bank.depth_m[0]:.3g} m)")  # fmt: skip
    return 0


def _print_distances(camera: Camera) -> int:
    import numpy as np

    from dasim.camera.geometry import depth_of_blur_m
    from dasim.simulation.calibration import levels, levels_behind
    from recon.files.point_table import DEPTH_TOLERANCE

    (depths, blurs), (behind_m, behind_px) = levels(camera), levels_behind(camera)
    numbers = range(1 - len(behind_m), len(depths))
    depths, blurs = np.append(behind_m[:0:-1], depths), np.append(behind_px[:0:-1], blurs)
    margin = DEPTH_TOLERANCE * (blurs[-1] - blurs[-2])
    nearest, farthest = (depth_of_blur_m(camera, blurs + side * margin) for side in (1, -1))
    farthest = np.where(farthest > 0, farthest, np.inf)
    print(
        f"# camera '{camera.name}' focused at {camera.lens.focus_distance_m:g} m: metres from the lens to the pinhole;"
    )
    print("# a picture is assigned to a level from from_m to to_m; you may stop after any level, without gaps")
    print("level  distance_m   from_m     to_m  blur_px")
    for row in zip(numbers, depths, nearest, farthest, blurs, strict=True):
        print("{:>5}  {:>10.5f}  {:>7.5f}  {:>7.5f}  {:>7.1f}".format(*row))
    return 0


def _save_captures(out: Path, camera: Camera, lights: tuple[str, ...], diffraction: str) -> int:
    from dasim.simulation.calibration import calibration_captures
    from recon.files.point_pictures import write_point_pictures

    count = write_point_pictures(out, calibration_captures(camera, lights, diffraction=diffraction), camera)
    print(f"captures: {out} ({count} pictures of {', '.join(lights)})")
    return 0


def _measured_bank(
    folder: Path, camera: Camera, kind: str | None, progress: Progress
) -> tuple[PsfBank, tuple[str, ...]]:
    """A bank from a user's own pictures, and notes on it."""
    from dasim.simulation.calibration import levels, levels_behind
    from dasim.spectra import illuminants
    from recon import calibrate as calibrate_bank
    from recon.files.point_pictures import read_point_pictures

    behind = len(levels_behind(camera)[0]) - 1
    pictures = read_point_pictures(
        folder, camera, *levels(camera), known_light=illuminants.illuminant, behind=behind, kind=kind, progress=progress
    )
    return calibrate_bank(pictures.pictures, camera, progress=progress), pictures.notes


def _check_bank_output(out: Path) -> None:
    """Raise InputError if the output exists and is not a bank."""
    from dasim.files.banks import load_bank

    if out.is_dir():
        raise InputError(f"output {out}: is a folder; a bank is one .npz file")
    if out.exists():
        try:
            load_bank(out)
        except InputError:
            raise InputError(f"output {out}: exists and is no PSF bank; choose another name") from None
    for parent in out.resolve().parents:
        if parent.exists():
            if not parent.is_dir():
                raise InputError(f"output {out}: {parent} is a file, not a folder")
            break


def lens(
    prescription: Path,
    *,
    out: AnyOut = None,
    camera: str = "da-mobile",
) -> int:
    """Turn a lens prescription into a camera file: wavefront by field, axial colour, distortion and vignetting.

    Args:
        prescription: a Zemax file (.zmx) or one of Optiland (.json); the extra 'lens' of dasim reads it
        out: camera file (TOML) to be written, out/PRESCRIPTION.toml by default
        camera: a bundled name or a TOML file: stops, sensor and focus
    """
    import dasim
    from dasim.base import atomic
    from dasim.base.toml import to_toml

    target = options.default_out(prescription, ".toml") if out is None else out
    if out is not None or target.exists():
        options.check_new_file(target, "--out")
    result = dasim.camera_from_lens(prescription, camera)
    data = result.model_dump(mode="json", exclude_defaults=True)
    data["stops"] = [
        stop.model_dump(mode="json", exclude_defaults=True) | {"shape": stop.shape} for stop in result.stops
    ]
    atomic.write(target, f"# Lens of {prescription.name}\n{to_toml(data)}")
    print(dasim.describe(result))
    print(f"camera: {target}")
    return 0


def emva(
    *,
    out: AnyOut = None,
    camera: str = "da-mobile",
    channel: str = "G",
    gain: float = 1.0,
    seed: Whole = 0,
    size: Size = "256x256",
) -> int:
    """Write frames of a uniformly lit sensor, with the descriptor that the EMVA 1288 reference analyser reads.

    Args:
        out: output folder, out/CAMERA-emva by default; an earlier measurement there is replaced
        camera: a bundled name or a TOML file; its lens is not used
        channel: channel whose pixels are measured: R, G, B or IR
        gain: analogue gain; a high gain resolves read noise below the rounding step, but clips before the full well
        seed: seed of all random numbers
        size: WxH pixels of the frames
    """
    import dasim
    from dasim.base.toml import parse
    from dasim.files.folders import check_output
    from dasim.simulation.checks import check_options
    from dasim.simulation.emva import KIND, write_measurement

    out = options.default_out(camera, "-emva") if out is None else out
    check_output(out, KIND)
    check_options(None, seed, None)
    model = dasim.load_camera(camera)
    gain = parse(dasim.Exposure, {"gain": gain}, "--gain").gain
    with options.progress() as progress:
        notes = write_measurement(
            out, model, channel=channel, gain=gain, seed=seed, size_px=options.size(size), progress=progress
        )
    for note in notes:
        print(f"note: {note}")
    print(f"EMVA 1288 measurement: {out / 'descriptor.txt'}")
    return 0
