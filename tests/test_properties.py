"""Properties of what reads files of others, for values that Hypothesis draws; the same ones in every run.

The fuzzer (``tests/fuzz``) damages files and asks how commands end. Here the values themselves are drawn, so that also
what is read from them can be checked: it is what was written, or the file is refused in one line.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pydantic import BaseModel

from dasim.base import untrusted
from dasim.base.errors import LONGEST, InputError, describe_error, one_line, shortened
from dasim.base.toml import parse, parse_toml, to_toml
from dasim.camera import specification as cameras
from dasim.cli import options
from dasim.files.banks import KERNEL_SUM_TOLERANCE, load_bank
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.loading import SCENE_DIR
from dasim.scene.specification import Scene
from recon.settings import Settings
from tests.fuzz import subjects
from tests.test_ranges import models

settings.register_profile("same", derandomize=True, database=None, deadline=None, max_examples=60,
                          phases=(Phase.explicit, Phase.generate, Phase.shrink),
                          suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])  # fmt: skip
settings.load_profile("same")

WHOLE = st.integers(-(1 << 128) + 1, (1 << 128) - 1)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)  # all of Unicode but halves of surrogate pairs
PLAIN = st.recursive(
    st.one_of(st.booleans(), WHOLE, FINITE, TEXT),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXT, inner, max_size=3)),
    max_leaves=8,
)
ANYTHING = st.recursive(  # also what no file should hold
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), TEXT, st.sampled_from([1e308, -1e-308, 2**63])),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXT, inner, max_size=3)),
    max_leaves=8,
)


def refused_well(error: InputError, where: str) -> bool:
    """Whether a message is one printable line of a limited length that says where the problem is."""
    message = str(error)
    return message.isprintable() and len(message) <= LONGEST and message.startswith(where)


# --- messages ------------------------------------------------------------------------------------


@given(st.text(max_size=50) | st.integers(0, 3 * LONGEST).map("ab\x1b ".__mul__))
def test_messages_are_one_printable_line(text):
    line = one_line(text)
    assert line.isprintable() and len(line) <= LONGEST and one_line(line) == line
    assert one_line(str(InputError(text))) == line and describe_error(InputError(text)) == line


@given(ANYTHING)
def test_values_in_messages_are_short(value):
    assert len(shortened(value)) <= 60


# --- TOML and JSON -------------------------------------------------------------------------------


@given(st.dictionaries(TEXT, PLAIN, max_size=4))
def test_toml_that_is_written_is_read_again(tmp_path_factory, values):
    """Expectation: equal values of equal types. The reader is ``tomllib`` of Python, the writer dasim's own."""
    path = tmp_path_factory.getbasetemp() / "written.toml"
    path.write_text(to_toml(values), encoding="utf-8", newline="")
    assert same(untrusted.toml(path, "file"), values)


def same(read: Any, written: Any) -> bool:
    """Whether two plain values are equal, including their types; the order of keys may differ."""
    if isinstance(written, dict):
        return isinstance(read, dict) and read.keys() == written.keys() and all(same(read[k], written[k]) for k in read)
    if isinstance(written, list):
        return isinstance(read, list) and len(read) == len(written) and all(map(same, read, written))
    return type(read) is type(written) and read == written


@given(st.dictionaries(TEXT, PLAIN, max_size=4))
def test_json_that_is_written_is_read_again(values):
    assert same(untrusted.json_values(json.dumps(values), "file"), values)


@given(st.text(max_size=60) | st.text(st.sampled_from("[]{}\"'=.,#\n\t\r\\ux0e1-+:_ tfn\x00é"), max_size=60))
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    for read in (lambda: untrusted.toml(path, "file"), lambda: untrusted.json_object(path, "file")):
        try:
            assert isinstance(read(), dict)
        except InputError as error:
            assert refused_well(error, "file: ")


# --- specifications ------------------------------------------------------------------------------


@pytest.mark.parametrize("model", models(), ids=lambda model: model.__qualname__)
def test_values_of_any_type_are_refused_in_one_line(model: type[BaseModel]):
    """Set-up: tables with the keys of a model and any value in each. Expectation: a value of the model, or one line."""
    names = [field.alias or name for name, field in model.model_fields.items()]
    tables = st.dictionaries(st.sampled_from(names) if names else TEXT, ANYTHING, max_size=4) | ANYTHING

    @settings(max_examples=20)
    @given(tables)
    def check(values: Any) -> None:
        try:
            parse(model, values, "file")
        except InputError as error:
            assert refused_well(error, "file: ")

    check()


def places(values: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all values within tables and lists."""
    inner = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    for key, value in inner:
        yield (*here, key)
        yield from places(value, (*here, key))


def replaced(values: Any, place: tuple[Any, ...], by: Any) -> Any:
    """A copy of plain values with another one at a place."""
    if not place:
        return by
    copy = dict(values) if isinstance(values, dict) else list(values)
    copy[place[0]] = replaced(copy[place[0]], place[1:], by)
    return copy


@pytest.mark.parametrize(
    ("model", "path"),
    [
        (cameras.Camera, cameras.CAMERA_DIR / "da-mobile.toml"),
        (cameras.Camera, cameras.CAMERA_DIR / "da-8mm.toml"),
        (Scene, SCENE_DIR / "desk.toml"),
        (RandomScenes, None),
        (Settings, None),
    ],
)
def test_one_value_of_a_file_replaced_by_any(model, path):
    """Expectation: refused in one line, or a value that is the same after writing and reading."""
    whole = parse_toml(model, path) if path else model()
    folder = path.parent if path else Path(".")
    plain = untrusted.toml(path, "file") if path else whole.model_dump(mode="json", by_alias=True)

    @given(st.sampled_from(list(places(plain))), ANYTHING)
    def check(place: tuple[Any, ...], value: Any) -> None:
        try:
            read = parse(model, replaced(plain, place, value), "file", folder)
        except InputError as error:
            assert refused_well(error, "file: ")
        else:
            assert parse(model, json.loads(read.model_dump_json(by_alias=True)), "file", folder) == read

    check()


# --- arrays and pictures -------------------------------------------------------------------------

NUMBERS = st.one_of(arrays.boolean_dtypes(), arrays.integer_dtypes(), arrays.unsigned_integer_dtypes(),
                    arrays.floating_dtypes(endianness="?"))  # fmt: skip
ARRAYS = arrays.arrays(NUMBERS, arrays.array_shapes(min_dims=0, max_dims=5, min_side=0, max_side=4))


@given(ARRAYS, st.booleans())
def test_arrays_are_read_as_numpy_reads_them(tmp_path_factory, values, column_major):
    path = tmp_path_factory.getbasetemp() / "array.npy"
    np.save(path, np.array(values, order="F" if column_major else "C"))
    read = untrusted.array(path, "file")
    np.testing.assert_array_equal(read, np.load(path))
    assert read.dtype == values.dtype and read.shape == values.shape


@pytest.fixture(scope="module")
def bank(tmp_path_factory) -> dict[str, np.ndarray]:
    """The arrays of a valid bank."""
    folder = tmp_path_factory.mktemp("bank")
    subjects.write(folder)
    return dict(np.load(folder / "bank" / "bank.npz"))


@settings(max_examples=120)
@given(st.data())
def test_bank_with_any_array_is_refused_or_a_bank(tmp_path_factory, bank, data):
    """Expectation: kernels of unit sum, in order of depth, or one line."""
    name = data.draw(st.sampled_from(sorted(bank)))
    like = arrays.arrays(bank[name].dtype, bank[name].shape) if bank[name].dtype.kind == "f" else ARRAYS
    path = tmp_path_factory.getbasetemp() / "drawn.npz"
    np.savez(path, **(bank | {name: data.draw(like | ARRAYS)}))
    try:
        read = load_bank(path)
    except InputError as error:
        assert refused_well(error, str(path)) or refused_well(error, "bank")
    else:
        np.testing.assert_allclose(read.kernel.sum(axis=(-2, -1)), 1, atol=2 * KERNEL_SUM_TOLERANCE)
        assert (np.diff(read.depth_m) < 0).all() and np.isfinite(read.signature).all()


@given(st.integers(0, 10**6), st.integers(0, 255))
def test_picture_with_another_byte_is_refused_or_the_same(place, byte):
    """Rationale: a decoder fills what it cannot read with zeros, and says nothing. All bytes are under a checksum."""
    picture = np.arange(48, dtype=np.uint16).reshape(6, 8) * np.uint16(997)
    data = bytearray(cv2.imencode(".png", picture)[1].tobytes())
    data[place % len(data)] = byte
    try:
        np.testing.assert_array_equal(untrusted.decoded(bytes(data), "file", cv2.IMREAD_UNCHANGED), picture)
    except InputError as error:
        assert refused_well(error, "file: ")


# --- options -------------------------------------------------------------------------------------


@given(st.text(max_size=12) | st.from_regex(r"-?[0-9]{1,5}[x,*X]-?[0-9]{1,5}", fullmatch=True))
def test_sizes(text):
    try:
        width, height = options.size(text)
        assert width > 0 and height > 0
    except InputError as error:
        assert refused_well(error, "--size")
