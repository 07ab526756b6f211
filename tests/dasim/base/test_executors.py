"""Executors: one process per graphics card."""

from __future__ import annotations

import multiprocessing
import os
from types import SimpleNamespace

from dasim.base import executors
from dasim.cli.datasets import processes_of
from tests.support.datasets import inline


def test_one_process_per_graphics_card(monkeypatch):
    """Set-up: three processes, of which only the variables are made, where two cards may be used.

    Expectation: each has one card, in turn; the commands start four processes per card, but at most one per core.
    """
    seen: list[str] = []

    class Process:
        def __init__(self, **described):
            pass

        def start(self):
            seen.append(os.environ["CUDA_VISIBLE_DEVICES"])

    context = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=Process)
    monkeypatch.setattr(executors.multiprocessing, "get_context", lambda kind: context)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2,5")
    for place in range(3):
        executors._start(None, place, inline, gpu=True)
    assert seen == ["2", "5", "2"]
    assert os.environ["CUDA_VISIBLE_DEVICES"] == "2,5"
    for cores, processes in ((1, 2), (6, 6), (64, 2 * executors.PER_CARD)):
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid, cores=cores: set(range(cores)), raising=False)
        assert processes_of(None, len(executors.gpus())) == processes
    assert processes_of(3, len(executors.gpus())) == 3
