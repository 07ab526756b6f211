"""Train the network of the preset ``best``: ``python -m validation.training examples DIR``, then ``fit DIR``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from recon.depth.surface_net import FILE
from validation.training.examples import CONDITIONS, PARTS, make

EPOCHS, HELD_OUT = 12, 20  # passes; examples of each family that the loss is measured with


def main() -> None:
    """Make examples, or fit the network to those in a folder and write its arrays."""
    parser = argparse.ArgumentParser(prog="python -m validation.training", description=__doc__)
    steps = parser.add_subparsers(dest="step", required=True)
    examples = steps.add_parser("examples", help="make examples; several processes may each make a part")
    examples.add_argument("folder", type=Path)
    examples.add_argument("--part", type=int, choices=range(PARTS), help="one part alone; default all")
    fitting = steps.add_parser("fit", help="fit the network; needs the extra 'learn'")
    fitting.add_argument("folder", type=Path)
    fitting.add_argument("--epochs", type=int, default=EPOCHS)
    fitting.add_argument("--out", type=Path, default=Path(FILE))
    options = parser.parse_args()
    if options.step == "examples":
        for part in range(PARTS) if options.part is None else [options.part]:
            make(options.folder, part, progress=_show)
    else:
        _fit(options.folder, options.epochs, options.out)


def _show(_: str, share: float) -> None:
    print(f"\r{share:4.0%}", end="", file=sys.stderr)


def _fit(folder: Path, epochs: int, out: Path) -> None:
    from validation.training import fit  # PyTorch is of an extra

    families = [
        sorted(folder.glob(f"{name}-*[0-9].npz"), key=lambda file: int(file.stem.split("-")[1])) for name in CONDITIONS
    ]
    train = fit.load([file for files in families for file in files[HELD_OUT:]])
    held_out = fit.load([file for files in families for file in files[:HELD_OUT]])

    def report(epoch: int, loss: float, net: fit.Net) -> None:
        print(f"pass {epoch + 1} of {epochs}: loss {loss:.3f}, held out {fit.mean_loss(net, held_out):.3f}", flush=True)

    net = fit.fit(train, epochs, report=report)
    about = (
        "Own data of the project, under its licence: weights of recon.depth.surface_net, without unit, from "
        f"{len(train.level)} examples of validation.training in {epochs} passes."
    )
    arrays: dict[str, Any] = net.arrays()
    np.savez(out, about=about, **arrays)


if __name__ == "__main__":
    main()
