"""The commands demo and validate.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dasim.base import atomic
from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.listing import list_claims
from dasim.cli.options import Out, Whole


def demo(*, out: Out = Path("out/demo"), variant: str | None = None, spp: Whole | None = None) -> int:
    """Run the whole chain on a bundled scene and write report.html, view.html and results.json.

    Args:
        out: output folder; an earlier result there is replaced
        variant: Mitsuba variant, auto by default
        spp: samples per pixel and stop
    """
    from dasim.files.folders import check_output
    from dasim.simulation.checks import check_options
    from validation.demo import run_demo
    from validation.reports.headlines import headlines
    from validation.reports.lines import of_headlines

    check_output(out, "demo")
    check_options(spp, 0, None)
    options.say_variant(variant)
    start = time.monotonic()
    with options.progress() as progress:
        entries = run_demo(out, variant=variant, spp=spp, progress=progress)
    print("\n".join(of_headlines(headlines(entries), time.monotonic() - start)))
    print(f"all {len(entries)} figures: {out / 'results.json'}")
    print(f"report: {out / 'report.html'}")
    return 1 if any(entry.passed is False for entry in entries) else 0


def validate(
    *,
    out: Out = Path("out/validate"),
    list_: Annotated[bool, Parameter(name="--list", negative="")] = False,
    only: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    gates: Path | None = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    seeds: Whole = 1,
    jobs: Whole = 1,
    method: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    compare: Path | None = None,
    fail_on_worse: Annotated[bool, Parameter(negative="")] = False,
    propose_gates: Path | None = None,
    verbose: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Test simulator and reconstruction against closed forms and independent methods; writes report and junit.xml.

    A claim is not measured again if code, data, libraries and renderer are the same as in an earlier run.

    Args:
        out: output folder; an earlier result there is replaced
        list_: list the claims and exit
        only: ids of the claims to measure, separated by spaces or commas; all by default
        quick: measure only claims that take less than about 20 s each
        gates: a TOML file with limits, added to the bundled ones; a key that is bundled replaces the bundled limit
        fresh: measure every claim again
        seeds: number of seeds; with 3, each claim that uses random numbers is measured with the seeds 0, 1 and 2, and
            its figures are means with their standard deviation
        jobs: number of claims measured at the same time, each in its own process
        method: a further depth method for the claims about depth and all-in-focus pictures: your function as
            package.module:function or file.py:function, or NAME=file.py:function to name its figures
        compare: results.json of an earlier run; prints which figures improved and which got worse
        fail_on_worse: with --compare, exit status 1 if a figure got worse by more than its spread
        propose_gates: write a TOML file for --gates, with limits from means and spread over --seeds
        verbose: print every figure, not only those that are not within their limits
    """
    from dasim.files.folders import check_output
    from dasim.render import backend
    from validation.claims.table import CLAIMS
    from validation.gates.comparison import changes, load_results, report
    from validation.gates.limits import all_gates
    from validation.gates.outcome import check_methods, failed, select
    from validation.gates.proposal import gate_file
    from validation.gates.run import earlier_durations, measured_claims
    from validation.methods import named
    from validation.reports.lines import of_outcomes, total
    from validation.validate import write_claims

    if only is not None and not options.names(only):
        raise InputError("--only: names no claim; see --list")
    names = select(CLAIMS, options.names(only), quick=quick)
    limits = all_gates(CLAIMS, gates)
    methods = named(method or ())
    check_methods(CLAIMS, names, methods)
    if list_:
        list_claims(names, verbose=False)
        return 0
    for option, number in (("--jobs", jobs), ("--seeds", seeds)):
        if number < 1:
            raise InputError(f"{option} {number}: must be 1 or more")
    if propose_gates is not None:
        if seeds < 2:
            raise InputError(
                "--propose-gates: requires --seeds of at least 2, because the margin comes from their spread"
            )
        options.check_new_file(propose_gates, "--propose-gates")
    if fail_on_worse and compare is None:
        raise InputError("--fail-on-worse: requires --compare with the results.json of an earlier run")
    earlier = None if compare is None else load_results(compare)
    check_output(out, "validation")
    options.say_variant(None)
    variant = backend.choose().variant
    start = time.monotonic()
    with options.stages("claims", earlier_durations(names, CLAIMS, seeds, methods)) as progress:
        measure = partial(
            measured_claims, names, CLAIMS, limits,
            variant=variant, seeds=seeds, fresh=fresh, jobs=jobs, methods=methods, progress=progress,
        )  # fmt: skip
        outcomes = write_claims(out, measure)
    entries = [entry for outcome in outcomes for entry in outcome.claims]
    print("\n".join(of_outcomes(outcomes, every_figure=verbose)))
    print(total(outcomes, time.monotonic() - start))
    again = sum(outcome.stored for outcome in outcomes)
    if again:
        print(f"{again} of {len(outcomes)} claims were taken from an earlier run; --fresh measures them again")
    if propose_gates is not None:
        figures = [(entry, outcome.seeds) for outcome in outcomes for entry in outcome.claims]
        atomic.write(propose_gates, gate_file(figures))
        print(f"limits: {propose_gates}")
    differences = [] if earlier is None else changes(earlier, entries, set(names))
    if earlier is not None:
        print("\n".join(report(differences)))
    print(f"report: {out / 'report.html'}")
    worse = fail_on_worse and any(change.verdict == "worse" for change in differences)
    return 1 if worse or failed(outcomes) else 0
