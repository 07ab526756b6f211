"""Settings: TOML round trip, and selection by preset or file."""

import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse_toml
from recon import settings as known
from recon.settings import PRESETS, Settings


@pytest.mark.parametrize("name", [*PRESETS, None])
def test_settings_survive_a_round_trip_through_toml(tmp_path, name):
    settings = Settings(crosstalk=(0.5, 0.25, 1e-3), window_px=21, denoise=False) if name is None else PRESETS[name]
    (tmp_path / "mine.toml").write_text(known.to_toml(settings))
    assert parse_toml(Settings, tmp_path / "mine.toml") == settings == known.select(None, tmp_path / "mine.toml")
    assert known.preset_name(settings) == name


def test_presets_are_selected_by_name(tmp_path):
    assert known.select(None, None) == PRESETS["best"]
    assert known.select("chakrabarti-zickler", None) == PRESETS["chakrabarti-zickler"]
    with pytest.raises(InputError, match="'mine' is unknown; allowed are paper, "):
        known.select("mine", None)
    with pytest.raises(InputError, match="give one of them"):
        known.select("paper", tmp_path / "mine.toml")
