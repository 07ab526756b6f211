"""The commands ``dasim study``: parse arguments and print.

Tested in tests/validation/studies/sweep/test_loading.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts
from cyclopts import Parameter

from dasim.base.durations import words
from dasim.base.errors import InputError
from dasim.cli.datasets import processes_of
from dasim.cli.options import Out, Whole, check_file, counted, out_of, progress
from dasim.scene.lights import LUX_RANGE

if TYPE_CHECKING:
    from dasim.base.executors import Executor
    from dasim.camera.specification import Camera
    from dasim.typing import FloatArray

app = cyclopts.App(
    name="study", help="Compare aperture designs by simulation, by bounds, or by a search for the stop's shape."
)

Texture = Literal["known", "spectrum", "free"]
MOST_DISTANCES = 1000  # of a table


@app.default
@app.command
def sweep(
    study: str,
    *,
    out: Annotated[str | None, Parameter(name="--out")] = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    method: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    jobs: Whole | None = None,
    executor: Literal["local", "ray"] = "local",
    address: str = "auto",
    variant: str | None = None,
) -> int:
    """Simulate, reconstruct and score designs over a grid; writes results.csv, results.parquet and report.html.

    A stopped sweep resumes; points are not measured twice.

    Args:
        study: hole-size, lens, cut-wavelengths, mosaic, stereo (see 'dasim list studies'), or a TOML file
        out: a folder, or an fsspec address such as s3://bucket/folder; out/STUDY by default
        quick: measure only the study's most informative points
        method: a further depth method for the parameter recon.preset: a bundled name, or your function as
            package.module:function or file.py:function
        jobs: processes of the local executor; by default one per core, with graphics cards at most four per card
        executor: local, or ray for a cluster (extra 'cluster')
        address: address of Ray: auto, or ray://host:port
        variant: Mitsuba variant, auto by default
    """
    from dasim.base import executors
    from dasim.dataset.environment import environment
    from dasim.render import backend
    from validation.studies.sweep.loading import load_study
    from validation.studies.sweep.point import Sweep, work
    from validation.studies.sweep.run import PAGE, summary
    from validation.studies.sweep.run import sweep as run_sweep
    from validation.studies.sweep.specification import units

    spec = load_study(study, quick=quick, methods=method or ())
    place = out or out_of(spec.name)
    here = environment(backend.choose(variant).variant)
    gpu = here["variant"].startswith("cuda")
    run: Executor
    if executor == "local":
        run = executors.local(processes_of(jobs, len(executors.gpus()) if gpu else None), work, gpu=gpu)
    else:
        run = executors.ray(address, work, gpu=gpu)
    job = Sweep(spec, place, here)
    start = time.monotonic()
    with counted(spec.name) as show:
        failed = run_sweep(job, run, show)
    for line in summary(job):
        print(line)
    for point, reason in failed.items():
        print(f"not measured: {point}: {reason}")
    pictures = len(units(spec))
    print(f"{pictures - len(failed)} of {pictures} pictures measured, in {words(time.monotonic() - start)}")
    if len(failed) < pictures:
        print(f"report: {place}/{PAGE}")
    return 1 if failed else 0


@app.command
def bound(
    camera: str = "da-mobile",
    *,
    focus: float | None = None,
    near_cm: float | None = None,
    far_cm: float | None = None,
    count: Whole = 8,
    light: str = "D65",
    lux: float = 5000.0,
    texture: Texture = "free",
    channels: str = "G,IR",
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
    csv_file: Annotated[Path | None, Parameter(name="--csv")] = None,
) -> int:
    """Print the Cramer-Rao bound of depth from one patch, the least error of an unbiased estimate, by distance.

    Args:
        camera: a bundled name or a TOML file; its stops may have any shape
        focus: focus distance in metres; the camera's by default
        near_cm: nearest distance in cm, 5 by default
        far_cm: farthest distance in cm, on the near side of the focus with a blur of at least 3 px; by default 24, or
            the last that has one
        count: number of distances, evenly spaced in dioptres
        light: illuminant
        lux: illuminance in lux
        texture: what is known of the texture: its power spectrum, strength and gains (known), the shape of its spectrum
            (spectrum), or nothing (free)
        channels: channels that are compared, the one with the sharp texture first
        json_file: also write the bound, with the camera and the conditions, to this file
        csv_file: also write the table to this file
    """
    from dasim.base import atomic
    from dasim.camera.sensor import channels as sensor_channels
    from dasim.spectra import illuminants
    from validation.studies import bound as bounds
    from validation.studies import criteria

    given = [("--near-cm", near_cm), ("--far-cm", far_cm)]
    wrong = _positive(*((name, value) for name, value in given if value is not None))
    if not 1 <= count <= MOST_DISTANCES:
        wrong.append(f"--count {count}: must be 1 to {MOST_DISTANCES}")
    wrong += _lux_problems(lux)
    names = tuple(name.strip() for name in channels.split(",") if name.strip())
    if len(names) < 2 or len(set(names)) != len(names):
        wrong.append(f"--channels '{channels}': must be two channels or more, such as G,IR")
    wrong += [*check_file("--json", json_file, ".json"), *check_file("--csv", csv_file, ".csv")]
    lens = _focused(camera, focus, wrong)
    known = sensor_channels(lens.sensor)
    if missing := [name for name in names if name not in known]:
        wrong.append(f"--channels: camera '{lens.name}' has no channel {', '.join(missing)}; it has {', '.join(known)}")
    blurs: list[FloatArray] = []
    metres = [None if value is None else value / 100 for value in (near_cm, far_cm)]
    _collect(wrong, lambda: illuminants.illuminant(light))
    _collect(wrong, lambda: blurs.append(criteria.blurs_between(lens, *bounds.range_m(lens, *metres), max(count, 1))))
    if wrong:
        raise InputError("; ".join(wrong))
    patch = bounds.Patch(light, lux, texture, names)
    table = bounds.rows(lens, blurs[0], patch)
    print("\n".join(bounds.lines(lens, patch, table)))
    print(f"{1000 * bounds.seconds_per_design(lens, blurs[0], patch):.0f} ms per design")
    for file, text in ((json_file, bounds.as_json(lens, patch, table)), (csv_file, bounds.as_csv(table))):
        if file is not None:
            atomic.write(file, text)
            print(f"table: {file}")
    return 0


@app.command
def shape(
    camera: str = "da-mobile",
    *,
    out: Out = Path("out/shape"),
    focus: float | None = None,
    budget: float = 0.2116,
    cells: Whole = 64,
    feature_um: float = 80.0,
    seeds: Whole = 5,
    objective: Literal["depth", "all-in-focus"] = "depth",
    near_cm: float = 5.0,
    far_cm: float = 24.0,
    light: str = "D65",
    lux: float = 5000.0,
    texture: Texture = "free",
    quick: Annotated[bool, Parameter(negative="")] = False,
    render: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Search for the shape of the near-infrared stop and compare it with a disc, rings and published codes.

    Args:
        camera: a bundled name or a TOML file
        out: output folder for table.csv, results.json, report.html and masks as PNG, SVG and TOML; an earlier study
            there is replaced
        focus: focus distance in metres; the camera's by default
        budget: open area relative to the lens's, 0.46 squared by default
        cells: number of mask cells across the lens
        feature_um: diameter in um of the smallest open or closed feature
        seeds: number of starts of each kind of search
        objective: minimise the error of depth or of the all-in-focus picture
        near_cm: nearest distance in cm
        far_cm: farthest distance in cm, on the near side of the focus
        light: illuminant
        lux: illuminance in lux
        texture: knowledge of the texture, see 'dasim study bound --help'
        quick: use smaller masks and fewer starts
        render: also simulate and reconstruct the best three and a disc at the rim, minutes each; resumes if stopped
    """
    from dasim.files.folders import check_output
    from validation.studies.shape import files, report
    from validation.studies.shape.study import Plan, check_plan, run_study

    wrong = _positive(("--near-cm", near_cm), ("--far-cm", far_cm), ("--lux", lux), ("--feature-um", feature_um))
    wrong += _lux_problems(lux)
    lens = _focused(camera, focus, wrong)
    if quick:
        cells, seeds = min(cells, 40), min(seeds, 2)
    plan = Plan(
        lens, budget, cells, feature_um, seeds, objective, near_cm / 100, far_cm / 100, light, lux, texture,
        iterations=8 if quick else 20,
    )  # fmt: skip
    for check in (lambda: check_plan(plan), lambda: check_output(out, "study")):
        _collect(wrong, check)
    if wrong:
        raise InputError("; ".join(wrong))
    start = time.monotonic()
    with progress() as show:
        study = run_study(plan, render=render, progress=show)
    files.write_study(study, out)
    for line in report.lines(study):
        print(line)
    print(f"{len(study.rows)} designs in {words(time.monotonic() - start)}")
    print(f"report: {out / 'report.html'}")
    return 0


def _focused(camera: str, focus: float | None, wrong: list[str]) -> Camera:
    """The camera focused at a distance in metres, or as its file says; what is wrong with the distance is collected."""
    from dasim.camera import specification as cameras

    lens = cameras.load_camera(camera)
    focused = [lens]
    if focus is not None:
        _collect(wrong, lambda: focused.append(cameras.refocused(lens, focus)))
    return focused[-1]


def _positive(*options: tuple[str, float]) -> list[str]:
    return [f"{name} {value:g}: must be above 0" for name, value in options if not value > 0]


def _lux_problems(lux: float) -> list[str]:
    return (
        [] if LUX_RANGE[0] <= lux <= LUX_RANGE[1] else [f"--lux {lux:g}: must be {LUX_RANGE[0]:g} to {LUX_RANGE[1]:g}"]
    )


def _collect(wrong: list[str], check: Callable[[], object]) -> None:
    try:
        check()
    except InputError as error:
        wrong.append(str(error))
