"""The README's Python runs, and its commands and links exist."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dasim.cli import app, run

ROOT = Path(__file__).parents[3]
README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)
DEADLINE_S = 300.0


def commands_of_the_table() -> list[str]:
    """Names after ``dasim`` in the first column of the README's tables."""
    rows = [line for line in TEXT.splitlines() if line.startswith("|")]
    return [name for row in rows for name in re.findall(r"`dasim ([a-z]\w*)", row.split("|")[1])]


def test_readme_has_python_to_run():
    assert BLOCKS, "README.md has no ```python block: it has to show five lines of Python that work"


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_python_of_the_readme_runs(number, tmp_path):
    """Expectation: each block runs as it stands, in a process and a folder of its own, without a warning."""
    command = [sys.executable, "-c", BLOCKS[number]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, f"{BLOCKS[number]}\n{done.stderr}"
    assert "Warning" not in done.stderr, done.stderr


def test_command_table_and_help_name_the_same_commands(capsys):
    """Expectation: every command of the table is in ``dasim --help``, and every command has its line in the table."""
    table = commands_of_the_table()
    assert table, "README.md has no table of commands with rows as '| `dasim render ...` | ... |'"
    assert run(["--help"]) == 0
    output = capsys.readouterr().out
    missing = sorted({name for name in table if not re.search(rf"\b{name}\b", output)})
    assert not missing, f"in the README, but not in 'dasim --help': {', '.join(missing)}"
    unnamed = sorted({name for name in app if not name.startswith("-")} - set(table))
    assert not unnamed, f"in 'dasim --help', but not in the README: {', '.join(unnamed)}"


def test_options_of_the_command_table_exist(capsys):
    """Expectation: every option that a row of the table shows is in that command's help."""
    for row in (line for line in TEXT.splitlines() if re.match(r"\|\s*`dasim ", line)):
        usage = re.findall(r"`([^`]*)`", row)[0]
        name = usage.split()[1]
        assert run([name, "--help"]) == 0
        output = capsys.readouterr().out
        for option in re.findall(r"--[a-z][\w-]*", usage):
            assert re.search(rf"{option}\b", output), f"'dasim {name}' has no {option}"


@pytest.mark.parametrize("address", sorted(set(re.findall(r"\]\(([^)#]+)\)", TEXT))))
def test_links_of_the_readme_lead_somewhere(address):
    """Expectation: what is no web address is a file of the project, its pictures included."""
    if not re.match(r"[a-z]+:", address):
        assert (ROOT / address).exists(), address
