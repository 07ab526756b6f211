"""The bundled limits: which figure has which, and that none limits a user's method by accident."""

from __future__ import annotations

from pathlib import Path

import pytest

from dasim.base.errors import InputError
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, Gate, gate_of, judged_all, load_gates
from validation.scores.figures import Figure

FIGURES = Path(__file__).with_name("limits.tsv")


@pytest.fixture(scope="module")
def gates():
    return load_gates(GATES, CLAIMS)


@pytest.fixture(scope="module")
def figures() -> dict[str, str | None]:
    """Limit of each figure that the claims measure, as it was listed from results."""
    lines = [line.split("\t") for line in FIGURES.read_text().splitlines() if not line.startswith("#")]
    return {name: None if limit == "none" else limit for name, limit in lines}


def test_every_figure_has_the_limit_that_is_listed(gates, figures):
    """A gate that is written anew limits what it limited before, and nothing else."""
    assert {name.partition(".")[0] for name in figures} == set(CLAIMS)
    limits_found = {name: gate_of(name, gates) for name in figures}
    assert {name: gate and gate.limit for name, gate in limits_found.items()} == figures


def test_every_gate_limits_a_figure(gates, figures):
    used = {gate.key for gate in (gate_of(name, gates) for name in figures) if gate is not None}
    assert [gate.key for gate in gates if gate.key not in used] == []


@pytest.mark.parametrize(
    ("text", "words"), [("", "holds no limit"), ('["off-axis.a"]\nlimit = "3..1"\n', "the smaller end comes first")]
)
def test_a_file_that_limits_nothing_is_refused(tmp_path, text, words):
    """Rationale: a truncated file would let everything pass."""
    (tmp_path / "gates.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        load_gates(tmp_path / "gates.toml", CLAIMS)


def test_a_gate_for_several_figures_needs_each_of_them():
    """Expectation: of the names in braces, one without a figure fails by its own name; ``*`` needs one figure."""
    gates = [Gate("c.{R,G}.noise", "<= 1", ""), Gate("c.*.bias", "<= 1", "")]
    found = judged_all("c", [Figure("R.noise", 0.5, "1", ""), Figure("R.bias", 0.5, "1", "")], gates)
    assert [(entry.id, entry.passed) for entry in found] == [
        ("c.R.noise", True), ("c.R.bias", True), ("c.G.noise", False),
    ]  # fmt: skip


def test_a_name_may_contain_a_decimal_point():
    gates = [Gate("c.best.depth.*.abs-rel", "<= 1", ""), Gate("c.{0.5,1.5}.bias", "<= 1", "")]
    assert gate_of("c.best.depth.0.2-0.4-m.abs-rel", gates) is gates[0]
    assert gate_of("c.0.5.bias", gates) is gates[1]
    assert gates[1].keys == ["c.0.5.bias", "c.1.5.bias"]
    assert gate_of("c.best.depth.near.0.2-0.4-m.abs-rel", gates) is None


@pytest.mark.parametrize("method", ["mine", "depth_method.py:ratio", "D65", "desk"])
def test_no_bundled_limit_is_for_a_users_method(gates, figures, method):
    """Its figures are CLAIM.METHOD.FIGURE: the bundled method's name exchanged, or put in where figures name none."""
    theirs = set()
    for name in figures:
        claim, first, *rest = name.split(".")
        bundled = [bundled_method.name for bundled_method in CLAIMS[claim].methods]
        if bundled:
            theirs.add(".".join([claim, method, *([] if first in bundled else [first]), *rest]))
    assert len(theirs) > 100
    assert [name for name in theirs if gate_of(name, gates) is not None] == []
