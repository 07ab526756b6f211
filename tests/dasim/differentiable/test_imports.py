"""Everything else works where PyTorch is not installed, and does not load it where it is."""

from __future__ import annotations

import os
import subprocess
import sys

MODULES = "dasim, dasim.cli, recon, recon.depth.method, recon.depth.learned, validation, validation.methods"


def test_nothing_loads_pytorch_by_being_imported(tmp_path):
    """Set-up: modules ``torch`` and ``safetensors`` that fail when they are imported stand first in the path."""
    for name in ("torch", "safetensors"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('loaded')")
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    code = f"import {MODULES}; import dasim; [getattr(m, n) for m in (dasim, recon) for n in dir(m)]"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
