"""The table of ``dasim study bound``."""

from __future__ import annotations

from dasim.cli import run


def test_the_command_prints_the_bound_and_names_all_mistakes(capsys) -> None:  # type: ignore[no-untyped-def]
    assert run(["study", "bound", "--count", "3"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in out[2:5]] == ["24.00", "8.28", "5.00"]
    assert run(["study", "bound", "--lux", "-1", "--channels", "G", "--near-cm", "60"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    for part in ("--lux", "--channels", "near side"):
        assert part in message
