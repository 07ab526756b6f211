"""Claim on graphics cards: Mitsuba's CUDA variant against its LLVM variant, in time, memory and pictures."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import dasim
from dasim.base.errors import InputError
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.render import backend
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.chance import by_chance
from validation.scores.figures import Figure
from validation.subjects.rendering import NotRun, block_means

CARD, PROCESSOR = "cuda_ad_spectral", "llvm_ad_spectral"
NAMES = {CARD: "cuda", PROCESSOR: "llvm"}
TIMED_SCENE = "desk"
SIZES_PX = {"512x384": (512, 384), "3Mpx": (2048, 1536)}
RANDOM_SEED, RANDOM_SCENES, RANDOM_SIZE_PX = 7, 6, (512, 384)
COMPARED = ("desk", 0, 3)  # bundled scenes by name, random scenes by number
COMPARED_SIZE_PX, COMPARED_SPP, COMPARED_SEEDS = (96, 72), 64, 16
BLOCK_PX = 8
POLL_S = 0.2

# One process per variant: a process cannot change it.
_RUN = """
import json, sys
from validation.claims.cost import graphics_card
variant, out = sys.argv[1:]
print("\\n" + json.dumps(graphics_card.measured(variant, out)))
"""


def graphics_card(progress: ShareDone) -> Evidence:
    """A graphics card shows the same pictures as the processor, faster.

    Rationale: large datasets are rendered on graphics cards, and must not differ from those of processors.

    Set-up: da-mobile, wave-true blur. Times are those of captures with ground truth by ``--spp auto`` with compiled
    kernels, in one process per variant: ``desk`` at 512 x 384 px and at 3 Mpx, and six random scenes at 512 x 384 px,
    whose mean gives the captures per hour. The memory of the card is the most that is allocated on it, less that
    before. Pictures are compared at 96 x 72 px with 64 samples per pixel and stop: ``desk`` and two random scenes, 16
    seeds with each variant. Without LLVM, the times of the card are measured alone.

    Expectation: the mean square difference of ``mean_e`` between the variants, over blocks of 8 x 8 pixels relative to
    their noise, is no larger than after random exchanges of pictures between the variants. This permutation test is
    used because neighbouring blocks share irradiance noise. Times depend on this computer and its current load.

    Limit: p at least 0.001 in each channel and scene; the means of the pictures agree within 0.3 %; times and memory
    are reported without a limit, since cards differ.

    Source: the LLVM variant, which the other claims measure.
    """
    try:
        backend.choose(CARD)
    except InputError as error:
        raise NotRun(f"the variant {CARD} does not work here: {error}") from error
    runs: dict[str, dict[str, Any]] = {}
    pictures: dict[str, dict[str, FloatArray]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for done, (variant, name) in enumerate(NAMES.items()):
            with contextlib.suppress(InputError):  # without LLVM, times of the card alone
                backend.choose(variant)
                file = Path(folder) / f"{name}.npz"
                runs[name] = _run(variant, file)
                pictures[name] = dict(np.load(file))
            progress((done + 1) / len(NAMES))
    figures = _times(runs)
    if len(pictures) == len(NAMES):
        for scene in COMPARED:
            figures += _agreement(str(scene), *(pictures[name][str(scene)] for name in NAMES.values()))
    head = ["variant", *SIZES_PX, "random scene", "captures per hour", "memory of the card, GB"]
    return Evidence(figures, [], [("Seconds per capture", head, _rows(runs))])


def _times(runs: dict[str, dict[str, Any]]) -> list[Figure]:
    found = []
    for name, run in runs.items():
        for size, seconds in run["seconds"].items():
            text = f"{TIMED_SCENE}, {size}: seconds per capture"
            found.append(Figure(f"{name}.seconds.{size}", seconds, "s", text))
        found.append(Figure(f"{name}.rate", 3600 / run["random_s"], "1/h", "random scenes per hour, one process"))
        if "card_gb" in run:
            found.append(Figure(f"{name}.memory", run["card_gb"], "GB", "largest memory of the card"))
    return found


def _rows(runs: dict[str, dict[str, Any]]) -> list[list[str]]:
    return [
        [
            name,
            *(f"{seconds:.2f}" for seconds in run["seconds"].values()),
            f"{run['random_s']:.2f}",
            f"{3600 / run['random_s']:.0f}",
            f"{run['card_gb']:.2f}" if "card_gb" in run else "",
        ]
        for name, run in runs.items()
    ]


def _agreement(scene: str, card: FloatArray, processor: FloatArray) -> list[Figure]:
    """P-values and relative difference of pictures [seed, h, w, channel]."""
    what = scene if not scene.isdigit() else f"random scene {scene}"
    blocks = block_means(card, BLOCK_PX), block_means(processor, BLOCK_PX)
    difference = card.mean(axis=(0, 1, 2)) / processor.mean(axis=(0, 1, 2)) - 1
    figures = []
    for channel, colour in enumerate(channels(dasim.load_camera("da-mobile").sensor)):
        value = by_chance(*(part[..., channel].reshape(len(part), -1) for part in blocks))
        text = f"{what}, {colour}: probability of such differences between block means by chance"
        figures.append(Figure(f"agreement.p.{scene}.{colour}", value, "1", text))
        text = f"{what}, {colour}: relative difference of the picture's mean"
        figures.append(Figure(f"agreement.mean.{scene}.{colour}", float(difference[channel]), "1", text))
    return figures


def _run(variant: str, file: Path) -> dict[str, Any]:
    """What :func:`measured` finds in a process of its own, and the memory of the card in it."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(dasim.__file__).parents[1]), *sys.path])}
    with _card_memory() as memory_gb:
        command = [sys.executable, "-c", _RUN, variant, str(file)]
        process = subprocess.run(command, env=environment, capture_output=True, text=True)
    if process.returncode != 0:
        message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
        raise RuntimeError(f"rendering with {variant} failed: {message}")
    found = dict(json.loads(process.stdout.splitlines()[-1]))
    return found | ({"card_gb": max(memory_gb) - memory_gb[0]} if variant == CARD and memory_gb else {})


@contextlib.contextmanager
def _card_memory() -> Iterator[list[float]]:
    """Allocated memory of the first card in GB, at intervals; empty where ``nvidia-smi`` is missing."""
    found: list[float] = []
    program = shutil.which("nvidia-smi")
    command = [program or "", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
    ended = threading.Event()

    def watch() -> None:
        while not ended.is_set():
            with contextlib.suppress(OSError, ValueError, IndexError):
                text = subprocess.run(command, capture_output=True, text=True).stdout
                found.append(float(text.splitlines()[0]) * 2**20 / 1e9)
            ended.wait(POLL_S)

    thread = threading.Thread(target=watch, daemon=True)
    if program:
        thread.start()
    try:
        yield found
    finally:
        ended.set()
        if program:
            thread.join()


def measured(variant: str, file: str) -> dict[str, Any]:
    """Seconds of the captures that are timed with a variant; pictures to compare go to ``file``."""
    mobile, desk = dasim.load_camera("da-mobile"), dasim.load_scene(TIMED_SCENE)
    spec = dasim.RandomScenes(floating=True)  # the scenes that other figures were measured on

    def timed(scene: Scene | MitsubaScene, camera: Camera) -> float:
        begin = time.perf_counter()
        dasim.simulate(scene, camera, 0, spp="auto", variant=variant)
        return time.perf_counter() - begin

    def random(number: int, size_px: tuple[int, int]) -> tuple[Scene, Camera]:
        camera = dasim.cropped(mobile, *size_px)
        scene = dasim.random_scene(RANDOM_SEED, number, spec, camera)
        return scene, dasim.focused(camera, scene)

    seconds = {}
    for number, (name, size_px) in enumerate(SIZES_PX.items()):
        camera = dasim.focused(dasim.cropped(mobile, *size_px), desk)
        if number == 0:
            timed(desk, camera)  # compiles
        seconds[name] = timed(desk, camera)
    random_s = []
    for number in range(RANDOM_SCENES):
        scene, camera = random(number, RANDOM_SIZE_PX)
        timed(scene, dasim.cropped(camera, *COMPARED_SIZE_PX))  # compiles
        random_s.append(timed(scene, camera))
    pictures: dict[str, Any] = {}
    for which in COMPARED:
        subject = (desk, dasim.focused(dasim.cropped(mobile, *COMPARED_SIZE_PX), desk))
        drawn = random(int(which), COMPARED_SIZE_PX) if isinstance(which, int) else subject
        shots = [dasim.simulate(*drawn, seed, spp=COMPARED_SPP, variant=variant) for seed in range(COMPARED_SEEDS)]
        pictures[str(which)] = np.stack([shot.truth.mean_e for shot in shots]).astype(np.float64)
    np.savez(file, **pictures)
    return {"seconds": seconds, "random_s": float(np.mean(random_s))}
