"""The commands ``dasim study``: parse and print."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts
from cyclopts import Parameter

from dasim.cli.datasets import processes_of
from dasim.cli.options import Whole

if TYPE_CHECKING:
    from dasim.executors import Executor

app = cyclopts.App(name="study", help="Compare aperture designs: by simulation, by bounds, by a search of shapes.")


@app.default
@app.command
def sweep(
    study: str,
    *,
    out: Annotated[str | None, Parameter(name="--out")] = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    jobs: Whole | None = None,
    executor: Literal["local", "ray"] = "local",
    address: str = "auto",
    variant: str | None = None,
) -> int:
    """Simulate, reconstruct and score designs over a grid; results.csv, results.parquet and report.html.

    A sweep that was stopped goes on where it was; points that were measured are not measured again.

    Args:
        study: hole-size, lens, cut-wavelengths, mosaic, stereo, or a TOML file
        out: a folder, or an fsspec address such as s3://bucket/folder; out/NAME of the study by default
        quick: the study's few most telling points
        jobs: processes of the local executor; by default one for each core
        executor: local, or ray for the nodes of a cluster (extra 'cluster')
        address: of Ray: auto, or ray://host:port
        variant: Mitsuba variant, auto by default
    """
    from dasim import executors
    from dasim.dataset.sample import environment
    from dasim.render import backend
    from validation.studies.point import Sweep, work
    from validation.studies.specification import load_study
    from validation.studies.sweep import PAGE
    from validation.studies.sweep import sweep as run_sweep

    spec = load_study(study, quick=quick)
    place = out or f"out/{spec.name}"
    here = environment(backend.choose(variant).variant)
    local = executor == "local"
    run: Executor = executors.local(processes_of(jobs), work) if local else executors.ray(address, work)
    with _shown(spec.name) as show:
        failed = run_sweep(Sweep(spec, place, here), run, show)
    for point, said in failed.items():
        print(f"not measured: {point}: {said}")
    print(f"report: {place}/{PAGE}")
    return 1 if failed else 0


@contextmanager
def _shown(name: str) -> Iterator[Callable[[int, int, int], None]]:
    """A progress bar with the time left on a terminal; elsewhere a line for each point."""
    import sys

    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True)
    text = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.MofNCompleteColumn())
    with bars.Progress(*text, bars.TimeRemainingColumn(), console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=None)

        def show(done: int, total: int, failed: int) -> None:
            bar.update(task, completed=done + failed, total=total)
            if not console.is_terminal:
                print(f"{name}: {done} of {total}" + (f", {failed} failed" if failed else ""), file=sys.stderr)

        yield show
