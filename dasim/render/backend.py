"""Choice of the Mitsuba variant: the fastest one that works on this computer.

Each variant is tested by a small render in a separate process, because a faulty variant does not raise an exception:
Dr.Jit 1.5 with LLVM 16 or older aborts ("LLVM ERROR: Cannot select ... fminimum"), and a graphics driver may crash or
hang. The results are stored in the cache folder, so that later starts skip the tests.
``python -m dasim.render.backend`` prints the choice.
"""

from __future__ import annotations

import contextlib
import ctypes
import glob
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dasim.base import atomic
from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.base.suggestions import did_you_mean

VARIANTS = ("cuda_ad_spectral", "llvm_ad_spectral", "scalar_spectral")  # fastest first
OLDEST_LLVM = 17  # with Dr.Jit 1.5, LLVM 15 and 16 abort, 19 and 22 work
PROBE_TIMEOUT_S = 60.0  # a test takes below 1 s, with a graphics driver that starts some seconds
# After this time a failed variant is tested again: a driver may have been installed, or a high load be over.
FAILURE_LIFETIME_S = 24 * 3600.0
KERNELS_SIZE = "512M"  # limit of the kernel cache; a set of kernels takes less than 10 MB
LANES = 1 << 19  # rays per batch, which bounds the memory: about 250 bytes per ray
# A batch costs 30 to 60 ms of Python, however few rays it has. A graphics card should trace rays faster, so its batches
# are larger; they take 2 GB.
GPU_LANES = 1 << 23

LLVM_FOLDERS = (
    str(Path(sys.prefix) / "lib"),  # conda
    "/usr/lib",
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64/llvm*/lib*",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_LLVM_NAME = re.compile(r"libLLVM(-\d[\w.]*)?\.(so[\d.]*|dylib)")
# Files that show whether a graphics card and its driver are installed.
_GPU_FILES = ("/dev/nvidia0", "/dev/dxg", "/proc/driver/nvidia/version", "/usr/lib/*-linux-gnu/libcuda.so*")

_VERSION_PROGRAM = """
import ctypes, sys
parts = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*[ctypes.byref(part) for part in parts])
print(*[part.value for part in parts])
"""

# A small render with a lens, a loop of bounces, a reflectance curve, and minima and maxima of floats.
_PROBE_PROGRAM = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # an abort is an expected result: write no core file
except (ImportError, ValueError, OSError):
    pass
import drjit as dr
import mitsuba as mi
mi.set_variant(sys.argv[1])
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 4},
    "sensor": {
        "type": "thinlens", "aperture_radius": 0.01, "focus_distance": 2.0, "fov": 60,
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 4},
    },
    "ball": {
        "type": "sphere", "center": [0, 0, 3],
        "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": [(400, 0.2), (800, 0.8)]}},
    },
    "light": {
        "type": "constant",
        "radiance": {"type": "regular", "wavelength_min": 380, "wavelength_max": 830, "values": "1, 2"},
    },
})
image = mi.render(scene, seed=1)
total = dr.sum(dr.maximum(dr.minimum(image.array, 1e6), 0.0))
total = total if isinstance(total, float) else total[0]
print("OK" if 0.0 < total < 1e6 else f"the test picture is wrong: its sum is {total}")
"""

_active: Choice | None = None


@dataclass(frozen=True)
class Choice:
    """A variant that works on this computer, and the reason for choosing it in one line."""

    variant: str
    reason: str
    llvm_path: str | None = None
    llvm: str | None = None  # version, major.minor


def choose(variant: str | None = None) -> Choice:
    """The variant of a name, or the fastest variant that works for ``auto``.

    Without a name, the environment variable ``DASIM_VARIANT`` decides, and ``auto`` where it is not set. Raises
    InputError if the name is unknown or the variant does not work on this computer.
    """
    where = "variant" if variant is not None else "DASIM_VARIANT"
    request = variant if variant is not None else os.environ.get("DASIM_VARIANT") or "auto"
    if request not in ("auto", *VARIANTS):
        hint = did_you_mean(request, ("auto", *VARIANTS))
        raise InputError(f"{where} '{request}' is unknown; allowed are auto, {', '.join(VARIANTS)}{hint}")
    if _active is not None and request in ("auto", _active.variant):
        return _active
    names = VARIANTS if request == "auto" else (request,)
    results = _results(names)
    name = names[-1] if request != "auto" else next((n for n in names if results.get(n, {}).get("works")), None)
    if name is None:
        why = "; ".join(f"{n}: {results[n]['why']}" for n in names)
        raise InputError(f"no variant of Mitsuba works on this computer ({why}); reinstall the package mitsuba")
    if not results[name]["works"]:
        raise InputError(
            f"{where} '{name}' does not work on this computer ({results[name]['why']}); {_advice(name)}, or use 'auto'"
        )
    result = results[name]
    reason = _reason(name, result, by_name=request != "auto")
    return Choice(name, reason, result.get("llvm_path"), result.get("llvm"))


def lanes() -> int:
    """Rays that are traced at once in the active variant; fixed for each, because they decide the random numbers."""
    import mitsuba as mi

    return GPU_LANES if mi.variant().startswith("cuda") else LANES


def use_threads(count: int) -> None:
    """Set the number of rendering threads; with several, sums may differ in their last bits."""
    import drjit

    drjit.set_thread_count(count)


@contextlib.contextmanager
def reading_threads() -> Iterator[None]:
    """Ensure two threads while Mitsuba reads or writes files: its EXR code waits forever for a second one."""
    import drjit

    count = drjit.thread_count()
    if count < 2:
        drjit.set_thread_count(2)
    try:
        yield
    finally:
        if count < 2:
            drjit.set_thread_count(count)


def release_memory() -> None:
    """Release memory that a picture left in the pools of Dr.Jit and of the C library.

    Batches of varying sizes would otherwise accumulate. It is called after each irradiance field and each picture, and
    takes some 2 ms.
    """
    import drjit

    drjit.sync_thread()  # arrays of kernels that still run are not in the pools yet
    drjit.flush_malloc_cache()
    with contextlib.suppress(OSError, AttributeError, TypeError):  # glibc alone has it
        ctypes.CDLL(None).malloc_trim(0)


def activate(choice: Choice) -> None:
    """Activate a variant in this process; raises InputError if another one is active already."""
    global _active
    if _active is not None and _active.variant != choice.variant:
        raise InputError(
            f"variant '{choice.variant}': this process already uses '{_active.variant}', and cannot change it; "
            f"start a new process"
        )
    if choice.llvm_path is not None and _active is None:
        os.environ["DRJIT_LIBLLVM_PATH"] = choice.llvm_path  # Dr.Jit reads it in the first set_variant
    keep_kernels()
    import drjit as dr
    import mitsuba as mi

    dr.set_log_level(dr.LogLevel.Error)
    if mi.variant() != choice.variant:
        mi.set_variant(choice.variant)
    mi.set_log_level(mi.LogLevel.Error)
    _active = choice


def keep_kernels() -> None:
    """Store compiled kernels in the cache folder, at most ``KERNELS_SIZE``, unless the user has set Dr.Jit's variables.

    Dr.Jit reads these environment variables when it starts, and then deletes the least recently used kernels, in one
    process per hour. If the folder cannot be written to, Dr.Jit's own folder is used.
    """
    folder = cache_dir() / "kernels"
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.environ.setdefault("DRJIT_CACHE_DIR", str(folder))
    os.environ.setdefault("DRJIT_CACHE_MAXSIZE", KERNELS_SIZE)


def _results(names: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Test results by name, up to the first variant that works, from the cache where it has them."""
    libraries = llvm_libraries()
    file = cache_dir() / f"backend-{_cache_key(libraries)}.json"
    results = _read_cache(file)
    is_new = False
    for name in names:
        if name not in results:
            results[name] = _try_llvm(libraries) if name == "llvm_ad_spectral" else _try(name)
            is_new = True
        if results[name]["works"]:
            break
    if is_new:
        _write_cache(file, results)
    return results


# --- tests of variants ---------------------------------------------------------------------------


def _try(variant: str, llvm_path: str | None = None) -> dict[str, Any]:
    """Result of a small render in a separate process: ``works``, and ``why`` not, in one line."""
    problem = _run((_PROBE_PROGRAM, variant), llvm_path=llvm_path)[1]
    return {"works": problem is None, "why": problem}


def _try_llvm(libraries: list[str]) -> dict[str, Any]:
    """Result of the LLVM variant with the first library that works: the user's own, then the others, newest first.

    Libraries older than ``OLDEST_LLVM`` are left out.
    """
    users_path = os.environ.get("DRJIT_LIBLLVM_PATH")
    versions = {path: _llvm_version(path) for path in libraries}
    usable = [path for path in libraries if versions[path] >= (OLDEST_LLVM,)]
    problems = []
    for path in sorted(usable, key=lambda path: (path == users_path, versions[path]), reverse=True):
        result = _try("llvm_ad_spectral", path)
        if result["works"]:
            ignored = users_path if users_path and path != users_path else None
            major, minor = versions[path][:2]
            return {"works": True, "llvm_path": path, "llvm": f"{major}.{minor}", "ignored": ignored}
        problems.append(f"{path}: {result['why']}")
    return {"works": False, "why": "; ".join(problems) or f"no LLVM of version {OLDEST_LLVM} or newer was found"}


def llvm_libraries() -> list[str]:
    """Distinct paths of LLVM libraries: that of ``DRJIT_LIBLLVM_PATH``, then those in the usual folders."""
    paths: dict[str, str] = {}
    users_path = os.environ.get("DRJIT_LIBLLVM_PATH")
    if users_path:
        paths[os.path.realpath(users_path)] = users_path
    for folder in LLVM_FOLDERS:
        for path in sorted(glob.glob(f"{folder}/libLLVM*")):
            if _LLVM_NAME.fullmatch(os.path.basename(path)):
                paths.setdefault(os.path.realpath(path), os.path.realpath(path))
    return list(paths.values())


def _llvm_version(path: str) -> tuple[int, ...]:
    """Version of an LLVM library; empty where it is none, or older than 16, which has no function for it."""
    output, problem = _run((_VERSION_PROGRAM, path))
    try:
        return tuple(int(part) for part in output.split()) if problem is None else ()
    except ValueError:
        return ()


def _run(program: tuple[str, ...], llvm_path: str | None = None) -> tuple[str, str | None]:
    """Output of a Python program in a separate process, and its problem in one line, or None."""
    environment = dict(os.environ)
    if llvm_path is not None:
        environment["DRJIT_LIBLLVM_PATH"] = llvm_path
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-c", *program],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return "", f"it took longer than {PROBE_TIMEOUT_S:g} s"
    except OSError as error:
        return "", str(error)
    if process.returncode < 0:
        return "", f"the process crashed with signal {-process.returncode}"
    if process.returncode > 0:
        lines = process.stderr.strip().splitlines()
        return "", lines[-1][:200] if lines else f"the process ended with status {process.returncode}"
    if program[0] is _PROBE_PROGRAM and process.stdout.split()[-1:] != ["OK"]:
        return "", process.stdout.strip()[-200:] or "no answer"
    return process.stdout, None


# --- messages ------------------------------------------------------------------------------------


def _reason(variant: str, result: dict[str, Any], *, by_name: bool) -> str:
    """Reason for the choice of a variant, in one line; ``by_name`` where the user named it."""
    if variant == "cuda_ad_spectral":
        return f"{variant} (NVIDIA graphics card)"
    if variant == "llvm_ad_spectral":
        ignored = result.get("ignored")
        note = f"; DRJIT_LIBLLVM_PATH={ignored} does not work and is not used" if ignored else ""
        return f"{variant} (LLVM {result['llvm']}){note}"
    if by_name:
        return f"{variant}, as requested"
    return f"{variant}, about four times slower: there is no LLVM library that works; {_advice('llvm_ad_spectral')}"


def _advice(variant: str) -> str:
    """Advice on how to make a variant work."""
    if variant == "cuda_ad_spectral":
        return "it needs an NVIDIA graphics card with a recent driver"
    if variant == "scalar_spectral":
        return "reinstall the package mitsuba"
    if sys.platform == "darwin":
        return "'brew install llvm' installs one"
    if Path("/etc/debian_version").exists():
        return "'apt-get install libllvm19' installs one"
    return f"install LLVM {OLDEST_LLVM} or newer, or set DRJIT_LIBLLVM_PATH to its library"


# --- cache ---------------------------------------------------------------------------------------


def _cache_key(libraries: list[str]) -> str:
    """Hash of everything that the results depend on: code, LLVM libraries, and this computer."""
    facts: list[Any] = [sys.executable, platform.platform(), platform.machine(), platform.node()]
    facts += [os.environ.get("DRJIT_LIBLLVM_PATH"), os.environ.get("CUDA_VISIBLE_DEVICES")]
    facts += [_stamp(path) for path in libraries]
    facts += [_stamp(path) for pattern in _GPU_FILES for path in sorted(glob.glob(pattern))]
    return fingerprint(choose, variant="", values=[json.dumps(facts)])


def _stamp(path: str) -> list[Any]:
    """Path, size and time of change of a plain file; only whether it exists for devices and files of the kernel."""
    if not os.path.isfile(path) or path.startswith("/proc/"):
        return [path, os.path.exists(path)]
    status = os.stat(path)
    return [path, status.st_size, status.st_mtime_ns]


def _read_cache(file: Path) -> dict[str, dict[str, Any]]:
    """Stored results without expired failures; none where the file is missing, damaged or of another form."""
    try:
        cached = json.loads(file.read_text(encoding="utf-8"))
        fresh = time.time() - file.stat().st_mtime < FAILURE_LIFETIME_S
        results = {name: cached[name] for name in VARIANTS if name in cached}
        for name, result in results.items():
            whole = name != "llvm_ad_spectral" or {"llvm_path", "llvm"} <= result.keys()
            if not ((result["works"] is True and whole) or (result["works"] is False and "why" in result)):
                return {}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}
    return {name: result for name, result in results.items() if result["works"] or fresh}


def _write_cache(file: Path, results: dict[str, dict[str, Any]]) -> None:
    """Store the results; a folder that cannot be written to is not an error."""
    with contextlib.suppress(OSError):
        atomic.write(file, json.dumps(results, indent=1))


def main() -> int:
    """Print the choice and its reason; exit status 0 for a JIT variant, 3 where only the scalar one works."""
    try:
        choice = choose("auto")
    except InputError as error:
        print(error, file=sys.stderr)
        return 3
    print(choice.reason)
    return 0 if choice.variant != "scalar_spectral" else 3


if __name__ == "__main__":
    sys.exit(main())
