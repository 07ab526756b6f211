"""Train the networks of the preset ``best``: ``python -m validation.training examples levels DIR``, then ``fit levels
DIR`` for the depth estimate; the same with ``pictures`` for the all-in-focus picture.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from validation.training import level_examples, picture_examples
from validation.training.files import PARTS, families, make

EPOCHS = {"levels": 25, "pictures": 110}  # passes over the examples
HELD_OUT = {"levels": 8, "pictures": 12}  # examples of each family that the loss is measured with
FILES = {"levels": "surface_net_{}.npz", "pictures": "restoration_{}.npz"}
READERS = {"levels": "recon.depth.surface_net", "pictures": "recon.sharp.restoration"}
MAKERS = {
    "levels": (level_examples.example, level_examples.EXAMPLES),
    "pictures": (picture_examples.example, picture_examples.EXAMPLES),
}


def main() -> None:
    """Make examples, or fit a network to those in a folder and write its arrays."""
    parser = argparse.ArgumentParser(prog="python -m validation.training", description=__doc__)
    steps = parser.add_subparsers(dest="step", required=True)
    examples = steps.add_parser("examples", help="make examples; several processes may each make a part")
    examples.add_argument("network", choices=FILES)
    examples.add_argument("folder", type=Path)
    examples.add_argument("--part", type=int, choices=range(PARTS), help="one part alone; default all")
    fitting = steps.add_parser("fit", help="fit a network; needs the extra 'learn'")
    fitting.add_argument("network", choices=FILES)
    fitting.add_argument("folder", type=Path)
    fitting.add_argument("--epochs", type=int)
    fitting.add_argument("--seed", type=int, default=0, help="of the first weights and of the order of examples")
    fitting.add_argument("--device", default="cpu", help="PyTorch's name of the processor: cpu, cuda, mps")
    fitting.add_argument("--begin", type=Path, help="file of a network that is trained on")
    fitting.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.step == "examples":
        for part in range(PARTS) if options.part is None else [options.part]:
            make(options.folder, *MAKERS[options.network], part, progress=_show)
    else:
        network = options.network
        out = options.out or Path(FILES[network].format(options.seed))
        how: dict[str, Any] = {"seed": options.seed, "device": options.device}
        _fit(network, options.folder, options.epochs or EPOCHS[network], how, options.begin, out)


def _show(_: str, share: float) -> None:
    print(f"\r{share:4.0%}", end="", file=sys.stderr)


def _fit(network: str, folder: Path, epochs: int, how: dict[str, Any], begin: Path | None, out: Path) -> None:
    from validation.training import fit_levels, fit_pictures  # PyTorch is of an extra

    trainer: Any = {"levels": fit_levels, "pictures": fit_pictures}[network]
    _, examples = MAKERS[network]
    held = HELD_OUT[network]
    train = trainer.load([file for files in families(folder, examples) for file in files[held:]])
    held_out = trainer.load([file for files in families(folder, examples) for file in files[:held]])

    def report(epoch: int, loss: float, net: Any) -> None:
        held_loss = trainer.mean_loss(net, held_out)
        print(f"pass {epoch + 1} of {epochs}: loss {loss:.3f}, held out {held_loss:.3f}", flush=True)

    about = (
        f"Own data of the project, under its licence: weights of {READERS[network]}, without unit, from "
        f"{trainer.count(train)} examples of validation.training in {epochs} passes, seed {how['seed']}."
    )
    if begin:
        how["begin"] = dict(np.load(begin, allow_pickle=False))
        about += f" Mean of these weights and those before: {how['begin']['about']}"
    net = trainer.fit(train, epochs, report=report, **how)
    arrays: dict[str, Any] = net.arrays()
    np.savez(out, about=about, **arrays)


if __name__ == "__main__":
    main()
