"""Settings as a value that a user can print, change and find again."""

import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse_toml
from recon import settings as known
from recon.settings import PRESETS, Settings


@pytest.mark.parametrize("name", [*PRESETS, None])
def test_printed_settings_are_read_back(tmp_path, name):
    told = Settings(crosstalk=(0.5, 0.25, 1e-3), window_px=21, denoise=False) if name is None else PRESETS[name]
    (tmp_path / "mine.toml").write_text(known.to_toml(told))
    assert parse_toml(Settings, tmp_path / "mine.toml") == told == known.chosen(None, tmp_path / "mine.toml")
    assert known.preset_name(told) == name


def test_presets_are_chosen_by_name(tmp_path):
    assert known.chosen(None, None) == PRESETS["bands"]
    assert known.chosen("chakrabarti-zickler", None) == PRESETS["chakrabarti-zickler"]
    with pytest.raises(InputError, match="'mine' is unknown; allowed are paper, "):
        known.chosen("mine", None)
    with pytest.raises(InputError, match="give one"):
        known.chosen("paper", tmp_path / "mine.toml")
