"""``python -m tests.fuzz --cases 2000 --seed 0``: run cases and list those that do not end well; status 1 if any."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz import subjects
from tests.fuzz.runner import case


def main() -> int:
    """Run the cases that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="one case, as a failure names it")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so many seconds")
    chosen = parser.parse_args()
    start, failures, done = time.monotonic(), 0, 0
    with tempfile.TemporaryDirectory(prefix="dasim-fuzz-") as name:
        subjects.write(Path(name))
        for number in range(chosen.cases) if chosen.only is None else [chosen.only]:
            if time.monotonic() - start > chosen.seconds:
                break
            failure = case(Path(name), chosen.seed, number)
            done += 1
            if failure is not None:
                failures += 1
                print(f"case {failure.number} ({failure.subject}, seed {chosen.seed}): {failure.what}", flush=True)
    print(f"{done} cases of seed {chosen.seed}, {failures} failures, {time.monotonic() - start:.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
