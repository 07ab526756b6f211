"""Two runs of one dataset, of which the second is disturbed, and what differs."""

from __future__ import annotations

import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tests.support.datasets import spec_file, sums

ROOT = Path(__file__).parents[2]
RANDOM_SCENES = "depth_cm = [20, 80]\nobjects = [5, 8]\nsurfaces = 2\ntextured_share = 0.0\n"
POLL_S = 0.1
PAUSE_S = 1.5
FARTHEST_CLOCK_S = 400 * 24 * 3600.0
FEWEST_FOR_MEMORY = 200  # samples: in shorter runs, memory is that of compiling and loading
MOST_GROWTH = 1.15  # of the median memory of the last quarter of a run over that of the second, from the first shard on
# Of every Python process below: the clock is off, and jumps once in a hundred calls.
CLOCK = """
import os, random, time
_off, _now, _chance = float(os.environ.get("SOAK_CLOCK_S", "0")), time.time, random.Random()
def _wrong():
    global _off
    if _off and _chance.random() < 0.01:
        _off = -_off
    return _now() + _off
time.time = _wrong
"""


def soak(folder: Path, samples: int, seed: int, scenes: str, calm_s: float, say: Callable[[str], object]) -> list[str]:
    """Make a dataset twice, the second time disturbed, and return what is wrong: nothing, if all is well.

    Disturbances are SIGKILL of all processes or of one, SIGTERM, SIGSTOP for ``PAUSE_S``, a full disk for as long (a
    tmpfs, where this user may mount one), and in half of the runs a clock that is off by up to ``FARTHEST_CLOCK_S``
    and jumps. Between two of them, all processes together have ``calm_s`` seconds of processor time on average, so that
    a run on a busy computer comes as far as on a free one.
    """
    spec = _spec(folder, samples, seed, scenes)
    (folder / "clock").mkdir()
    (folder / "clock" / "sitecustomize.py").write_text(CLOCK)
    calm, rough = folder / "calm", folder / "rough"
    memory_mb, start = _calm(spec, calm), time.monotonic()
    problems = _growth(memory_mb) if samples >= FEWEST_FOR_MEMORY else []
    room = _small_disk(rough, sum(file.stat().st_size for file in calm.rglob("*") if file.is_file()))
    try:
        done = _rough(spec, rough, random.Random(seed), calm_s, room)
        problems += done.pop("problems")
        problems += _differences(calm, rough)
    finally:
        if room:
            subprocess.run(["umount", "-l", str(rough)], check=False)
    quarters = statistics.quantiles(memory_mb, n=4) if len(memory_mb) > 3 else memory_mb
    say(
        f"{samples} samples of seed {seed}: {done['runs']} runs, "
        + ", ".join(f"{count} {name}" for name, count in sorted(done["events"].items()))
        + (f"; memory {min(quarters):.0f} to {max(quarters):.0f} MB" if quarters else "")
        + f"; {time.monotonic() - start:.0f} s disturbed"
    )
    return problems


def _spec(folder: Path, samples: int, seed: int, scenes: str) -> Path:
    top = f"seed = {seed}"
    path = spec_file(folder, samples=samples, top=top, samples_per_shard=20)
    if scenes == "random":
        text = path.read_text()
        begin, end = text.index("[scenes]"), text.index("[exposure]")
        path.write_text(text[:begin] + f'[scenes]\nfamily = "random"\n[scenes.random]\n{RANDOM_SCENES}' + text[end:])
    return path


def _started(spec: Path, out: Path, clock_s: float = 0.0) -> subprocess.Popen[bytes]:
    """A run of the command in a session of its own."""
    program = "from dasim.cli import main; main()"
    path = os.pathsep.join([str(out.parent / "clock"), str(ROOT), *filter(None, sys.path)])
    return subprocess.Popen(
        [sys.executable, "-c", program, "dataset", "make", str(spec), "--out", str(out), "--jobs", "2"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": path, "SOAK_CLOCK_S": str(clock_s)},
        start_new_session=True,
    )


def _ended(run: subprocess.Popen[bytes]) -> str:
    """Standard error of a run, when it has ended."""
    return run.communicate()[1].decode(errors="replace").strip()


def _session(run: subprocess.Popen[bytes]) -> dict[int, tuple[float, float]]:
    """Processes of a run, their resident memory in MB and the processor time that they have had in seconds."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and os.getsid(int(entry.name)) == run.pid:
                pages = int((entry / "statm").read_text().split()[1])
                ticks = sum(map(int, (entry / "stat").read_text().rpartition(")")[2].split()[11:13]))
                found[int(entry.name)] = pages * os.sysconf("SC_PAGE_SIZE") / 1e6, ticks / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError):  # it has ended meanwhile
            continue
    return found


def _calm(spec: Path, out: Path) -> list[float]:
    """Memory of all processes of an undisturbed run from its first shard on, MB."""
    run = _started(spec, out)
    memory_mb = []
    while run.poll() is None:
        if any(out.glob("*.tar")):  # the first shard is made, and all code loaded
            memory_mb.append(sum(memory for memory, _ in _session(run).values()))
        time.sleep(POLL_S)
    said = _ended(run)
    assert run.returncode == 0, said
    return memory_mb


def _growth(memory_mb: list[float]) -> list[str]:
    """Whether memory grows from the second to the last quarter of a run; the first is its start."""
    size = len(memory_mb) // 4
    if size < 5:
        return []
    second, last = statistics.median(memory_mb[size : 2 * size]), statistics.median(memory_mb[-size:])
    return [f"memory grows from {second:.0f} to {last:.0f} MB"] if last > MOST_GROWTH * second else []


def _small_disk(out: Path, content_bytes: int) -> bool:
    """Mount a tmpfs with room for a dataset and its intermediate files; False where this user may not."""
    out.mkdir()
    size = f"size={4 * content_bytes + 2_000_000}"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(out)], check=False, capture_output=True)
    return mounted.returncode == 0


def _rough(spec: Path, out: Path, chance: random.Random, calm_s: float, room: bool) -> dict:
    """Runs with disturbances until the dataset is finished: their number, the events, and messages that are wrong."""
    events: Counter[str] = Counter()
    problems: list[str] = []
    kinds = ["kill of all", "kill of one", "pause", "stop", *(["full disk"] if room else [])]
    runs = 0
    while not (out / "SHA256SUMS").exists() and len(problems) < 5:
        run = _started(spec, out, chance.choice([0.0, chance.uniform(-1, 1) * FARTHEST_CLOCK_S]))
        runs += 1
        while run.poll() is None:
            _let_work(run, chance.expovariate(1 / calm_s))
            if run.poll() is None:
                kind = chance.choice(kinds)
                events[kind] += 1
                _disturb(run, kind, out, chance)
        said = _ended(run)
        (out / "balloon").unlink(missing_ok=True)
        if run.returncode not in (0, 1, 2, 143, -signal.SIGKILL) or "Traceback" in said:
            problems.append(f"a run ended with {run.returncode}: {said[-600:]}")
        while _session(run):  # workers whose coordinator was killed end with their samples
            time.sleep(POLL_S)
    return {"runs": runs, "events": events, "problems": problems}


def _wait(run: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait some seconds, or until a run ends."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and run.poll() is None:
        time.sleep(POLL_S)


def _let_work(run: subprocess.Popen[bytes], seconds: float) -> None:
    """Wait until the processes of a run have had some more seconds of processor time, or it ends."""
    had = {process: time_s for process, (_, time_s) in _session(run).items()}
    worked = 0.0
    while worked < seconds and run.poll() is None:
        time.sleep(POLL_S)
        now = {process: time_s for process, (_, time_s) in _session(run).items()}
        worked += sum(time_s - had.get(process, 0.0) for process, time_s in now.items())
        had = now


def _disturb(run: subprocess.Popen[bytes], kind: str, out: Path, chance: random.Random) -> None:
    """Do one of the things of :func:`soak` to a run."""
    if kind == "full disk":
        _fill(out)
        _wait(run, PAUSE_S)
        (out / "balloon").unlink(missing_ok=True)
    elif kind == "pause":
        os.killpg(run.pid, signal.SIGSTOP)
        time.sleep(PAUSE_S)
        os.killpg(run.pid, signal.SIGCONT)
    elif kind == "stop":
        run.send_signal(signal.SIGTERM)
    elif kind == "kill of one":
        _kill(chance.choice(sorted(_session(run)) or [run.pid]))
    else:
        for process in _session(run):
            _kill(process)


def _kill(process: int) -> None:
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        pass


def _fill(out: Path) -> None:
    """Fill the disk of a folder with one file."""
    try:
        with (out / "balloon").open("wb") as file:
            while True:
                file.write(bytes(65536))
    except OSError:
        return


def _differences(calm: Path, rough: Path) -> list[str]:
    """What is wrong with a disturbed dataset beside an undisturbed one."""
    if not (rough / "SHA256SUMS").exists():
        return ["the disturbed dataset is not finished"]
    problems = [f"left: {path.name}" for path in rough.rglob("*") if path.name.endswith(".partial")]
    first, second = sums(calm), sums(rough)
    problems += [
        f"{name} differs" for name in sorted(first.keys() | second.keys()) if first.get(name) != second.get(name)
    ]
    program = "from dasim.cli import main; main()"
    checked = subprocess.run(
        [sys.executable, "-c", program, "dataset", "verify", str(rough)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])},
    )
    return problems + ([f"verify: {checked.stdout[-300:]}{checked.stderr[-300:]}"] if checked.returncode else [])
