"""``python -m tests.soak --samples 1000 --seed 0``: report of a soak; exit status 1 where something is wrong."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.soak.runner import soak


def main() -> int:
    """Run the soak that the arguments describe."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", choices=["files", "random"], default="random")
    parser.add_argument("--calm-s", type=float, default=12.0, help="mean processor time between two disturbances, s")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dasim-soak-") as name:
        problems = soak(Path(name), chosen.samples, chosen.seed, chosen.scenes, chosen.calm_s, print)
    for problem in problems:
        print(f"wrong: {problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
