"""The public names of recon: visible to dir(), to editors and to a type checker, and loaded on first use."""

import subprocess
import sys

import pytest

import recon

USER_SCRIPT = """
import dasim
import recon

def middle(capture: dasim.Capture, bank: recon.PsfBank) -> recon.DepthEstimate:
    depth_m = recon.METHODS["bands"](capture, bank).depth_m
    return recon.DepthEstimate(depth_m=depth_m)

method: recon.Method = middle
wrong: int = recon.load_bank  # must be an error, or the checker sees no types
"""


def test_every_public_name_is_listed_and_loads():
    assert set(recon.__all__) <= set(dir(recon))
    for name in recon.__all__:
        assert getattr(recon, name) is not None


def test_importing_recon_loads_no_heavy_library():
    code = "import sys, recon; print([m for m in ('mitsuba', 'numba', 'scipy', 'colour') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.slow
def test_a_type_checker_sees_the_types(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(USER_SCRIPT)
    command = [sys.executable, "-m", "mypy", "--follow-imports=silent", "--ignore-missing-imports", str(script)]
    output = subprocess.run(command, capture_output=True, text=True).stdout
    assert output.count("error:") == 1 and "Incompatible types in assignment" in output, output
