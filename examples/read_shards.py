"""Every part of a dataset's samples as tensors, without dasim: by webdataset, OpenCV, OpenEXR and PyTorch.

python examples/read_shards.py out/tops/train-000000.tar

Do not use webdataset's decode("pil"): it silently converts raw.png to 8 bits, so values above 255 become 255.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
import OpenEXR
import torch
import webdataset


def samples(shards: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Samples of shards as tensors by name: ``raw``, and the channels of the truth such as ``depth.Z``.

    ``meta`` is the content of meta.json: camera, exposure, intrinsic matrix, table of levels, names of the frames.
    """
    for files in webdataset.WebDataset(list(shards), shardshuffle=False):
        meta = json.loads(files["meta.json"])
        # Numbers of the converter, from a PNG of 16 bits: with raw_scale = "full" they are stored times raw_scale.
        raw = cv2.imdecode(np.frombuffer(files["raw.png"], np.uint8), cv2.IMREAD_UNCHANGED) // meta["raw_scale"]
        truth = {name: torch.from_numpy(channel) for name, channel in channels(files["truth.exr"]).items()}
        yield {"key": files["__key__"], "raw": torch.from_numpy(raw.astype(np.int32)), "meta": meta, **truth}


def channels(content: bytes) -> dict[str, np.ndarray]:
    """Channels [h, w] of all parts of an EXR file as ``PART.CHANNEL``, in types that PyTorch computes with."""
    signed = {"uint32": np.int64, "float16": np.float32}
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:  # the library reads from disk only
        file.write(content)
        file.flush()
        with OpenEXR.File(file.name, separate_channels=True) as exr:
            found = {f"{part.name()}.{name}": c.pixels for part in exr.parts for name, c in part.channels.items()}
            return {name: pixels.astype(signed.get(str(pixels.dtype), pixels.dtype)) for name, pixels in found.items()}


if __name__ == "__main__":
    for sample in samples(sys.argv[1:]):
        tensors = {name: tuple(value.shape) for name, value in sample.items() if isinstance(value, torch.Tensor)}
        print(json.dumps([sample["key"], tensors]))
