"""The studies that the tests of sweeps share."""

from __future__ import annotations

import pytest

from tests.support.small_study import REFERENCE, STUDY
from validation.studies.sweep import report
from validation.studies.sweep.loading import load_study


@pytest.fixture
def study(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(STUDY)
    return file


@pytest.fixture
def undrawn(monkeypatch):
    """Sweeps without their pictures, which take a second."""
    monkeypatch.setattr(report, "page", lambda *parts: "")


@pytest.fixture
def referred(study):
    text = STUDY.replace("[0.3, 0.46]", "[0.3, 0.46, 0.65]").replace("[parameters]", REFERENCE + "[parameters]")
    study.write_text(text)
    return load_study(str(study))
