"""The commands ``dasim learn``: parse and print.

Tested in tests/validation/training/test_fit_depth.py.
"""

from __future__ import annotations

from pathlib import Path

import cyclopts

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import AnyOut, Out, Whole

app = cyclopts.App(name="learn", help="Train and run the learned depth estimate; needs the extra 'learn' (PyTorch).")

ROOMS, EPOCHS = 180, 40  # of the weights that come with the package


@app.command
def train(
    dataset: str | None = None,
    *,
    out: Out = Path("out/learned.safetensors"),
    rooms: Whole | None = None,
    epochs: Whole = EPOCHS,
    seed: Whole = 0,
    device: str = "cpu",
) -> int:
    """Train the network on a dataset, on random rooms through simple lenses, or on both.

    Without a dataset and with the defaults, the weights are those that come with the package. Rooms are drawn and
    blurred layer by layer, without ray tracing; twelve in a row share a lens, of which hole, focus and light are drawn.

    Args:
        dataset: its folder or fsspec address; the split train is learned from, the split val measured, if there is one
        out: file of the weights, ending in .safetensors; an earlier one is replaced
        rooms: random rooms to learn from; by default 180, or none where there is a dataset
        epochs: passes over all examples
        seed: of the rooms, the noise and the first weights
        device: PyTorch's name of the processor: cpu, cuda, mps
    """
    from dasim.files.folders import check_output_file
    from recon.depth.learned import check_installed

    check_installed()
    if out.suffix != ".safetensors":
        raise InputError(f"--out {out}: must end in .safetensors")
    rooms = (0 if dataset else ROOMS) if rooms is None else rooms
    for name, value, least in (("rooms", rooms, 0), ("epochs", epochs, 1), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"--{name} {value}: must be {least} or more")
    from validation.training import learned

    learned.check_device(device)
    check_output_file(out)
    with options.progress() as show:
        examples = learned.examples(dataset, rooms, seed, show)
    net = learned.fitted(examples, epochs, seed, device, report=lambda text: print(text, flush=True))
    learned.write(net, out, examples, epochs, seed)
    print(f"weights: {out} ({out.stat().st_size / 1e6:.1f} MB)")
    return 0


@app.command
def predict(
    dataset: str,
    *,
    out: AnyOut = None,
    split: str = "test",
    weights: Path | None = None,
    bank: Path | None = None,
) -> int:
    """Estimate depth of all samples of a split: OUT/depth/ID.npy in metres, and OUT/sd/ID.npy in blur levels.

    Args:
        dataset: its folder or fsspec address
        out: a new folder, out/DATASET-depth by default
        split: the split to estimate
        weights: a file of 'dasim learn train'; by default that of the package
        bank: a PSF bank for all samples; by default one is calibrated per camera and focus, and stored in the cache
    """
    from recon.depth.learned import check_installed

    check_installed()
    from dasim.base import atomic
    from dasim.files.banks import load_bank
    from validation.training import predictions

    out = out or options.default_out(dataset, "-depth")
    if out.exists():
        raise InputError(f"--out {out}: exists; choose another name")
    users_bank = None if bank is None else load_bank(bank)
    with options.progress() as show, atomic.new_folder(out) as folder:
        count = predictions.write(dataset, split, folder, weights, users_bank, show)
    print(f"depth maps: {out} ({count} samples)")
    return 0
