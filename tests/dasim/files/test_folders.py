"""Result folders are written as a whole or not at all."""

from __future__ import annotations

import pytest

from dasim.files import folders

OWN = '{"software": {"dasim": "0"}}'


def test_failure_leaves_nothing_behind(tmp_path):
    """Expectation: an exception in the block leaves neither the folder nor a temporary one, and keeps an old result."""
    with pytest.raises(ZeroDivisionError), folders.new_folder(tmp_path / "out", "capture") as folder:
        (folder / "half.txt").write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    with folders.new_folder(tmp_path / "out", "capture") as folder:
        (folder / "meta.json").write_text(OWN)
    with pytest.raises(KeyboardInterrupt), folders.new_folder(tmp_path / "out", "capture"):
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "meta.json").read_text() == OWN
