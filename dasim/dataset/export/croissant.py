"""Description of a dataset in Croissant 1.0 (https://docs.mlcommons.org/croissant): JSON-LD beside its files.

Tested in tests/dasim/dataset/test_export.py.
"""

from __future__ import annotations

from typing import Any

from dasim.base.errors import InputError
from dasim.dataset import plan, storage
from dasim.dataset.plan import DESCRIPTION, INDEX, SUMS
from dasim.dataset.reading import Dataset
from dasim.dataset.sample import json_bytes

CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
TYPES = {str: "sc:Text", bool: "sc:Boolean", int: "sc:Integer", float: "sc:Float"}
KINDS = {".tar": "application/x-tar", ".parquet": "application/x-parquet", ".png": "image/png", ".exr": "image/x-exr"}
MEANINGS = {
    "key": "name of the sample in its shard or folder",
    "split": "split of the dataset; no scene is in two",
    "shard": "shard that holds the sample",
    "scene": "name of the scene",
    "f_number": "f-number of the lens",
    "focus_m": "focus distance in metres",
    "exposure_s": "exposure time in seconds",
    "drawn": "values drawn from the distributions of the specification, as JSON",
}


def write(samples: Dataset) -> str:
    """Write ``croissant.json`` into a finished dataset; returns its name there.

    It lists the index and the shards (or the folders' files) with their checksums, and the scalar columns of the index
    as a record set ``samples``.
    """
    storage.write(samples.path, DESCRIPTION, json_bytes(description(samples)))
    return DESCRIPTION


def description(samples: Dataset) -> dict[str, Any]:
    """The description as plain values."""
    spec, sums = samples.spec, checksums(samples.path)
    files = [INDEX, *(name for name in sums if name.endswith(".tar"))]
    if spec.format == "folders":
        files = [INDEX, *(name for name in sums if name.count("/") == 2)]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": spec.name,
        "description": spec.description or "Simulated dual-aperture captures with exact ground truth.",
        "license": spec.licence,
        "version": spec.version if spec.version.count(".") == 2 else f"{spec.version}.0",
        "distribution": [_file(name, sums[name]) for name in files],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "samples",
                "name": "samples",
                "description": "The index: one record per sample, with its parameters and statistics.",
                "key": {"@id": "samples/key"},
                "field": [_field(name, kind) for name, kind in columns(samples).items()],
            }
        ],
    }


def checksums(where: str) -> dict[str, str]:
    """SHA-256 of each file of a finished dataset by its name; InputError where they are missing."""
    try:
        lines = storage.read(where, SUMS).decode().splitlines()
    except FileNotFoundError:
        raise InputError(f"{where}: is not finished, it has no {plan.SUMS}; run 'dasim dataset make' again") from None
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def columns(samples: Dataset) -> dict[str, str]:
    """Croissant's type of each column of the index that holds texts or numbers; no lists, tables and pictures."""
    found: dict[str, str] = {}
    for name in samples.rows[0] if samples.rows else ():
        kinds = {type(row[name]) for row in samples.rows if row[name] is not None}
        if len(kinds) == 1 and (kind := kinds.pop()) in TYPES:
            found[name] = TYPES[kind]
    return found


def _file(name: str, digest: str) -> dict[str, Any]:
    kind = next((kind for ending, kind in KINDS.items() if name.endswith(ending)), "application/json")
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "encodingFormat": kind,
        "sha256": digest,
    }


def _field(name: str, kind: str) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"samples/{name}",
        "name": name,
        "description": MEANINGS.get(name, f"column {name} of the index"),
        "dataType": kind,
        "source": {"fileObject": {"@id": INDEX}, "extract": {"column": name}},
    }
