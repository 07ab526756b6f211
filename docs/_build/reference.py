"""The pages of the reference, made from the models, the commands and the public names when the site is built.

A hook of MkDocs: ``on_files`` adds the pages to the site; nothing is written into the repository.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from dasim.camera.datasheet import DataSheet
from dasim.camera.specification import Camera
from dasim.dataset.specification import DatasetSpec
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.specification import Scene
from recon.settings import DEFAULT_PRESET, DESCRIPTIONS, PAPER, PRESETS, Settings
from validation.gates.limits import _GateText
from validation.studies.sweep.specification import Grid, StudySpec

MEANINGS, UNITS = (
    tomllib.loads((Path(__file__).parent / file).read_text(encoding="utf-8")) for file in ("meanings.toml", "units.toml")
)
LONGEST_DEFAULT = 60  # characters; longer defaults stand below their table
NOT_IN_FILES = ("folder",)  # set by whoever reads the file: where its pictures and meshes are looked up


class FilePage(NamedTuple):
    """A kind of TOML file: its page, its models, the outermost first, and its first lines."""

    name: str
    title: str
    models: tuple[type[BaseModel], ...]
    text: str


PAGES = (
    FilePage(
        "scene",
        "Scene",
        (Scene,),
        "The file of `dasim render SCENE`. The [guide](../../guides/scenes.md) explains it. A table `[materials.NAME]`, "
        "`[[lights]]` or `[[objects]]` has the keys of its `kind` or `shape`. Coordinates are x right, y down, z forward.",
    ),
    FilePage(
        "camera",
        "Camera",
        (Camera, DataSheet),
        "The file of `--camera`. The [guide](../../guides/cameras.md) explains it. A table `[[stops]]` has the keys of its "
        '`shape`, a disc where there is none. `[sensor.emva1288]` holds figures of a data sheet. `file = "NAME"` reads '
        "response curves from a CSV file and a mask from a grey picture; each lies beside the TOML file.",
    ),
    FilePage(
        "reconstruction",
        "Reconstruction",
        (Settings,),
        "The file of `dasim recon --settings`; `--print-settings` writes it. Keys that are left out have the values of "
        "the preset `paper`, which are the defaults below. `--settings` and `--preset` exclude each other.",
    ),
    FilePage(
        "dataset",
        "Dataset",
        (DatasetSpec,),
        "The file of `dasim dataset make`. The [guide](../../guides/datasets.md) explains it. `[scenes.random]` has the "
        "keys of [random scenes](random-scenes.md).",
    ),
    FilePage(
        "study",
        "Study",
        (StudySpec, Grid),
        "The file of `dasim study sweep`. The [guide](../../guides/studies.md) explains it. A value of a parameter is a "
        "number, a text, a list of them, or a grid.",
    ),
    FilePage(
        "random-scenes",
        "Random scenes",
        (RandomScenes,),
        "The file of `random:FILE.toml:SEED:INDEX`, and the table `[scenes.random]` of a dataset.",
    ),
    FilePage(
        "gates",
        "Gates",
        (_GateText,),
        'The file of `--gates`: a table for each figure, `["CLAIM.FIGURE"]`, with the keys below. Between the dots stands '
        "a name, several as `{D65,A}`, or `*` for any one name.",
    ),
)


class Key(NamedTuple):
    """A row of a table."""

    name: str
    unit: str
    allowed: str
    default: str
    meaning: str


# --- keys of files -------------------------------------------------------------------------------


def schemas(model: type[BaseModel]) -> dict[str, dict[str, Any]]:
    """JSON schemas of a model and of all models inside it by name, in the order in which a reader meets them."""
    whole = model.model_json_schema(by_alias=True, mode="validation")
    inner = whole.pop("$defs", {})
    found: dict[str, dict[str, Any]] = {model.__name__: whole}
    waiting = [whole]
    while waiting:
        for name in re.findall(r'"#/\$defs/(\w+)"', json.dumps(waiting.pop(0))):
            if name not in found:
                found[name] = inner[name]
                waiting.append(inner[name])
    return found


def keys(owner: str, schema: dict[str, Any]) -> list[Key]:
    """The keys of a model: each with its unit, what is allowed, its default and its meaning."""
    required = schema.get("required", ())
    return [
        Key(
            name,
            unit(owner, name, part),
            allowed(part),
            "required" if name in required else default(part),
            meaning(owner, name, part),
        )
        for name, part in schema["properties"].items()
        if name not in NOT_IN_FILES
    ]


def unit(owner: str, name: str, part: dict[str, Any]) -> str:
    """Unit of a key, which the ending of its name says; a dash where a number has none or the value is no number."""
    of_model = UNITS["models"].get(owner, {})
    if name in of_model:
        return str(of_model[name])
    fitting = [end for end in UNITS["endings"] if f"_{name}".endswith(f"_{end}")]
    if fitting:
        return str(UNITS["endings"][max(fitting, key=len)])
    if "" in of_model:
        return str(of_model[""])
    return "1" if re.search(r'"type": "(number|integer)"', json.dumps(part)) else "–"


def allowed(part: dict[str, Any]) -> str:
    """What a value may be, with its range."""
    if "$ref" in part:
        name = part["$ref"].rsplit("/", 1)[1]
        return f"table [{name}](#{name.lower()})"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in part:
            kinds = [allowed(entry) for entry in part[several] if entry.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if "const" in part or "enum" in part:
        return ", ".join(f"`{json.dumps(value)}`" for value in part.get("enum", [part.get("const")]))
    kind = part.get("type")
    if kind == "array":
        return _list(part)
    if kind == "object":
        values = part.get("additionalProperties")
        inner = f" to {allowed(values)}" if isinstance(values, dict) else ""
        return f"table: names{inner}"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true` or `false`"}
    return names.get(str(kind), "any value") + limits(part)


def _list(part: dict[str, Any]) -> str:
    least, most = part.get("minItems"), part.get("maxItems")
    if "prefixItems" in part:
        return "[" + ", ".join(allowed(entry) for entry in part["prefixItems"]) + "]"
    size = {(True, True): f", {least} to {most}", (True, False): f", at least {least}", (False, True): f", at most {most}"}
    return f"list{size.get((least is not None, most is not None), '')}: {allowed(part.get('items', {}))}"


def limits(part: dict[str, Any]) -> str:
    """Range of a number or length of a text."""
    low, above = part.get("minimum"), part.get("exclusiveMinimum")
    high, below = part.get("maximum"), part.get("exclusiveMaximum")
    signs = ((low, "≥"), (above, ">"), (high, "≤"), (below, "<"))
    listed = [f"{sign} {_number(value)}" for value, sign in signs if value is not None]
    if not listed and part.get("type") == "string" and part.get("minLength"):
        return ", not empty" + (f", at most {part['maxLength']} characters" if "maxLength" in part else "")
    return (" " + ", ".join(listed)) if listed else ""


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:,.12g}" if abs(value) < 1e9 else f"{value:.4g}"


def default(part: dict[str, Any]) -> str:
    """Default of a key as TOML has it."""
    if "default" not in part:
        return "empty"
    value = part["default"]
    if value is None:
        return "none"
    if value in ([], {}, ""):
        return "empty"
    if isinstance(value, dict) and "$ref" in part:
        return "its defaults"
    text = json.dumps(value, ensure_ascii=False)
    return f"`{text}`" if len(text) <= LONGEST_DEFAULT else "see below"


def meaning(owner: str, name: str, part: dict[str, Any]) -> str:
    """Description of a key: that of the model, else of meanings.toml."""
    return str(part.get("description") or MEANINGS.get(owner, {}).get(name) or MEANINGS["any"].get(name, ""))


def key_tables(page: FilePage) -> Iterator[str]:
    """Lines of a page with a section for each model."""
    yield from (f"# {page.title}: keys", "", page.text, "")
    for root in page.models:
        for name, schema in schemas(root).items():
            if name == RandomScenes.__name__ and page.name == "dataset":
                yield from ("## RandomScenes", "", "See [random scenes](random-scenes.md).", "")
                continue
            yield from (f"## {name.lstrip('_')}", "", *docstring(schema.get("description", "")), "")
            rows = keys(name, schema)
            yield from ("| key | unit | allowed | default | meaning |", "|---|---|---|---|---|")
            for row in rows:
                cells = (f"`{row.name}`", row.unit, row.allowed, row.default, _code(row.meaning))
                yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
            yield ""
            for key in (row.name for row in rows if row.default == "see below"):
                value = json.dumps(schema["properties"][key]["default"], ensure_ascii=False)
                yield from (f"Default of `{key}`: `{value}`", "")
    if page.name == "reconstruction":
        yield from presets()


def presets() -> Iterator[str]:
    """Lines of the table of presets: what each changes of the preset ``paper``."""
    yield from ("## Presets", "", f"The default is `{DEFAULT_PRESET}`.", "")
    yield from ("| preset | what it does | keys that differ from `paper` |", "|---|---|---|")
    base = PAPER.model_dump()
    for name, settings in PRESETS.items():
        changed = {key: value for key, value in settings.model_dump().items() if value != base[key]}
        listed = ", ".join(f"`{key} = {json.dumps(value)}`" for key, value in changed.items())
        yield f"| `{name}` | {DESCRIPTIONS[name]} | {listed or 'none'} |"


# --- commands ------------------------------------------------------------------------------------


def commands() -> str:
    """The page of the commands, from their docstrings."""
    from dasim.cli import app

    text = app.generate_docs(output_format="markdown").replace("# dasim\n", "# Commands\n", 1)
    text = re.sub(r"## Table of Contents.*?(?=\*\*Commands\*\*)", "", text, count=1, flags=re.DOTALL)
    text = re.sub(r"\n {4,}(?=\S)", " ", text)  # the continued lines of docstrings
    return text.replace("```console", "```")


# --- Python --------------------------------------------------------------------------------------

PACKAGES = {
    "dasim": "Scenes, cameras, captures, datasets and banks.",
    "recon": "From a raw mosaic and a bank of point-spread functions to picture, depth and all-in-focus picture.",
    "validation": "Scores against the ground truth.",
}


def python() -> Iterator[str]:
    """Lines of the page of the public names, from the stubs and docstrings."""
    yield from ("# Python", "", "The public names of the three packages. Images are [y, x] or [y, x, channel]; ")
    yield from ("pixel centres lie at +0.5, x to the right, y down, z forward, lengths in metres.", "")
    for package, text in PACKAGES.items():
        module = importlib.import_module(package)
        yield from (f"## {package}", "", text, "")
        for name in sorted(module.__all__, key=str.lower):
            yield from public_name(package, name, getattr(module, name))


def public_name(package: str, name: str, value: Any) -> Iterator[str]:
    """Lines on a function, class or constant."""
    title = f"{package}.{name}"
    yield from (f"### {title}", "")
    home = getattr(value, "__module__", "").split(".")[0]
    if home in PACKAGES and home != package and hasattr(importlib.import_module(home), name):
        yield from (f"The same as [`{home}.{name}`](#{home}{name.lower()}).", "")
    elif inspect.isclass(value):
        yield from ("```python", *fields(value), "```", "", *docstring(inspect.getdoc(value) or ""), "")
    elif inspect.isroutine(value):
        yield from ("```python", *signature(name, value), "```", "", *docstring(inspect.getdoc(value) or ""), "")
    else:
        text = ", ".join(f"`{key}`" for key in value) if isinstance(value, dict) else f"`{value!r}`"
        yield from (f"Value: {text}", "")


def signature(name: str, function: Any) -> list[str]:
    """A function's signature as its file has it, one parameter a line where it is long."""
    parts = []
    star = False
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not star:
            parts.append("*")
            star = True
        shown = f"{'*' if parameter.kind is parameter.VAR_POSITIONAL else ''}{parameter.name}"
        if parameter.annotation is not parameter.empty:
            shown += f": {parameter.annotation}"
        if parameter.default is not parameter.empty:
            default = "..." if callable(parameter.default) else repr(parameter.default)
            shown += f" = {default}" if "<" not in default else " = ..."
        parts.append(shown)
    returned = inspect.signature(function).return_annotation
    end = f") -> {returned}" if isinstance(returned, str) else ")"
    line = f"{name}({', '.join(parts)}{end}"
    return [line] if len(line) <= 90 else [f"{name}(", *(f"    {part}," for part in parts), end]


def fields(kind: type) -> list[str]:
    """The head and fields of a class as its file has them, with the comments on shapes and units."""
    lines = inspect.getsource(kind).splitlines()
    body = "\n".join(lines)
    body = re.sub(r'"""(.|\n)*?"""\n?', "", body, count=1)
    head = re.split(r"\n    (?:@|def )", body, maxsplit=1)[0]
    if issubclass(kind, BaseModel):
        types = inspect.get_annotations(kind)
        return [f"class {kind.__name__}:", *(f"    {name}: {types[name]}" for name in kind.model_fields if name in types)]
    if not is_dataclass(kind):
        return [line for line in head.splitlines() if line.startswith("class")]
    return [line for line in head.rstrip().splitlines() if line.strip() and not line.startswith("@")]


def docstring(text: str) -> list[str]:
    """A docstring as Markdown: its list of arguments as a list, names in double backquotes as code."""
    lines: list[str] = []
    inside = False
    for line in inspect.cleandoc(text).splitlines():
        heading = re.fullmatch(r"(Args|Returns|Raises|Yields):", line)
        entry = re.match(r"    (\w+): (.*)", line)
        if heading:
            inside = heading[1] == "Args"
            lines += ["", f"**{'Parameters' if inside else heading[1]}**", ""]
        elif inside and entry:
            lines.append(f"- `{entry[1]}`: {entry[2]}")
        elif inside and line.startswith("     "):
            lines[-1] += " " + line.strip()
        else:
            inside = inside and not line.strip()
            lines.append(line.strip() if line.startswith("    ") and not line.strip().startswith("-") else line)
    return [_code(line) for line in lines]


def _code(text: str) -> str:
    """reStructuredText's code and roles as Markdown's."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    return re.sub(r"``([^`]+)``", r"`\1`", text).replace("<", "&lt;") if "`" not in text or "``" in text else text


# --- the site ------------------------------------------------------------------------------------


def pages() -> dict[str, str]:
    """All pages of the reference by their path."""
    made = {f"reference/keys/{page.name}.md": "\n".join(key_tables(page)) for page in PAGES}
    index = ["# Keys of TOML files", "", "Made from the models that read the files; an unknown key is refused.", ""]
    index += [f"- [{page.title}]({page.name}.md): {page.text.split('. ')[0]}" for page in PAGES]
    made["reference/keys/index.md"] = re.sub(r"\]\(\.\./\.\./", "](../../", "\n".join(index))
    return made | {"reference/commands.md": commands(), "reference/python.md": "\n".join(python())}


def on_files(files: Any, config: Any) -> Any:
    """Add the pages to the site."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files
