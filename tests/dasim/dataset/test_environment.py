"""The environment of a dataset: graphics cards and their driver."""

from __future__ import annotations

from dasim.dataset import environment
from dasim.render import backend


def test_graphics_cards_and_driver_are_part_of_the_environment(tmp_path, monkeypatch):
    """Expectation: their models and driver with CUDA, where the driver tells; nothing with LLVM."""
    monkeypatch.setattr(backend, "choose", lambda variant: backend.Choice(variant, "a test"))
    monkeypatch.setattr(environment, "NVIDIA", tmp_path)
    of = environment.environment.__wrapped__
    assert of("cuda_ad_spectral")["gpu"] == []
    (tmp_path / "version").write_text("NVRM version: NVIDIA Kernel Module  1.2\nGCC version: 3\n")
    for number in range(2):
        folder = tmp_path / "gpus" / str(number)
        folder.mkdir(parents=True)
        (folder / "information").write_text("Model: \t\t NVIDIA Abacus\nIRQ:   \t\t 7\n")
    assert of("cuda_ad_spectral")["gpu"] == ["NVIDIA Abacus", "NVRM version: NVIDIA Kernel Module  1.2"]
    assert "gpu" not in of("llvm_ad_spectral")
