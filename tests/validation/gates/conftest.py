"""Claims and limits made up for the tests of gates."""

from __future__ import annotations

import pytest

from tests.support.claim_runs import LIMITS
from tests.support.fake_claims import FAKES
from validation.gates.limits import all_gates


@pytest.fixture
def fakes(monkeypatch, tmp_path, tmp_path_factory, renderer):
    """The command with made-up claims and limits."""
    file = tmp_path / "bundled.toml"
    file.write_text(LIMITS)
    monkeypatch.setattr("validation.claims.table.CLAIMS", FAKES)
    monkeypatch.setattr("validation.gates.limits.all_gates", lambda table, users: all_gates(table, users, file))
    monkeypatch.setattr("dasim.cli.options.say_variant", lambda variant: None)
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.chdir(tmp_path)
    return tmp_path
