"""The benchmark ``dasim-bench``: the recipe of a split and its hash, which figures are stated for.

Tested in tests/validation/subjects/test_benchmark.py.
"""

from __future__ import annotations

from dasim.base.fingerprint import text_hash
from dasim.dataset import draws
from dasim.dataset.specification import DatasetSpec, kind, load_spec

NAME = "dasim-bench"

# Of the recipe of each split: figures of a split with another hash cannot be compared with them.
HASHES = {"tune": "8d98c504d3cb3448b709864c", "test": "113655d51b118359e4dd1389"}


def recipe_hash(split: str, spec: DatasetSpec | None = None) -> str:
    """Hash of what the file of the benchmark states, and of the scenes and seeds of a split's samples.

    It does not depend on defaults of keys that the file leaves out, nor on the code that draws the scenes: the page of
    a leaderboard states a hash of the captures themselves.
    """
    spec = spec or load_spec(NAME)
    stated = spec.model_dump_json(exclude_unset=True, exclude={"first", "description", "folder"})
    samples = [
        f"{index} {draws.scene_key(spec, number)} {kind(spec, number)} {draws.capture_seed(spec, index)}"
        for index in range(spec.samples)
        if draws.split_of_scene(spec, number := draws.scene_number(spec, index)) == split
    ]
    return text_hash([stated, *samples])
