"""Specifications: frozen values that are read from TOML and validated, with all problems named by their keys.

Tested in tests/dasim/scene/test_specification.py and tests/dasim/camera/test_specification.py.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Set
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, RootModel, ValidationError, ValidationInfo, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from dasim.base import untrusted
from dasim.base.errors import InputError, shortened
from dasim.base.suggestions import did_you_mean


class _InOneLine(type(BaseModel)):  # type: ignore[misc]
    """Class of the classes of specifications, whose constructors raise InputError."""

    def __call__(cls, *args: Any, **fields: Any) -> Any:
        try:
            return super().__call__(*args, **fields)
        except ValidationError as error:
            raise _input_error(cls, fields, cls.__name__, error) from None


if TYPE_CHECKING:
    _Base = BaseModel  # type checkers take the parameters of constructors from the class of BaseModel alone
else:

    class _Base(BaseModel, metaclass=_InOneLine):
        pass


class Specification(_Base):
    """A frozen value that refuses unknown keys, NaN and infinity; its constructor raises InputError, in one line."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_"):
            super().__setattr__(name, value)
        else:
            kind = type(self).__name__
            raise InputError(f"{kind}.{name} cannot be changed; make another {kind}, of model_dump() with other values")

    def __hash__(self) -> int:
        try:
            return hash((type(self), *(getattr(self, name) for name in type(self).model_fields)))
        except TypeError:  # a table within it has no hash of its own
            return hash((type(self), self.model_dump_json()))

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_numbers(cls, data: Any) -> Any:
        """Refuse true, false and text where numbers are needed, which pydantic would convert."""
        for name in data if isinstance(data, dict) else ():
            leaves = _leaves_of(cls).get(name, frozenset())
            words = {leaf for leaf in leaves if isinstance(leaf, str)}  # 'auto' in place of a number
            if leaves & {int, float} and leaves - words <= {int, float, type(None)}:
                _check_numbers(name, data[name], words)
        return data


@cache
def _leaves_of(model: type[BaseModel]) -> dict[str, frozenset[Any]]:
    """Leaf types and literal values of each field of a model, by field name."""
    return {name: frozenset(_leaves(field.annotation)) for name, field in model.model_fields.items()}


def _leaves(annotation: Any) -> Iterator[Any]:
    """Leaf types and literal values of an annotation: those inside tuples, unions and dict values, without limits."""
    if get_origin(annotation) is Annotated:
        yield from _leaves(get_args(annotation)[0])
    elif get_origin(annotation) is dict:
        yield from _leaves(get_args(annotation)[1])
    elif parts := [part for part in get_args(annotation) if part is not Ellipsis]:
        for part in parts:
            yield from _leaves(part)
    else:
        yield annotation


def _check_numbers(key: str, value: Any, words: Set[str]) -> None:
    """Reject booleans, and strings other than ``words``, in a value and inside its lists and tables."""
    if isinstance(value, (list, tuple, dict)):
        for place, item in value.items() if isinstance(value, dict) else enumerate(value):
            _check_numbers(f"{key}.{place}", item, words)
    elif isinstance(value, bool) or (isinstance(value, str) and value not in words):
        about = {"place": key, "value": shortened(value)}
        raise PydanticCustomError(_NO_NUMBER, "{place}: must be a number (is {value})", about)


_NO_NUMBER = "no_number"  # type of the problem that a number is true, false or text
MOST_PROBLEMS = 20  # in one message
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
    names = sorted(p.stem for p in folder.glob("*.toml"))
    hint = did_you_mean(str(name_or_path).removesuffix(".toml").partition(":")[0], names)
    raise InputError(f"{kind} '{name_or_path}' is neither a bundled name ({', '.join(names)}) nor a file{hint}")


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
        raise _input_error(model, data, where, error) from None


def _input_error(model: type[BaseModel], data: Any, where: str, error: ValidationError) -> InputError:
    """The problems of plain data as one message, at most ``MOST_PROBLEMS`` of them."""
    problems = [_problem(item, data, model) for item in _causes(error.errors())]
    more = len(problems) - MOST_PROBLEMS
    shown = problems[:MOST_PROBLEMS] + ([f"and {more} more"] if more > 0 else [])
    return InputError(f"{where}: " + "; ".join(shown))


def to_toml(data: dict[str, Any], table: str = "") -> str:
    """Plain data as TOML text that :func:`parse_toml` reads: values, then tables and lists of tables, without None."""

    def is_tables(value: Any) -> bool:
        return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(item, dict) for item in value)

    given = {key: value for key, value in data.items() if value is not None}
    nested = {key: value for key, value in given.items() if isinstance(value, dict) or is_tables(value)}
    text = "".join(f"{_toml_key(key)} = {_toml_value(value)}\n" for key, value in given.items() if key not in nested)
    for key, value in nested.items():
        name = f"{table}.{_toml_key(key)}" if table else _toml_key(key)
        for item in [value] if isinstance(value, dict) else value:
            heading = f"[{name}]" if isinstance(value, dict) else f"[[{name}]]"
            text += f"\n{heading}\n{to_toml(item, name)}"
    return text


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Any) -> str:
    """A value in one line. Numbers, booleans and texts have the syntax of JSON, but DEL is escaped in TOML."""
    if isinstance(value, dict):
        inner = (f"{_toml_key(key)} = {_toml_value(item)}" for key, item in value.items() if item is not None)
        return "{" + ", ".join(inner) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


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


def _problem(item: Any, data: Any, model: type[BaseModel]) -> str:
    """A problem reported by pydantic, as text with its key, and with the nearest name where one is mistyped."""
    location = item["loc"]
    if item["type"] in ("value_error", _NO_NUMBER) and isinstance(item.get("input"), dict):
        location = (*location, "")  # the problem of a table: a kind at its end is not a key
    key = _key(location, data)
    message = item["msg"].removeprefix("Value error, ").replace("Input should", "must")
    if item["type"] == _NO_NUMBER:
        return f"{key}.{message}" if key else message
    if item["type"] == "extra_forbidden":
        return f"{key}: unknown key{did_you_mean(item['loc'][-1], _keys(model, item['loc'][:-1]))}"
    if item["type"] == "missing":
        return f"{key}: is missing"
    if item["type"].startswith("union_tag_"):
        return f"{key}: {_kind_problem(item['ctx'])}"
    value = item.get("input")
    is_now = f" (is {shortened(value)})" if isinstance(value, (str, int, float)) else ""
    if item["type"] == "literal_error":
        is_now += did_you_mean(value, re.findall(r"'([^']*)'", item["ctx"]["expected"]))
    return (f"{key}: {message}" if key else message) + is_now


def _kind_problem(context: dict[str, str]) -> str:
    """Message for a table whose kind, such as the ``shape`` of an object, is missing or unknown."""
    name = context["discriminator"].strip("'")
    if "tag" not in context:
        return f"{name} is missing"
    allowed = context["expected_tags"].replace("'", "")
    hint = did_you_mean(context["tag"], allowed.split(", "))
    return f"{name} {shortened(context['tag'])} is unknown; allowed are {allowed}{hint}"


def _keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys that are allowed at a location of pydantic's, which names kinds of tables and numbers entries of lists."""
    inside = list(_models(model))
    for part in location:
        fields = [field for place in inside for key, field in _fields(place) if key == part]
        of_kind = [place for place in inside if part in _literals(place)]
        inside = [table for field in fields for table in _models(field.annotation)] or of_kind or inside
    return list(dict.fromkeys(key for place in inside for key, _ in _fields(place)))


def _fields(model: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    """Keys of a table as its files name them, with their types."""
    return [(field.alias or name, field) for name, field in model.model_fields.items()]


def _literals(model: type[BaseModel]) -> set[Any]:
    """Values of the literals among a table's keys, its kind among them."""
    of_fields = (field.annotation for field in model.model_fields.values())
    return {value for kind in of_fields if get_origin(kind) is Literal for value in get_args(kind)}


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Tables within an annotation."""
    for leaf in _leaves(annotation):
        if isinstance(leaf, type) and issubclass(leaf, BaseModel):
            yield from _models(leaf.model_fields["root"].annotation) if issubclass(leaf, RootModel) else (leaf,)


def _key(location: tuple[int | str, ...], data: Any) -> str:
    """Key of a problem as in the user's file, with names instead of numbers where entries of a list have names
    (stops.hole.radius_ratio), and without the kinds that pydantic inserts (stops.1.disc.radius_ratio).
    """
    parts: list[str] = []
    after_kind = False
    for place, part in enumerate(location):
        inside = isinstance(data, dict)
        # pydantic inserts the kind of a shape or light once, after its index; a key may have the same name (mask).
        if inside and not after_kind and part in (data.get("shape"), data.get("kind")):
            after_kind = True
            continue
        if inside and part not in data and place < len(location) - 1:
            continue
        if part == "":
            break
        parts.append(_name_of_entry(data, part) or str(part))
        after_kind = False
        try:
            data = data[part] if inside or isinstance(data, (list, tuple)) else None
        except (KeyError, IndexError, TypeError):
            data = None
    return ".".join(parts)


def _name_of_entry(data: Any, part: int | str) -> str | None:
    """Name of an entry of a list, as a key of TOML; None where it has none, or not alone."""
    if not isinstance(data, (list, tuple)) or not isinstance(part, int) or part >= len(data):  # one may be missing
        return None
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in data]
    name = names[part]
    return _toml_key(name) if isinstance(name, str) and name and names.count(name) == 1 else None
