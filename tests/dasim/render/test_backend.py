"""The variant is chosen without ever aborting this process, and the choice is remembered."""

from __future__ import annotations

import glob
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.render import backend

OLD_LLVM = sorted(glob.glob("/usr/lib/*-linux-gnu/libLLVM-1[56].so.1"))


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    """Each test has its own cache, no variables of the user's and no variant chosen by an earlier test."""
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("DASIM_VARIANT", raising=False)
    # Set before deleting, so that what a test sets meanwhile is undone too.
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    for name in ("DRJIT_CACHE_DIR", "DRJIT_CACHE_MAXSIZE"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(backend, "_active", None)


@pytest.fixture
def no_system_llvm(monkeypatch):
    """The usual folders hold no LLVM."""
    monkeypatch.setattr(backend, "LLVM_FOLDERS", ())


@pytest.fixture
def rubbish_llvm(tmp_path, monkeypatch):
    """A file that is named LLVM 99 but is not a library, chosen by the user."""
    path = tmp_path / "libLLVM.so.99"
    path.write_bytes(b"\x7fELF rubbish" * 100)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(path))
    return path


@pytest.fixture
def started(monkeypatch):
    """List of the programs that were started; each answers without running, and only the scalar variant works."""
    programs: list[tuple[str, ...]] = []

    def answer(program, llvm_path=None):
        programs.append(program)
        return ("OK", None) if program[1] == "scalar_spectral" else ("", "not here")

    monkeypatch.setattr(backend, "_run", answer)
    return programs


def test_scalar_variant_works_everywhere():
    choice = backend.choose("scalar_spectral")
    assert choice == backend.Choice("scalar_spectral", "scalar_spectral, as requested", None)


def test_unknown_variant_is_the_users_mistake(monkeypatch):
    with pytest.raises(InputError, match=r"variant 'llvm_rgb' is unknown; allowed are auto, cuda_ad_spectral, "):
        backend.choose("llvm_rgb")
    monkeypatch.setenv("DASIM_VARIANT", "fast")
    with pytest.raises(InputError, match=r"DASIM_VARIANT 'fast' is unknown"):
        backend.choose()


def test_variable_is_the_default_and_an_argument_overrides_it(started, monkeypatch):
    monkeypatch.setenv("DASIM_VARIANT", "scalar_spectral")
    assert backend.choose().reason == "scalar_spectral, as requested"
    assert len(started) == 1
    assert "about four times slower" in backend.choose("auto").reason


def test_variant_that_does_not_work_says_what_to_try(started):
    with pytest.raises(
        InputError, match=r"'cuda_ad_spectral' does not work on this computer \(not here\); .*NVIDIA.* 'auto'"
    ):
        backend.choose("cuda_ad_spectral")
    with pytest.raises(InputError, match=r"'llvm_ad_spectral' does not work on this computer .*LLVM.* 'auto'"):
        backend.choose("llvm_ad_spectral")


def test_rubbish_library_leads_to_the_scalar_variant(rubbish_llvm, no_system_llvm):
    assert backend.llvm_libraries() == [str(rubbish_llvm)]
    choice = backend.choose()
    assert choice.variant in ("scalar_spectral", "cuda_ad_spectral")
    with pytest.raises(InputError, match="no LLVM of version 17 or newer was found"):
        backend.choose("llvm_ad_spectral")


def test_a_broken_library_is_ignored_where_another_works(rubbish_llvm, monkeypatch):
    monkeypatch.setattr(backend, "_llvm_version", lambda path: () if path == str(rubbish_llvm) else (19, 1, 7))
    monkeypatch.setattr(backend, "llvm_libraries", lambda: [str(rubbish_llvm), "/good/libLLVM.so.19.1"])
    monkeypatch.setattr(backend, "_run", lambda program, llvm_path=None: ("OK", None))
    choice = backend.choose("llvm_ad_spectral")
    assert choice.llvm_path == "/good/libLLVM.so.19.1"
    assert choice.reason == (
        f"llvm_ad_spectral (LLVM 19.1); DRJIT_LIBLLVM_PATH={rubbish_llvm} does not work and is not used"
    )


def test_newest_library_comes_first_but_the_users_own_before(monkeypatch):
    versions = {"/a": (17, 0, 6), "/b": (22, 1, 0), "/c": (16, 0, 0), "/d": (19, 1, 7)}
    monkeypatch.setattr(backend, "_llvm_version", versions.__getitem__)
    attempts: list[str | None] = []

    def fail(program, llvm_path=None):
        attempts.append(llvm_path)
        return "", "no"

    monkeypatch.setattr(backend, "_run", fail)
    assert not backend._try_llvm(list(versions))["works"]
    assert attempts == ["/b", "/d", "/a"]
    attempts.clear()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/a")
    backend._try_llvm(list(versions))
    assert attempts == ["/a", "/b", "/d"]


@pytest.mark.skipif(not OLD_LLVM, reason="needs LLVM 15 or 16 in the system")
def test_old_llvm_of_the_user_aborts_nothing(monkeypatch):
    """Rationale: LLVM 15 aborts Dr.Jit. Set-up: the user names it. Expectation: the chosen variant renders."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", OLD_LLVM[0])
    choice = backend.choose()
    assert choice.llvm_path != OLD_LLVM[0]
    assert backend._run((backend._PROBE_PROGRAM, choice.variant), llvm_path=choice.llvm_path)[1] is None


@pytest.mark.skipif(not OLD_LLVM, reason="needs LLVM 15 or 16 in the system")
def test_probe_shows_the_fault_of_old_llvm():
    """Rationale: if its version were not checked, the trial render would still detect an old LLVM."""
    result = backend._try("llvm_ad_spectral", OLD_LLVM[0])
    assert result == {"works": False, "why": "the process crashed with signal 6"}


def test_hanging_and_missing_programs_are_answers(monkeypatch):
    monkeypatch.setattr(backend, "PROBE_TIMEOUT_S", 0.5)
    assert backend._run(("import time; time.sleep(30)", "")) == ("", "it took longer than 0.5 s")
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert backend._run(("pass", ""))[1] is not None


def test_second_choice_starts_no_program(started):
    first = backend.choose()
    assert first.variant == "scalar_spectral"
    count = len(started)
    assert count > 0
    assert backend.choose() == first
    assert len(started) == count


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"scalar_spectral": 3}', '{"scalar_spectral": {}}'])
def test_damaged_cache_is_ignored(started, content):
    first = backend.choose()
    count = len(started)
    (file,) = cache_dir().glob("*.json")
    file.write_text(content)
    assert backend.choose() == first
    assert len(started) == 2 * count
    assert backend._read_cache(file)["scalar_spectral"]["works"], "a good cache takes the place of the damaged one"


def test_cache_that_cannot_be_written_is_no_error(started, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "file" / "below"))
    assert backend.choose().variant == "scalar_spectral"


def test_failures_are_tried_again_a_day_later(started):
    backend.choose()
    (file,) = cache_dir().glob("*.json")
    old = file.stat().st_mtime - 1.1 * backend.FAILURE_LIFETIME_S
    os.utime(file, (old, old))
    assert list(backend._read_cache(file)) == ["scalar_spectral"]


def test_another_library_is_another_question(started, tmp_path, monkeypatch):
    monkeypatch.setattr(backend, "LLVM_FOLDERS", (str(tmp_path),))
    backend.choose()
    count = len(started)
    (tmp_path / "libLLVM.so.21.1").write_text("new")
    backend.choose()
    assert len(started) > count


def test_libraries_are_found_once_by_their_names(tmp_path, monkeypatch):
    for name in ("libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVM.dylib", "libLLVM-C.so", "libLLVMCore.a"):
        (tmp_path / name).write_text("")
    (tmp_path / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    monkeypatch.setattr(backend, "LLVM_FOLDERS", (str(tmp_path),))
    names = sorted(Path(path).name for path in backend.llvm_libraries())
    assert names == ["libLLVM-15.so.1", "libLLVM.dylib", "libLLVM.so.19.1"]


_ACTIVATE = """
from dasim.base.errors import InputError
from dasim.render import backend
choice = backend.choose()
backend.activate(choice)
backend.activate(choice)
assert backend.choose("auto") is choice
import mitsuba as mi
assert mi.variant() == choice.variant
try:
    backend.activate(backend.Choice("other_spectral", ""))
except InputError as error:
    assert "cannot change it" in str(error), error
else:
    raise AssertionError("two variants in a process")
exec(compile(backend._PROBE_PROGRAM, "probe", "exec"), {"__name__": "probe"})
"""


@pytest.mark.parametrize("library", ["", *OLD_LLVM[:1]])
def test_active_variant_renders_and_is_the_only_one(library):
    """In a new process, with an unset and with a bad library path: the path must be set before Dr.Jit reads it."""
    choice = backend.choose()
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": library}
    done = subprocess.run(
        [sys.executable, "-c", _ACTIVATE, choice.variant],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).parents[3],
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["OK"]
    assert done.stderr == ""


_SWEEP = """
import os, sys, time
from pathlib import Path
from dasim.render import backend
backend.activate(backend.choose(sys.argv[1]))
old = Path(sys.argv[2])
end = time.monotonic() + 20
while old.exists() and time.monotonic() < end:
    time.sleep(0.05)
print(os.environ["DRJIT_CACHE_MAXSIZE"], *sorted(path.stem for path in old.parent.glob("*.bin")))
"""


@pytest.mark.parametrize(("size", "left"), [("1M", ["new"]), (None, ["new", "old"])])
def test_kernels_beyond_a_size_are_removed_the_oldest_first(jit_variant, tmp_path, monkeypatch, size, left):
    """Set-up: two files of 0.8 MB in the folder of kernels, one a day older; a new process.

    Expectation: with a limit of 1 MB the older one is gone; with the default both stay.
    """
    folder = tmp_path / "cache" / "kernels"
    folder.mkdir(parents=True)
    for name, age_s in (("old", 86400), ("new", 0)):
        (folder / f"{name}.bin").write_bytes(bytes(800_000))
        os.utime(folder / f"{name}.bin", (time.time() - age_s,) * 2)
    if size is not None:
        monkeypatch.setenv("DRJIT_CACHE_MAXSIZE", size)
    wait_for = folder / ("old.bin" if size else "none.bin")
    done = subprocess.run(
        [sys.executable, "-c", _SWEEP, jit_variant, str(wait_for)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=Path(__file__).parents[3],
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [size or backend.KERNELS_SIZE, *left]


def test_kernels_of_a_cache_that_cannot_be_written_to_go_elsewhere(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "file" / "below"))
    backend.keep_kernels()
    assert "DRJIT_CACHE_DIR" not in os.environ


def test_main_tells_fast_from_slow(started, capsys):
    assert backend.main() == 3
    assert capsys.readouterr().out.startswith("scalar_spectral, about four times slower")
