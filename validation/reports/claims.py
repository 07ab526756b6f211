"""The report page of ``dasim validate``.

Tested in tests/validation/gates/test_run.py and tests/validation/reports/test_claims_page.py.
"""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Sequence

import jinja2
from markupsafe import Markup, escape

from dasim.base.durations import words
from validation.gates.claim import Claim
from validation.gates.limits import LIMIT_FROM
from validation.gates.outcome import Outcome, by_verdict, verdict
from validation.reports.page import TEMPLATE_DIR

WIDE = 1.9

_LABEL = re.compile(r"(Rationale|Set-up|Expectation|Limit|Deviation|Source): ")
_VIEW = re.compile(rb'viewBox="0 0 ([\d.]+) ([\d.]+)"')  # of an SVG


def claims_page(outcomes: Sequence[Outcome]) -> str:
    """HTML page with the figures outside their limits, then one line per claim, failed ones first, which opens to its
    text, figures and pictures; one file that loads nothing else.
    """
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    entries = [(outcome, entry) for outcome in outcomes for entry in outcome.claims]
    environment.filters["code"] = code
    judged = [entry for _, entry in entries if entry.passed is not None]
    counts = {
        "passed": sum(entry.passed is True for entry in judged),
        "failed": sum(entry.passed is False for entry in judged),
        "reported": sum(entry.passed is None and not outcome.not_run for outcome, entry in entries),
        "not_run": sum(bool(outcome.not_run) for outcome in outcomes),
    }
    return environment.get_template("claims.html").render(
        outcomes=by_verdict(outcomes),
        missed=[entry for entry in judged if not entry.passed],
        counts=counts,
        sentence=sentence,
        paragraphs=paragraphs,
        number=number,
        verdict=verdict,
        words=words,
        judged_first=judged_first,
        meaning=meaning,
        wide=wide,
        beside=beside,
    )


def sentence(text: str) -> str:
    """First paragraph of a docstring, in one line."""
    return " ".join(text.split("\n\n")[0].split())


def code(text: str) -> Markup:
    """Escaped text with ``names`` marked up as code."""
    return Markup(re.sub(r"``([^`]+)``", r"<code>\1</code>", str(escape(text))))


def judged_first(claims: Sequence[Claim]) -> list[Claim]:
    """The figures in the order that a reader needs: failed, passed, without a limit; else unchanged."""
    return sorted(claims, key=lambda claim: (False, True, None).index(claim.passed))


def meaning(claim: Claim) -> str:
    """Description of a figure, without the origin of its limit, which stands beside the gate."""
    return claim.source.partition(LIMIT_FROM)[0]


def paragraphs(text: str) -> list[tuple[str, str]]:
    """The paragraphs of a docstring after the first, each with its label (empty if it has none)."""
    result = []
    for paragraph in text.split("\n\n")[1:]:
        line = " ".join(paragraph.split())
        label = _LABEL.match(line)
        result.append((label[1], line[label.end() :]) if label else ("", line))
    return result


def wide(address: str) -> bool:
    """Whether a picture is more than WIDE times as wide as high, as rows of panels are; it then gets the full width of
    the page.
    """
    head, _, data = address.partition(",")
    if head.startswith("data:image/png;base64"):
        width, height = struct.unpack(">II", base64.b64decode(data[:32])[16:24])  # the first chunk, IHDR
        return bool(width > WIDE * height)
    view_box = _VIEW.search(base64.b64decode(data[:4096])) if head.startswith("data:image/svg+xml;base64") else None
    return view_box is not None and float(view_box[1]) > WIDE * float(view_box[2])


Beside = tuple[list[str], list[tuple[str, str, list[float | None]]]]


def beside(outcome: Outcome) -> Beside | None:
    """A user's methods beside the bundled ones: the names of the methods, and rows of figure, unit and one value per
    method.

    The figures are named CLAIM.METHOD.FIGURE, or CLAIM.FIGURE in claims that measure one bundled method. None if no
    user's method was measured.
    """
    values = {claim.id.removeprefix(f"{outcome.id}."): claim for claim in outcome.claims}
    rows: dict[str, str] = {}
    for method in outcome.users:
        start = f"{method}."
        rows |= {name.removeprefix(start): claim.unit for name, claim in values.items() if name.startswith(start)}
    if not rows:
        return None

    def value(method: str, figure: str) -> float | None:
        entry = values.get(f"{method}.{figure}")
        if entry is None and method == outcome.bundled[0]:
            entry = values.get(figure)
        return None if entry is None else entry.value

    methods = [*outcome.bundled, *outcome.users]
    table = [(figure, unit, [value(method, figure) for method in methods]) for figure, unit in rows.items()]
    places = [place for place in range(len(methods)) if any(cells[place] is not None for *_, cells in table)]
    return [methods[place] for place in places], [
        (name, unit, [cells[p] for p in places]) for name, unit, cells in table
    ]


def number(value: float) -> str:
    """The number with four significant digits."""
    return f"{value:.4g}"
