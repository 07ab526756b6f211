"""Specifications: frozen values that are read from TOML and validated, with all problems named by their keys.

Tested in tests/dasim/scene/test_specification.py and tests/dasim/camera/test_specification.py.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from dasim.base import untrusted
from dasim.base.errors import InputError, shortened


class Specification(BaseModel):
    """A frozen value that refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_numbers(cls, data: Any) -> Any:
        """Refuse true, false and text where numbers are needed, which pydantic would convert."""
        for name in data if isinstance(data, dict) else ():
            leaves = _leaves_of(cls).get(name, frozenset())
            if leaves and leaves <= {int, float, type(None)}:
                _check_numbers(name, data[name])
        return data


@cache
def _leaves_of(model: type[BaseModel]) -> dict[str, frozenset[Any]]:
    """Types that the values of a model's fields are made of, by the name of the field."""
    return {name: frozenset(_leaves(field.annotation)) for name, field in model.model_fields.items()}


def _leaves(annotation: Any) -> Iterator[Any]:
    """Types within an annotation, without its tuples, unions and limits."""
    if get_origin(annotation) is Annotated:
        yield from _leaves(get_args(annotation)[0])
    elif parts := [part for part in get_args(annotation) if part is not Ellipsis]:
        for part in parts:
            yield from _leaves(part)
    else:
        yield annotation


def _check_numbers(key: str, value: Any) -> None:
    """Refuse a value, or one of those in lists, that is true, false or text."""
    if isinstance(value, (list, tuple)):
        for number, item in enumerate(value):
            _check_numbers(f"{key}.{number}", item)
    elif isinstance(value, (bool, str)):
        about = {"place": key, "value": shortened(value)}
        raise PydanticCustomError(_NO_NUMBER, "{place}: must be a number (is {value})", about)


_NO_NUMBER = "no_number"  # type of the problem that a number is true, false or text
Model = TypeVar("Model", bound=BaseModel)


def bundled_or_file(name_or_path: str | Path, folder: Path, kind: str) -> Path:
    """Path of a bundled TOML file by its name, or of the user's file; raises InputError if there is neither.

    ``folder`` holds the bundled files; ``kind`` is what they describe, for the message.
    """
    path = Path(name_or_path)
    bundled = folder / f"{name_or_path}.toml"
    if path.parent == Path(".") and bundled.is_file():
        return bundled
    if path.is_file():
        return path
    names = ", ".join(sorted(p.stem for p in folder.glob("*.toml")))
    raise InputError(f"{kind} '{name_or_path}' is neither a bundled name ({names}) nor a file")


def parse_toml(model: type[Model], path: Path) -> Model:
    """Read a specification from a TOML file; all problems in one InputError, each with its key.

    Names of files in it are relative to its folder.
    """
    return parse(model, untrusted.toml(path, str(path)), str(path), folder=path.parent)


def parse(model: type[Model], data: Any, where: str, folder: Path = Path(".")) -> Model:
    """Validate plain data as a specification; all problems in one InputError, each with its key.

    Args:
        model: class of the specification.
        data: plain data, as TOML or JSON gives it.
        where: name of the source, which begins the message.
        folder: folder that names of files in ``data`` are relative to.
    """
    try:
        return model.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        raise InputError(f"{where}: " + "; ".join(_problem(item, data) for item in _causes(error.errors()))) from None


def to_toml(data: dict[str, Any], table: str = "") -> str:
    """Plain data as TOML text that :func:`parse_toml` reads: values, then tables and lists of tables, without None."""

    def is_tables(value: Any) -> bool:
        return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(item, dict) for item in value)

    given = {key: value for key, value in data.items() if value is not None}
    nested = {key: value for key, value in given.items() if isinstance(value, dict) or is_tables(value)}
    # Strings, numbers, booleans and lists have the same syntax in JSON and TOML.
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in given.items() if key not in nested)
    for key, value in nested.items():
        name = f"{table}.{key}" if table else key
        for item in [value] if isinstance(value, dict) else value:
            heading = f"[{name}]" if isinstance(value, dict) else f"[[{name}]]"
            text += f"\n{heading}\n{to_toml(item, name)}"
    return text


def _causes(problems: list[Any]) -> list[Any]:
    """Problems without those that only follow from others: a list is too short where its one entry is wrong."""
    places = [item["loc"] for item in problems]

    def follows(item: Any) -> bool:
        inner = any(len(place) > len(item["loc"]) and place[: len(item["loc"])] == item["loc"] for place in places)
        return item["type"] == "too_short" and inner

    return [item for item in problems if not follows(item)]


def named_file(data: dict[str, Any], info: ValidationInfo) -> Path:
    """Path of the file ``data["file"]``, which is relative to the folder of the specification; ValueError otherwise."""
    name = data["file"]
    if not isinstance(name, str) or not name:
        raise ValueError("file must be the name of a file")
    path = Path((info.context or {}).get("folder", ".")) / name
    if not path.is_file():
        raise ValueError(f"file {path}: no such file")
    return path


def _problem(item: Any, data: Any) -> str:
    """A problem reported by pydantic, as text with its key."""
    location = item["loc"]
    if item["type"] in ("value_error", _NO_NUMBER) and isinstance(item.get("input"), dict):
        location = (*location, "")  # the problem of a table: a kind at its end is not a key
    key = _key(location, data)
    message = item["msg"].removeprefix("Value error, ").replace("Input should", "must")
    if item["type"] == _NO_NUMBER:
        return f"{key}.{message}" if key else message
    if item["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    if item["type"] == "missing":
        return f"{key}: is missing"
    if item["type"].startswith("union_tag_"):
        return f"{key}: {_kind_problem(item['ctx'])}"
    value = item.get("input")
    is_now = f" (is {shortened(value)})" if isinstance(value, (str, int, float)) else ""
    return (f"{key}: {message}" if key else message) + is_now


def _kind_problem(context: dict[str, str]) -> str:
    """Message for a table whose kind, such as the ``shape`` of an object, is missing or unknown."""
    name = context["discriminator"].strip("'")
    if "tag" not in context:
        return f"{name} is missing"
    return f"{name} {shortened(context['tag'])} is unknown; allowed are {context['expected_tags'].replace(chr(39), '')}"


def _key(location: tuple[int | str, ...], data: Any) -> str:
    """Key of a problem as in the user's file, without the kinds that pydantic inserts (stops.1.disc.radius_ratio)."""
    parts: list[str] = []
    after_kind = False
    for place, part in enumerate(location):
        inside = isinstance(data, dict)
        # The kind of a shape or light follows its index once, and may have the name of one of its keys (mask).
        if inside and not after_kind and part in (data.get("shape"), data.get("kind")):
            after_kind = True
            continue
        if inside and part not in data and place < len(location) - 1:
            continue
        if part == "":
            break
        parts.append(str(part))
        after_kind = False
        try:
            data = data[part] if inside or isinstance(data, (list, tuple)) else None
        except (KeyError, IndexError, TypeError):
            data = None
    return ".".join(parts)
