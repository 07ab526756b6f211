"""Every number of a user's file has a least and a largest value, and no boolean or text passes as a number."""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import specification as cameras
from dasim.dataset.specification import DatasetSpec, check, load_spec
from tests.support.datasets import spec_file

ROOT = Path(dasim.__file__).parents[1]
FREE = {  # numbers without limits in their model, and what limits them
    "Lens.coating_index": "0, or an index of a coating: tested below",
    "Sensor.coating_index": "the same",
    "DatasetSpec.spp": "1 to 65536, or 'auto': tested in tests/dasim/dataset/test_specification.py",
    "Draw.uniform": "the key that it is for: tested below",
    "Draw.log_uniform": "the same",
    "Draw.choice": "the same",
    "Draw.each": "the same",
    "Grid.grid": "the key that it is for, tested in tests/validation/studies/sweep/test_loading.py",
    "Grid.log_grid": "the same",
    "StudySpec.design": "the same",
    "StudySpec.parameters": "the same",
    "StudySpec.quick": "the same",
    "StudySpec.reference": "names a value of the parameters",
    "_Entry.seed": "a file of the package, whose hash is fixed",
    "_Entry.number": "the same",
    "_Entry.depth_cm": "the same",
    "_Entry.lux": "the same",
    "_Entry.gain": "the same",
}


NEEDED = {"Photo": {"rule": "print"}}  # keys that a model asks for first


def models() -> list[type[BaseModel]]:
    """All models of the packages."""
    for package in ("dasim", "recon", "validation"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "(Specification)" in text or "from pydantic import" in text:
                importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    return sorted(set(_below(BaseModel)), key=lambda model: model.__qualname__)


def _below(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for child in model.__subclasses__():
        if child.__module__.split(".")[0] in ("dasim", "recon", "validation"):
            yield child
        yield from _below(child)


def fields(model: type[BaseModel]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and JSON schema of the fields of a model."""
    yield from model.model_json_schema(by_alias=True).get("properties", {}).items()


def leaves(schema: Any) -> Iterator[dict[str, Any]]:
    """What the values of a JSON schema are made of, without those of other models."""
    parts = [*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("prefixItems", ())]
    parts += [schema[key] for key in ("items", "additionalProperties") if isinstance(schema.get(key), dict)]
    if not parts:
        yield schema
    for part in parts:
        yield from leaves(part)


def is_number(leaf: dict[str, Any]) -> bool:
    return leaf.get("type") in ("number", "integer")


def is_limited(leaf: dict[str, Any]) -> bool:
    return bool(leaf.keys() & {"minimum", "exclusiveMinimum"} and leaf.keys() & {"maximum", "exclusiveMaximum"})


def values(schema: dict[str, Any], leaf: Any) -> Iterator[Any]:
    """Values of the form of a JSON schema, with ``leaf`` in the place of every number."""
    for variant in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from values(variant, leaf)
    if is_number(schema):
        yield leaf
    elif "prefixItems" in schema:
        yield [next(values(part, leaf)) for part in schema["prefixItems"]]
    elif isinstance(schema.get("items"), dict):
        yield from ([value] * max(schema.get("minItems", 1), 1) for value in values(schema["items"], leaf))
    elif isinstance(schema.get("additionalProperties"), dict):
        yield from ({"a": value} for value in values(schema["additionalProperties"], leaf))


def test_every_number_has_limits():
    """Set-up: the JSON schemas of all models. Expectation: every number in them has a minimum and a maximum, except
    for those of ``FREE``, all of which exist.
    """
    found = {
        f"{model.__name__}.{name}"
        for model in models()
        for name, schema in fields(model)
        if any(is_number(leaf) and not is_limited(leaf) for leaf in leaves(schema))
    }
    assert found == set(FREE)


def test_no_boolean_or_text_is_a_number():
    """Set-up: every key that takes numbers alone, or numbers or a word, with true, false and "1" as the number.

    Expectation: refused, for more than 100 keys.
    """
    checked = 0
    for model in models():
        for name, schema in fields(model):
            kinds = [leaf.get("type") for leaf in leaves(schema) if "const" not in leaf and "enum" not in leaf]
            if not {"number", "integer"} & set(kinds) or {"boolean", "string"} & set(kinds):
                continue
            for wrong in (True, False, "1"):
                for value in values(schema, wrong):
                    with pytest.raises(ValidationError) as refused:
                        model.model_validate({name: value} | NEEDED.get(model.__name__, {}))
                    about = [item for item in refused.value.errors() if "must be a number" in item["msg"]]
                    assert about and about[0]["msg"].startswith(name), (model, name, value)
                    checked += 1
    assert checked > 300


@pytest.mark.parametrize("part", ["lens", "sensor"])
@pytest.mark.parametrize("index", [-1e300, 1e300, 1.0, -1.8])
def test_index_of_coatings(part, index):
    camera = cameras.load_camera("da-mobile").model_dump()
    camera[part]["coating_index"] = index
    with pytest.raises(ValidationError, match="coating_index"):
        cameras.Camera.model_validate(camera)


@pytest.mark.parametrize("key", ["focus.distance_m", "exposure.time_s", "exposure.gain", "exposure.auto_level",
                                 "light.scale", "lens.f_number", "sensor.read_noise_e"])  # fmt: skip
@pytest.mark.parametrize("draw", ["uniform = [-1e300, 1.0]", "log_uniform = [1.0, 1e300]", "choice = [1e300]"])
def test_distributions_have_the_limits_of_their_keys(key, draw, tmp_path):
    table, _, name = key.rpartition(".")
    value = next(iter(tomllib.loads(draw).values()))
    choice = {draw.split(" ")[0]: value}
    spec = load_spec(spec_file(tmp_path)).model_dump()
    if table in ("lens", "sensor"):
        spec["cameras"][0]["vary"] = {key: choice}
    else:
        spec[table][name] = choice
    with pytest.raises(InputError, match=name):
        check(parse(DatasetSpec, spec, "spec"), "spec")
