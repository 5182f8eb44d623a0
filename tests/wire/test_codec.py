"""Messages of topics and services: dataclasses to bytes and back, and refused bytes."""

import re
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, cast

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import BusError, DecodeError
from tfbus.messages import Color, JointState, Pose, Twist, Vector3
from tfbus.wire.codec import decode_map, decode_message, encode_map, encode_message, from_map


@dataclass(frozen=True)
class Point:
    x: float
    y: float = 0.0


@dataclass(frozen=True)
class Everything:
    whole: int
    number: float
    yes: bool
    text: str
    raw: bytes
    point: Point
    points: list[Point] = field(default_factory=list)
    table: list[list[int]] = field(default_factory=list)
    fixed: tuple[int, ...] = ()


int64 = st.integers(-(2**63), 2**63 - 1)
texts = st.text(st.characters(exclude_categories=["Cs"]))
points = st.builds(Point, st.floats(allow_nan=False), st.floats(allow_nan=False))
everything = st.builds(
    Everything,
    int64,
    st.floats(allow_nan=False),
    st.booleans(),
    texts,
    st.binary(),
    points,
    st.lists(points),
    st.lists(st.lists(int64)),
    st.lists(int64).map(tuple),
)

VALUES = {
    "whole": 1,
    "number": 2.5,
    "yes": True,
    "text": "t",
    "raw": b"r",
    "point": {"x": 1.0},
}


def refusal(values: object, message_type: type = Everything, **how: bool) -> str:
    """Why the values are refused."""
    with pytest.raises(DecodeError) as caught:
        decode_message(message_type, msgpack.packb(values), **how)
    return str(caught.value)


def test_equal_values_of_other_types_keep_their_types() -> None:
    """1 and True are equal, and so are messages that have them."""

    @dataclass(frozen=True)
    class Column:
        size: int

    @dataclass(frozen=True)
    class Table:
        columns: tuple[Column, ...]

    for value in (1, True, 1.0):
        columns: Any = (Column(cast(int, value)),)
        [found] = decode_map(encode_message(Table(columns)))["columns"]
        assert type(found["size"]) is type(value)


@given(everything)
def test_what_is_written_is_read_back(message: Everything) -> None:
    """Any message comes back equal, nested ones and lists too."""
    assert decode_message(Everything, encode_message(message)) == message


def test_a_message_is_a_map_of_its_fields() -> None:
    """On the wire a message is a msgpack map from field to value, so any language can read it."""
    assert msgpack.unpackb(encode_message(Twist(Vector3(x=2.0), Vector3(z=1.5)))) == {
        "linear": {"x": 2.0, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 1.5},
    }


def test_fields_with_a_default_may_be_missing() -> None:
    """A field that has a default need not be sent."""
    assert decode_message(Everything, msgpack.packb(VALUES)) == Everything(
        1, 2.5, True, "t", b"r", Point(1.0)
    )


def test_an_integer_stands_for_a_number() -> None:
    """An integer in a float field becomes a float."""
    point = from_map(Point, {"x": 3})
    assert (point, type(point.x)) == (Point(3.0), float)


@pytest.mark.parametrize("number", [0, 1])
def test_nought_and_one_stand_for_false_and_true(number: int) -> None:
    """0 and 1 are valid in a boolean field, as people write turtlesim's `off: 1`."""
    assert from_map(Everything, VALUES | {"yes": number}).yes is bool(number)


def test_unknown_fields_of_a_message_are_ignored() -> None:
    """A topic message may have fields that we do not know: its sender may be newer."""
    assert from_map(Point, {"x": 1.0, "z": 3.0}) == Point(1.0)


def test_a_key_that_is_no_text_is_an_unknown_field() -> None:
    """Also in a message with former names of its fields."""
    values = {"stamp_ns": 1, "names": ["hinge"], "positions": [0.5], b"ab": [1, 2]}
    message = decode_message(JointState, msgpack.packb(values))
    assert (message.name, message.position) == (("hinge",), (0.5,))


def test_unknown_fields_of_a_request_are_refused() -> None:
    """A request with a field that the service does not know is refused with those it has."""
    said = refusal({"x": 1.0, "z": 3.0}, Point, unknown_fields=False)
    assert said.endswith("'z'; Point has x, y")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"whole": 1.0}, "field 'whole' must be an integer, not a number"),
        ({"whole": True}, "field 'whole' must be an integer, not a boolean"),
        ({"number": True}, "field 'number' must be a number, not a boolean"),
        ({"number": "2.5"}, "field 'number' must be a number, not a text"),
        ({"yes": 2}, "field 'yes' must be a boolean, not an integer"),
        ({"yes": 1.0}, "field 'yes' must be a boolean, not a number"),
        ({"text": b"t"}, "field 'text' must be a text, not bytes"),
        ({"text": None}, "field 'text' must be a text, not nothing"),
        ({"raw": "r"}, "field 'raw' must be bytes, not a text"),
        ({"point": [1.0]}, "field 'point' must be a map, not a list"),
        ({"point": {}}, "field 'point.x' is missing"),
        ({"point": {"x": "1"}}, "field 'point.x' must be a number, not a text"),
        ({"points": {"x": 1.0}}, "field 'points' must be a list, not a map"),
        ({"points": [{"x": 1.0}, 7]}, "field 'points[1]' must be a map, not an integer"),
        ({"points": [{"x": None}]}, "field 'points[0].x' must be a number, not nothing"),
        ({"table": [[1], [2, "3"]]}, "field 'table[1][1]' must be an integer, not a text"),
    ],
)
def test_a_field_of_the_wrong_type_is_named(change: dict[str, object], reason: str) -> None:
    """A field of the wrong type is refused with its path, the expected type, and its own."""
    assert refusal(VALUES | change) == reason


@dataclass(frozen=True)
class Catalogue:
    prices: dict[str, float]
    note: Any = None


def test_a_map_by_texts_and_anything_at_all_are_fields_too() -> None:
    """A dict keeps its keys and reads its values; a field of any type is read as it comes."""
    catalogue = Catalogue({"tea": 2.5, "water": 0.0}, [1, {"a": b"b"}])
    assert decode_message(Catalogue, encode_message(catalogue)) == catalogue
    assert re.search("'prices' .*a map, .*list$", refusal({"prices": [1]}, Catalogue))
    number = refusal({"prices": {"tea": "2"}}, Catalogue)
    assert re.search(r"'prices\.tea' .*a number, .*text$", number)
    assert re.search("'prices' .*a key .*a text$", refusal({"prices": {b"tea": 2}}, Catalogue))


def test_messages_in_a_map_by_texts_are_sent_too() -> None:
    """In lists, tuples and dicts, at any depth."""

    @dataclass(frozen=True)
    class Shelf:
        items: dict[str, Point]
        more: Any = None

    shelf = Shelf({"tea": Point(1.0)}, {"deep": [{"a": (Point(2.0, 3.0),)}]})
    sent = encode_message(shelf)
    assert decode_message(Shelf, sent).items == shelf.items
    assert decode_map(sent)["more"] == {"deep": [{"a": [{"x": 2.0, "y": 3.0}]}]}


def test_a_message_that_is_in_itself_is_refused_in_words() -> None:
    """By an error, not by the end of Python's stack."""

    @dataclass
    class Knot:
        inside: list[Any]

    knot = Knot([])
    knot.inside.append(knot)
    with pytest.raises(BusError, match="could not send a message"):
        encode_message(knot)


def test_a_field_in_a_message_of_a_list_is_named_if_it_cannot_be_sent() -> None:
    """With its path."""
    with pytest.raises(BusError, match=r"field 'points\[1\]\.x'"):
        encode_message(
            Everything(1, 2.0, True, "", b"", Point(1), [Point(1), Point(cast(Any, {1}))])
        )


def test_a_missing_field_is_named() -> None:
    """A message without a field that it must have is refused, and the field named."""
    assert refusal({}, Pose).endswith("'stamp_ns' is missing")


def test_a_value_that_the_message_refuses_is_no_message() -> None:
    """What the dataclass itself refuses is refused as bytes too, in its own words."""
    with pytest.raises(ValueError) as own:
        Color(256, 0, 0)
    assert refusal({"r": 256, "g": 0, "b": 0}, Color) == str(own.value)


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "not msgpack (ValueError: Unpack failed: incomplete input)"),
        (b"\x01", "a message must be a msgpack map, not an integer"),
        (b"\x80\x80", "not msgpack (ExtraData: unpack(b) received extra data.)"),
        (b"\x91" * 5000, "not msgpack (StackError: )"),
        (b"\x81\xa1a\xd4\x05x", "not msgpack (ValueError: it has an extension of type 5)"),
    ],
)
def test_bytes_that_are_no_map_are_refused(payload: bytes, reason: str) -> None:
    """Bytes that are not one msgpack map are refused with the reason."""
    with pytest.raises(DecodeError) as caught:
        decode_map(payload)
    assert str(caught.value) == reason


def test_a_time_of_msgpack_is_its_nanoseconds() -> None:
    """So that every message can be shown, and sent again."""
    assert decode_map(b"\x81\xa1a\xd6\xff\0\0\0\x02") == {"a": 2 * 10**9}


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(payload: bytes) -> None:
    """Random bytes are a message, or refused by a DecodeError, and nothing else."""
    with suppress(DecodeError):
        decode_message(Everything, payload)


values = st.recursive(
    st.none() | st.booleans() | int64 | st.floats() | texts | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(texts, inner),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(list(Everything.__dataclass_fields__)), values))
def test_any_map_raises_nothing_else(changes: dict[str, object]) -> None:
    """Fields of any type are read, or refused by a DecodeError, and nothing else."""
    try:
        decode_message(Everything, encode_map(VALUES | changes))
    except DecodeError as error:
        assert str(error)


def test_a_type_that_is_no_dataclass_is_refused_in_words() -> None:
    """A message type must be a dataclass; another type is our own mistake, and said so."""
    with pytest.raises(TypeError, match=r"not a message: .*dataclass"):
        encode_message(3)


def test_a_field_of_a_type_that_cannot_be_sent_is_refused_in_words() -> None:
    """A field of a type that no message can carry is refused when the message is first used."""

    @dataclass
    class Bad:
        when: complex

    with pytest.raises(TypeError, match=r"field of type .*complex"):
        encode_message(Bad(1j))


@dataclass(frozen=True)
class Row:
    edge: tuple[str, int]


def test_a_tuple_of_several_types_is_a_list_of_that_length() -> None:
    """A field of `tuple[str, int]` is a list of a text and an integer, and nothing else."""
    assert decode_message(Row, encode_message(Row(("world", 1)))) == Row(("world", 1))
    for wrong in (["world"], "wo"):
        assert re.search("'edge' .*a list of 2$", refusal({"edge": wrong}, Row))
    said = refusal({"edge": ["world", "1"]}, Row)
    assert re.search(r"'edge\[1\]' .*an integer, .*text$", said)


def test_a_text_that_utf_8_cannot_hold_is_an_error_in_one_sentence() -> None:
    """A lone surrogate comes from a command line in another encoding."""
    with pytest.raises(BusError, match=r"'caf\\udce9': .*Unicode$"):
        encode_map({"name": "caf\udce9"})


@pytest.mark.parametrize(
    ("value", "sent"),
    [
        (np.float32(0.1), float(np.float32(0.1))),
        (np.int64(-3), -3),
        (np.uint64(2**64 - 1), 2**64 - 1),
        (np.bool_(True), True),
        (np.arange(3, dtype=np.int16), [0, 1, 2]),
        (np.eye(2, dtype=np.float16), [[1.0, 0.0], [0.0, 1.0]]),
        (np.array(1.5), 1.5),
        (np.array(["a"]), ["a"]),
        ([np.zeros(2), {"x": np.float64(1)}], [[0.0, 0.0], {"x": 1.0}]),
    ],
    ids=repr,
)
def test_numbers_and_arrays_of_numpy_are_sent_exactly(value: object, sent: object) -> None:
    """As numbers and lists of Python, in messages and in plain maps."""
    assert decode_map(encode_map({"field": value})) == {"field": sent}
    assert decode_map(encode_message(Anything(value))) == {"field": sent}


@dataclass(frozen=True)
class Anything:
    field: Any


@pytest.mark.parametrize(
    "value",
    [
        np.array([1j]),
        np.array([object()]),
        np.array(["2026-01-01"], "datetime64[s]"),
        np.longdouble(1) if np.dtype(np.longdouble).itemsize > 8 else 1j,
        np.dtype(float),
        np.sum,
        object(),
        2**64,
        {1, 2},
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_value_that_cannot_be_sent_is_named_by_its_field(value: object) -> None:
    """With its type, and what may be sent."""
    with pytest.raises(BusError, match=r"field 'scan\.ranges\[1\]'") as caught:
        encode_map({"x": 1.0, "scan": {"ranges": [0.5, value]}})
    assert "an int, float" in str(caught.value)


def test_a_list_in_itself_cannot_be_sent() -> None:
    """It says so, and does not go on for ever."""
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(BusError, match="recursion"):
        encode_map({"list": endless})
