"""Limits and gates: what their files may say, and which figures they find."""

from __future__ import annotations

import math

import pytest

from dasim.base.errors import InputError
from tests.support.fake_claims import FAKES
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, Gate, all_gates, gate_of, judged_all, load_gates, within
from validation.reports.lines import of_claims
from validation.scores.figures import Figure


@pytest.mark.parametrize(
    ("limit", "inside", "outside"),
    [
        ("<= 0.02", (0.02, -1), (0.0201, math.nan, math.inf)),
        ("< -0.6", (-0.7,), (-0.6, 0, math.nan)),
        (">= 50", (50, math.inf), (49.9, math.nan)),
        ("> 0", (1e-9,), (0, -1, math.nan)),
        ("0.195..0.199", (0.195, 0.197, 0.199), (0.1949, 0.2, math.nan)),
        ("-1e-3 .. 1e-3", (0,), (0.002,)),
    ],
)
def test_limits(limit, inside, outside):
    """Expectation: what was not measured (NaN) keeps no limit."""
    assert all(within(value, limit) for value in inside)
    assert not any(within(value, limit) for value in outside)


@pytest.mark.parametrize("limit", ["", "0.5", "= 0.5", "<= x", "<= nan", "1..", "<= 1 px"])
def test_unreadable_limits_are_refused(limit, tmp_path):
    (tmp_path / "gates.toml").write_text(f'["good.size"]\nlimit = "{limit}"\n')
    with pytest.raises(InputError, match=r"gates.toml.*good.size.limit"):
        load_gates(tmp_path / "gates.toml", FAKES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('["nothing.size"]\nlimit = "> 0"\n', r"nothing.size.*good, stopped"),
        ('["good"]\nlimit = "> 0"\n', r"'good'.*CLAIM.FIGURE"),
        ('["good.size"]\nwhy = "so"\n', r"good.size.limit: is missing"),
        ('["good.size"]\nlimit = "> 0"\ncolour = 1\n', r"good.size.colour: unknown key"),
        ('good = "> 0"\n', r"gates.toml.*good"),
        ("[[[", "not valid TOML"),
    ],
)
def test_wrong_gates_are_refused(text, message, tmp_path):
    (tmp_path / "gates.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_gates(tmp_path / "gates.toml", FAKES)


@pytest.mark.parametrize(
    ("key", "figure_id", "matches"),
    [
        ("depth.bands.desk.raw", "depth.bands.desk.raw", True),
        ("depth.bands.*.raw", "depth.bands.desk.raw", True),
        ("depth.bands.*.raw", "depth.bands.desk.raw-ratio", False),
        ("depth.bands.*", "depth.bands.desk.raw", False),
        ("depth.*.desk.raw", "depth.my.desk.raw", True),
        ("depth.*.desk.raw", "depth.my.own.desk.raw", False),
        ("depth.*.desk.raw", "depth.file.py:function.desk.raw", False),
        ("depth.file.py:function.*.raw", "depth.file.py:function.desk.raw", True),
        ("light-levels.{D65,A}.order", "light-levels.A.order", True),
        ("light-levels.{D65,A}.order", "light-levels.D55.order", False),
        ("light-levels.*.order", "light-levels.my.D65.order", False),
    ],
)
def test_a_gate_names_figures_part_by_part(key, figure_id, matches):
    """Expectation: a * is one name between dots, never a part of one, nor several."""
    assert Gate(key, "> 0", "").matches(figure_id) is matches


@pytest.mark.parametrize(
    "key", ["good.si*", "good.[abc]", "good.s?ze", "good.{a,b", "good.{}", "good.{a.b}", "good.", "good..size"]
)
def test_keys_that_could_catch_a_name_by_accident_are_refused(key, tmp_path):
    (tmp_path / "gates.toml").write_text(f'["{key}"]\nlimit = "> 0"\n')
    with pytest.raises(InputError, match=r"gates.toml.*for one name between dots"):
        load_gates(tmp_path / "gates.toml", FAKES)


def test_users_gate_wins_and_a_figures_own_before_a_pattern(tmp_path):
    (tmp_path / "bundled.toml").write_text('["good.*"]\nlimit = "<= 1"\n["good.size"]\nlimit = "<= 2"\n')
    (tmp_path / "users.toml").write_text('["good.*"]\nlimit = "<= 3"\n')
    bundled = all_gates(FAKES, None, tmp_path / "bundled.toml")
    assert gate_of("good.size", bundled).limit == "<= 2" and gate_of("good.other", bundled).limit == "<= 1"
    both = all_gates(FAKES, tmp_path / "users.toml", tmp_path / "bundled.toml")
    assert gate_of("good.size", both).limit == gate_of("good.other", both).limit == "<= 3"
    assert gate_of("bad.size", both) is None


def test_a_limit_that_finds_no_figure_fails(tmp_path):
    (tmp_path / "gates.toml").write_text('["good.length"]\nlimit = "> 0"\n')
    entries = judged_all("good", [Figure("size", 1.0, "px", "a size")], load_gates(tmp_path / "gates.toml", FAKES))
    assert [(entry.id, entry.passed) for entry in entries] == [("good.size", None), ("good.length", False)]
    (missing,) = judged_all("good", [], [Gate("good.sise", "> 0", "")])[-1:]
    (mistyped,) = judged_all("good", [Figure("size", 1.0, "px", "a size")], [Gate("good.sise", "> 0", "")])[-1:]
    assert "did you mean" not in missing.source and "did you mean 'good.size'?" in of_claims([mistyped])[0]


def test_bundled_limits_are_readable_and_say_where_they_come_from():
    gates = load_gates(GATES, CLAIMS)
    assert gates and all(len(gate.why) > 20 for gate in gates)
