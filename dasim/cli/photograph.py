"""The commands render, lens and emva.

Tested in tests/dasim/cli/test_render.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import AnyOut, Size, Whole, samples


def render(
    scene: str,
    *,
    out: AnyOut = None,
    camera: str = "da-mobile",
    focus: float | None = None,
    seed: Whole = 0,
    size: Size | None = None,
    spp: Annotated[int | str | None, Parameter(converter=samples)] = None,
    noise_share: float | None = None,
    noise_at: float | None = None,
    independent_mean: Annotated[bool, Parameter(negative="")] = False,
    exposure: options.Seconds | None = None,
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
        seed: seed of rendering and of temporal sensor noise; the fixed pattern has its own, sensor.sensor_seed
        size: WxH pixels, a central crop of the sensor at unchanged pixel pitch
        spp: samples per pixel and stop, by default 64; or auto: as many as --noise-share requires
        noise_share: target of --spp auto: ratio of rendering noise to sensor noise in each channel; 0.25 by default
        noise_at: percentile of the pixels to which --noise-share applies; 50, the median, by default; at 95, one pixel
            in twenty has more rendering noise
        independent_mean: give mean_e samples of its own, so that its rendering noise is independent of that of raw.png;
            takes about twice as long
        exposure: exposure time in seconds, such as 0.02 or 1/60; automatic by default
        diffraction: wave, airy or off; by default wave, and airy with scalar_spectral, which has no wave
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
    from dasim.simulation.adaptive_sampling import NOISE_AT, NOISE_SHARE
    from dasim.simulation.checks import check_camera, check_options

    out = options.default_out(scene) if out is None else out
    check_output(out, "capture")
    if spp != "auto" and (noise_share, noise_at) != (None, None):
        raise InputError("--noise-share, --noise-at: are the target of --spp auto; give it too, or leave them out")
    noise_share = NOISE_SHARE if noise_share is None else noise_share
    noise_at = NOISE_AT if noise_at is None else noise_at
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
    times = exposure_drawn
    if exposure is not None:
        times = parse(dasim.Exposure, {"time_s": options.seconds("--exposure", exposure)}, "--exposure")
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
        seed: seed of the temporal noise; the fixed pattern has its own, sensor.sensor_seed
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
