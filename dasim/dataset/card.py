"""Completion of a dataset: index, card with statistics, contact sheet and checksums."""

from __future__ import annotations

import base64
import hashlib
import io
import json
from collections import Counter
from typing import Any

import cv2
import numpy as np

from dasim.dataset import plan, reading, storage
from dasim.dataset.plan import DESCRIPTION, INDEX, MANIFEST, SUMS
from dasim.dataset.sample import BLUR_EDGES_PX, DEPTH_EDGES_M, json_bytes
from dasim.dataset.specification import DatasetSpec

CARD, SHEET = "README.md", "contact-sheet.jpg"
SHEET_COLUMNS, SHEET_MOST = 8, 48
CHUNK = 1 << 20  # bytes read at a time


def finish(out: str, spec: DatasetSpec, failed: dict[int, str]) -> None:
    """Write index, card, contact sheet and checksums, and remove the intermediate files."""
    try:
        rows = rows_of(out)
    except FileNotFoundError:
        rows = None
    if storage.exists(out, SUMS):  # another run has finished the dataset, and removed the rows meanwhile
        return
    if rows is None:
        raise FileNotFoundError(None, "rows were removed while they were read", f"{out}/rows")
    storage.write(out, INDEX, table(rows))
    if rows:
        storage.write(out, SHEET, contact_sheet(rows))
    storage.write(out, CARD, card(spec, plan.manifest(out), rows, failed).encode())
    files = [INDEX, CARD, MANIFEST, *([SHEET] if rows else []), *content(spec, rows)]
    files += [name for name in storage.names(out, "failed")]
    sums = "".join(f"{sha256(out, name)}  {name}\n" for name in sorted(files))
    storage.write(out, SUMS, sums.encode())
    tidy(out)


def tidy(out: str) -> None:
    """Remove the intermediate files: parts and rows."""
    for folder in ("rows", "parts"):
        storage.remove(out, folder)


def undo(out: str, spec: DatasetSpec) -> None:
    """Undo :func:`finish`: write the rows of each shard, and remove index, card, contact sheet, checksums and
    their description.
    """
    groups: dict[str, list[dict[str, Any]]] = {group.name: [] for group in plan.shards(spec)}
    for row in reading.index_rows(out):
        groups[row["shard"]].append(row | {"thumbnail": base64.b64encode(row["thumbnail"]).decode()})
    for name, rows in groups.items():
        storage.write(out, f"rows/{name}.json", json_bytes(rows))
    for name in (SUMS, INDEX, CARD, SHEET, DESCRIPTION):
        storage.remove(out, name)


def rows_of(out: str) -> list[dict[str, Any]]:
    """Rows of all finished shards in the order of the samples."""
    rows = [row for name in storage.names(out, "rows") for row in json.loads(storage.read(out, name))]
    return sorted(rows, key=lambda row: int(row["index"]))


def content(spec: DatasetSpec, rows: list[dict[str, Any]]) -> list[str]:
    """Names of the files that hold the samples."""
    if spec.format == "webdataset":
        return [f"{name}.tar" for name in dict.fromkeys(row["shard"] for row in rows)]
    return [f"{row['split']}/{row['key']}/{name}" for row in rows for name in row["sha256"]]


def sha256(out: str, name: str) -> str:
    """SHA-256 of a file of the dataset, as hexadecimal digits."""
    digest = hashlib.sha256()
    with storage.reading(out, name) as file:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def table(rows: list[dict[str, Any]]) -> bytes:
    """Index as parquet, with one row per sample; equal rows give equal bytes."""
    parquet = reading.parquet_library()
    import pyarrow

    binary = [row | {"thumbnail": base64.b64decode(row["thumbnail"])} for row in rows]
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(binary), buffer, compression="zstd")
    return buffer.getvalue()


def contact_sheet(rows: list[dict[str, Any]]) -> bytes:
    """JPEG of the thumbnails of at most ``SHEET_MOST`` samples, evenly spaced over the dataset."""
    selection = [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, SHEET_MOST).astype(int))]
    data = [row["thumbnail"] for row in selection]
    jpegs = [base64.b64decode(item) if isinstance(item, str) else item for item in data]
    small = [cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for jpeg in jpegs]
    height, width = (max(picture.shape[axis] for picture in small) for axis in (0, 1))
    columns = min(SHEET_COLUMNS, len(small))
    sheet = np.full((-(-len(small) // columns) * height, columns * width, 3), 255, np.uint8)
    for place, picture in enumerate(small):
        top, left = place // columns * height, place % columns * width
        sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    _, encoded = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return bytes(encoded.tobytes())


def statistics(rows: list[dict[str, Any]]) -> list[str]:
    """Statistics of the samples as lines of text: splits, cameras, lights, depth, blur, focus, exposure, size."""
    if not rows:
        return ["no samples"]

    def spread(name: str, unit: str, factor: float = 1.0) -> str:
        values = np.array([row[name] for row in rows if row[name] is not None]) * factor
        if not values.size:
            return "unknown"
        low, middle, high = np.percentile(values, (5, 50, 95))
        return f"{middle:.3g} {unit} (90 %: {low:.3g} to {high:.3g})"

    def counts(name: str) -> str:
        return ", ".join(f"{value} {count}" for value, count in Counter(str(row[name]) for row in rows).most_common(12))

    depth, blur = (np.sum([row[f"{what}_histogram"] for row in rows], axis=0) for what in ("depth", "blur"))
    return [
        f"samples: {len(rows)}, scenes: {len({row['scene'] for row in rows})}; {counts('split')}",
        f"cameras: {counts('camera')}",
        f"lights: {counts('illuminant')}",
        f"depth of all pixels: {_quantiles(depth, DEPTH_EDGES_M, 'm')}",
        f"visible blur of all pixels: {_quantiles(blur, BLUR_EDGES_PX, 'px')}",
        f"focus: {spread('focus_m', 'm')}; exposure: {spread('exposure_s', 'ms', 1e3)}; gain: {spread('gain', '')}",
        f"saturated pixels: {spread('saturated_share', '%', 100)}; "
        f"behind the focus: {spread('far_side_share', '%', 100)}; "
        f"near depth discontinuities: {spread('boundary_share', '%', 100)}",
        f"standard deviation of rendering noise over that of sensor noise, worst channel: {spread('noise_share', '')} "
        f"at a sample's median pixel, {spread('noise_share_p95', '')} at its 95th percentile",
        f"size: {sum(row['bytes'] for row in rows) / 1e9:.3g} GB",
    ]


def _quantiles(histogram: np.ndarray, edges: np.ndarray, unit: str) -> str:
    """Median and the central 90 % of a histogram [bin] with ``edges`` [bin + 1], whose outer bins are open, as text."""
    share = np.concatenate([[0], np.cumsum(histogram) / max(histogram.sum(), 1)])

    def text(value: float) -> str:
        if value < edges[1]:
            return f"below {edges[1]:.3g}"
        return f"above {edges[-2]:.3g}" if value > edges[-2] else f"{value:.3g}"

    low, middle, high = map(text, np.interp((0.05, 0.5, 0.95), share, edges))
    return f"{middle} {unit} (90 %: {low} to {high})"


def card(spec: DatasetSpec, manifest: dict[str, Any], rows: list[dict[str, Any]], failed: dict[int, str]) -> str:
    """Dataset card in Markdown: licence, origin, statistics, and how to read the files."""
    half = ", 16-bit floats but for depth" if spec.truth.half else ""
    margin = f", without {spec.truth.margin_px} px along every edge" if spec.truth.margin_px else ""
    inside = (
        "Shards `SPLIT-NUMBER.tar` in the WebDataset form: `KEY.raw.png`, `KEY.truth.exr`, `KEY.meta.json`."
        if spec.format == "webdataset"
        else "One folder per sample, `SPLIT/KEY/` with `raw.png`, `truth.exr`, `meta.json`."
    )
    others = f", `raw-1.png` to `raw-{spec.frames.count - 1}.png` further frames, which `meta.json` lists"
    frames = others if spec.frames.count > 1 else ""
    failures = "".join(f"- {key}: {reason}\n" for key, reason in list(failed.items())[:20])
    lines = "\n".join(f"- {line}" for line in statistics(rows))
    return f"""# {spec.name} {spec.version}

{spec.description or "Simulated dual-aperture captures with exact ground truth."}

Licence: {spec.licence}. Made by dasim {manifest["libraries"]["dasim"]}, {manifest["variant"]}; the specification, the
instruction set, all library versions and a fingerprint of the code are in `{MANIFEST}`. With the same ones, every file
is reproduced byte for byte.

![Samples, through a pinhole]({SHEET})

## Content

{lines}

Parts of the truth: {", ".join(spec.truth.keep)}{half}{margin}. Each scene is in one split only.

## How to read it

{inside} `raw.png` is the 16-bit mosaic of the sensor{frames}. `truth.exr` has one part per kind of truth; `Z` of the
part `depth` is z in metres from the lens. `meta.json` describes camera, exposure and lights. `{INDEX}` has one row per
sample: parameters, checksums, statistics and a thumbnail. `sha256sum -c {SUMS}` checks every file.

```python
import dasim

for sample in dasim.open_dataset(".", split="{next(iter(spec.splits))}"):
    sample.raw_dn, sample.truth, sample.meta
```
""" + (f"\n## Failures\n\n{len(failed)} samples failed and are left out:\n\n{failures}" if failed else "")
