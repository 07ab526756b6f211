"""``python .ci/audit.py PYTHON LOCK...``: look up known vulnerabilities of the packages of lock files by pip-audit.

Status 1 where there are some. What cannot be looked up, without a network for example, is counted and is no failure.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path


def audited(python: str, lock: str) -> list[dict]:
    """Packages of a lock file as pip-audit describes them; none where it has not reached its data."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "audit.json"
        options = ["--disable-pip", "--require-hashes", "--timeout", "20", "--format", "json", "--output", str(out)]
        done = subprocess.run([python, "-m", "pip_audit", "-r", lock, *options], capture_output=True, text=True)
        if not out.exists():
            print(f"{lock}: not audited ({(done.stderr.strip().splitlines() or ['no reason given'])[-1][:200]})")
            return []
        return list(json.loads(out.read_text(encoding="utf-8"))["dependencies"])


def main(python: str, locks: list[str]) -> int:
    """Print what was found for each lock file."""
    found = 0
    for lock in locks:
        packages = audited(python, lock)
        known = [package for package in packages if "vulns" in package]
        print(f"{lock}: {len(known)} of {len(packages)} packages could be looked up")
        for package in known:
            for vulnerability in package["vulns"]:
                found += 1
                mended = ", ".join(vulnerability["fix_versions"]) or "none"
                print(f"  {package['name']} {package['version']}: {vulnerability['id']}, mended in {mended}")
    print(f"{found} known vulnerabilities")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
