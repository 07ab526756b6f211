"""Figures of a score compared with a user's limits, and the files that ``dasim score`` writes.

Tested in tests/validation/test_methods.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dasim.base import atomic
from dasim.base.errors import InputError
from dasim.files.folders import check_output_file
from validation.gates.claim import Claim, plain_value
from validation.gates.junit import write_junit
from validation.gates.limits import judged_all, load_gates
from validation.gates.outcome import Outcome
from validation.scores.figures import Figure

FIGURE_KEYS = {"value", "unit"}  # of each figure in the file that ``--json`` names


def judged_score(what: str, figures: Sequence[Figure], gates: Path | None) -> list[Claim]:
    """Compare the figures with the limits of a file, whose keys are WHAT.FIGURE, such as
    ``score.raw.all.level-median``.
    """
    return judged_all(what, figures, [] if gates is None else load_gates(gates, [what]))


def write_score(
    what: str,
    entries: Sequence[Claim],
    *,
    json_file: Path | None,
    junit: Path | None,
    more: dict[str, Any] | None = None,
) -> None:
    """Write the figures as JSON (value, unit and any limit by id) and as JUnit XML."""
    if json_file is not None:
        content: dict[str, Any] = {}
        for entry in entries:
            limits = {} if entry.limit is None else {"limit": entry.limit, "passed": entry.passed}
            content[entry.id.removeprefix(f"{what}.")] = {
                "value": plain_value(entry.value),
                "unit": entry.unit,
                **limits,
            }
        atomic.write(json_file, json.dumps(content | (more or {}), indent=1) + "\n")
    if junit is not None:
        write_junit(junit, [Outcome(what, "", list(entries), 0.0)], f"dasim {what}")


def check_score_files(json_file: Path | None, junit: Path | None) -> None:
    """Refuse, before the work begins, to overwrite a file other than an earlier score or to write into a missing
    folder.
    """
    if json_file is not None and junit is not None and json_file.resolve() == junit.resolve():
        raise InputError(f"--json and --junit are both {json_file}; name two files")
    for option, out in (("--json", json_file), ("--junit", junit)):
        if out is None:
            continue
        if not out.parent.is_dir():
            raise InputError(f"{option} {out}: {out.parent} is not a folder")
        check_output_file(out)
        if out.exists() and not (_is_score(out) if option == "--json" else _is_junit(out)):
            raise InputError(f"{option} {out}: exists and is not an earlier score; choose another name")


def _is_score(file: Path) -> bool:
    try:
        earlier = json.loads(file.read_text(encoding="utf-8"))
        return all(key == "samples" or set(figure) >= FIGURE_KEYS for key, figure in earlier.items())
    except (OSError, ValueError, AttributeError, TypeError):
        return False


def _is_junit(file: Path) -> bool:
    return file.is_file() and b"<testsuites" in file.read_bytes()[:200]
