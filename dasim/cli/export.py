"""The command export: a capture in the formats of raw developers.

Tested in tests/dasim/cli/test_export.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import AnyOut


def export(
    capture: Path,
    *,
    out: AnyOut = None,
    as_: Annotated[Literal["dng"], Parameter(name="--as")] = "dng",
) -> int:
    """Write a capture for raw developers: its mosaic as a DNG, and beside it a linear DNG of its colours.

    FILE.dng is the mosaic with its filters, levels, noise profile and colour matrices; 'dasim recon FILE.dng' reads it.
    FILE-linear.dng has red, green and blue without infrared, and infrared as its second page.

    Args:
        capture: a capture folder
        out: the DNG to be written, such as photo.dng, out/CAPTURE.dng by default; photo-linear.dng stands beside it;
            earlier ones are replaced
        as_: format, dng
    """
    import recon
    from dasim.files.captures import load_capture
    from recon.files import dng

    if out is None:
        out = options.default_out(capture, ".dng")
    elif out.suffix.lower() != ".dng" or out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: is not a DNG file in a folder that exists")
    shot = load_capture(capture)
    developed = recon.develop(shot)
    linear = out.with_name(f"{out.stem}-linear{out.suffix}")
    dng.write_dng(out, shot)
    dng.write_linear_dng(linear, shot, developed)
    print(f"mosaic: {out}")
    second = "" if developed.ir_e is None else "; infrared is its second page"
    print(f"linear colours: {linear} (light by white balance: {developed.light}{second})")
    return 0
