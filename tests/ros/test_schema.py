"""Messages of topics as messages of ROS: a schema that ROS reads, and values as they were."""

import inspect
import math
import struct
from dataclasses import dataclass, is_dataclass, make_dataclass
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.builders import examples
from tfbus import DecodeError, InvalidArgumentException, messages
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.schema import RAW, MessageCodec, MessageCodecs
from tfbus.ros.tf_message import TFMessageReader
from tfbus.wire.codec import as_map, from_map

SEPARATOR = "=" * 80

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
whole = st.integers(-(2**63), 2**64 - 1)
values = st.recursive(
    st.none() | st.booleans() | whole | st.floats() | texts | st.binary(max_size=8),
    lambda each: st.lists(each, max_size=4) | st.dictionaries(texts, each, max_size=4),
    max_leaves=12,
)
maps = st.dictionaries(texts, values, max_size=5)


@dataclass(frozen=True)
class Battery:
    """Messages of users: each kind of field."""

    percent: float
    cells: list[float]
    names: dict[str, int]
    range_m: tuple[float, float]
    label: tuple[str, int]
    serialNumber: bytes
    rows: list[list[int]]
    worst: messages.Color
    colors: list[messages.Color]
    extra: Any
    parts: "list[Battery]"


BATTERY = Battery(
    0.5,
    [1.0, math.inf],
    {"a": -1, "": 2**62},
    (0.0, -0.0),
    ("x", 3),
    b"\0\xff",
    [[1], [], [2, 3]],
    messages.Color(1, 2, 3),
    [messages.Color(4, 5, 6)],
    {"any": [None, 1.5]},
    [],
)


def message_types() -> list[type]:
    """All dataclasses of tfbus.messages, those of services and actions too."""
    found = []
    for holder in vars(messages).values():
        if inspect.isclass(holder) and holder.__module__ == messages.__name__:
            each = [holder, *filter(inspect.isclass, vars(holder).values())]
            found += [kind for kind in each if is_dataclass(kind)]
    return found


def by_rosbags(definition: Definition, data: bytes) -> Any:
    """The message as rosbags reads it, written again to the same bytes."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition.text, definition.name))
    message = store.deserialize_cdr(data, definition.name)
    assert bytes(store.serialize_cdr(message, definition.name)) == data
    return message


def read_back(codec: MessageCodec, data: bytes) -> dict[str, Any]:
    """What the codec reads, and any program that has only the definition."""
    read = codec.decode(data)
    assert same(MessageCodec.of_definition(codec.definition).decode(data), read)
    return read


def same(one: Any, other: Any) -> bool:
    """Whether two values are the same to the last bit, in types and the order of keys too."""
    if isinstance(one, float) and isinstance(other, float):
        return struct.pack("d", one) == struct.pack("d", other)
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return [*one] == [*other] and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


@given(st.lists(maps, min_size=1, max_size=4))
def test_any_messages_come_back(all_values: list[dict[str, Any]]) -> None:
    """Whatever fields messages of one type have, no value is lost."""
    codecs = MessageCodecs()
    for each in all_values:
        codec, data = codecs.encode("a.type", each)
        assert same(read_back(codec, data), each)


@settings(max_examples=examples(25))
@given(maps)
def test_any_message_is_one_of_ros(each: dict[str, Any]) -> None:
    """Whatever fields a message has, rosbags reads it, and writes the same bytes."""
    codec, data = MessageCodecs().encode("a.type", each)
    by_rosbags(codec.definition, data)


@pytest.mark.parametrize("message_type", message_types(), ids=lambda kind: kind.__qualname__)
def test_types_of_tfbus_are_types_of_ros(message_type: type) -> None:
    """Each type of tfbus.messages has a definition that ROS's parser reads."""
    codec = MessageCodec.of_type(message_type)
    get_types_from_msg(codec.definition.text, codec.definition.name)


def test_a_pose_has_this_definition() -> None:
    """What others see of a topic: plain fields, under the name of its type."""
    codec = MessageCodec.of_type(messages.Pose)
    assert codec.definition == Definition(
        "tfbus_msgs/msg/Pose",
        "int64 stamp_ns\nfloat64 x\nfloat64 y\nfloat64 theta\nfloat64 linear_velocity\n"
        "float64 angular_velocity\n",
    )
    data = codec.encode(as_map(messages.Pose(2**63 - 1, 1, -0.0, math.pi, 5e-324, 0.25)))
    assert data is not None
    read = by_rosbags(codec.definition, data)
    assert (read.stamp_ns, read.x, read.linear_velocity) == (2**63 - 1, 1.0, 5e-324)


def test_every_kind_of_field_comes_back() -> None:
    """Nested messages, lists of lists, maps, tuples and Any are expressed, and come back."""
    codec = MessageCodec.of_type(Battery)
    data = codec.encode(as_map(BATTERY))
    assert data is not None
    assert from_map(Battery, read_back(codec, data)) == BATTERY
    read = by_rosbags(codec.definition, data)
    assert list(read.range_m) == [0.0, -0.0]
    assert bytes(read.serial_number) == b"\0\xff"
    assert (read.names.entries[0].key, read.names.entries[0].value) == ("a", -1)


@pytest.mark.parametrize("known", [messages.Imu, messages.PoseStamped])
def test_a_type_of_a_program_is_not_that_of_its_name(known: type) -> None:
    """A dataclass that only calls itself as a type of tfbus.messages has its own fields."""
    name = MessageCodec.of_type(known).definition.name
    other = make_dataclass(known.__name__, [("note", str, "")])
    if "__msgtype__" in vars(known):
        other.__msgtype__ = name  # type: ignore[attr-defined]
    codec = MessageCodec.of_type(other)
    assert codec.definition.name != name
    data = codec.encode({"note": "near"})
    assert data is not None and codec.decode(data) == {"note": "near"}


def test_messages_of_known_types_have_their_definition_from_the_start() -> None:
    """A whole number in a field of floats makes no other type of it."""
    codecs = MessageCodecs()
    codec, data = codecs.encode(
        "Twist", {"linear": dict(x=1, y=0, z=0), "angular": dict(x=0, y=0, z=1.5)}
    )
    assert codec.definition == MessageCodec.of_type(messages.Twist).definition
    assert codec.decode(data)["angular"] == {"x": 0.0, "y": 0.0, "z": 1.5}


def test_a_message_that_does_not_fit_gets_a_type_that_holds_both() -> None:
    """A type grows with its messages, and then stays: under another name, as ROS wants."""
    codecs = MessageCodecs()
    sent: list[dict[str, Any]] = [
        {"x": 1, "list": []},
        {"x": 2**63, "list": [1]},
        {"x": 2, "list": []},
        {"x": 3, "list": [2.5]},
        {"x": 4, "list": [True]},
    ]
    names, texts = [], []
    for each in sent:
        codec, data = codecs.encode("State", each)
        assert same(codec.decode(data), each)
        names.append(codec.definition.name.rpartition("/")[2])
        texts.append(codec.definition.text.splitlines()[:2])
    assert names == ["State", "State2", "State2", "State3", "State4"]
    assert texts[0] == ["int64 x", "tfbus_msgs/Msgpack[] list"]
    assert texts[1] == ["uint64 x", "int64[] list"]
    assert texts[3] == ["int64 x", "float64[] list"]


@pytest.mark.parametrize(
    "sent",
    [
        [{"x": 1.5}, {"x": 1}, {"x": 2.5}],
        [{"x": 1}, {"x": 1.5}, {"x": 2**63}, {"x": -1}],
        [{"list": [1, 2.5]}, {"list": [1.0, 2.5]}, {"list": [1, 2]}],
        [{"at": {"x": 1.5, "y": 1}}, {"at": {"x": 1, "y": 1.5}}],
        [{"points": [{"x": 1.5}, {"x": 1}]}, {"points": [{"x": 1.0}]}],
        [{"map": {}}, {"map": {"a": 1, "b": 2.5}}],
        [{"a": 1, "b": 2}, {"b": 1, "a": 2}],
        [{"in": {"a": 1, "b": 2}}, {"in": {"b": 1, "a": 2}}],
        [{"in": [{"a": 1, "b": 2}, {"b": 1, "a": 2}]}],
        [{"x": 1.5, "y": 1.5, "z": 1.5}]
        + [
            {"x": x, "y": y, "z": z, "w": w}
            for x in (1, 1.0)
            for y in (1, 1.0)
            for z in (1, 1.0)
            for w in (1, 1.0)
        ],
    ],
    ids=lambda sent: str(sent[:2])[:40],
)
def test_nothing_changes_between_messages_of_one_type(sent: list[dict[str, Any]]) -> None:
    """Integers stay integers, floats floats, and keys stay in order, whatever came before."""
    codecs = MessageCodecs()
    for each in [*sent, *sent]:
        codec, data = codecs.encode("State", each)
        assert same(read_back(codec, data), each)


def test_fields_that_are_integers_and_floats_in_turn_have_two_definitions() -> None:
    """Each plain, so that others show both."""
    codecs = MessageCodecs()
    found = [codecs.encode("State", {"x": x})[0].definition for x in (1.5, 1, 2.5, 2)]
    assert [each.name.rpartition("/")[2] for each in found] == ["State", "State2"] * 2
    assert [each.text.split()[0] for each in found] == ["float64", "int64"] * 2


def test_for_eyes_one_definition_is_enough() -> None:
    """What is not exact takes integers and floats alike, in lists too."""
    codecs = MessageCodecs(exact=False)
    texts = []
    for each in ({"x": 1.5, "l": [1, 2.5]}, {"x": 1, "l": [1.0]}, {"x": 2, "l": [1]}):
        codec, data = codecs.encode("State", each)
        assert codec.decode(data) == each
        texts.append(codec.definition.text)
    assert texts == ["float64 x\nfloat64[] l\n"] * 3


def test_a_topic_without_a_type_does_not_make_definitions_without_end() -> None:
    """After eight forms of messages the others are MessagePack."""
    codecs = MessageCodecs()
    names = set()
    for number in range(100):
        codec, data = codecs.encode("changing", {f"field{number}": number})
        assert codec.decode(data) == {f"field{number}": number}
        names.add(codec.definition.name)
    assert len(names) == 9 and RAW.definition.name in names


@pytest.mark.parametrize(
    "each",
    [
        {1: "a"},
        {b"a": 1},
        {"x" * 101: 1},
        {f"field{number}": 0 for number in range(201)},
    ],
    ids=["number", "bytes", "long", "many"],
)
def test_what_are_no_fields_is_messagepack(each: dict[Any, Any]) -> None:
    """Maps that ROS cannot express come back all the same."""
    codec, data = MessageCodecs().encode("odd", each)
    assert codec is RAW
    assert codec.decode(data) == each
    assert (
        msgpack.unpackb(bytes(by_rosbags(RAW.definition, data).data), strict_map_key=False) == each
    )


@pytest.mark.parametrize("each", [{"a": 2**64}, {"a": "\ud800"}, {"a": object()}])
def test_what_no_message_can_have_is_refused(each: dict[str, Any]) -> None:
    """A value that could not have come from a bus ends in one sentence."""
    with pytest.raises(InvalidArgumentException, match="'T' cannot be written"):
        MessageCodecs().encode("T", each)


@pytest.mark.parametrize(
    "each",
    [
        {},
        {"x": 1.0, "n": 1, "more": 0},
        {"x": "1", "n": 1},
        {"x": 1.0, "n": 1.0},
        {"x": 1.0, "n": True},
        {"x": True, "n": 1},
        {"x": 1, "n": 1},
        {"n": 1, "x": 0.5},
        {"x": 1.0, "n": 2**63},
        {"x": None, "n": 1},
    ],
)
def test_what_does_not_fit_is_not_encoded(each: dict[str, Any]) -> None:
    """Nothing is rounded or converted; the caller takes another codec."""
    assert MessageCodec.of_values("T", {"x": 0.5, "n": 1}).encode(each) is None


def test_two_types_never_have_one_name() -> None:
    """Names that differ only in signs, and parts of messages, get numbers."""
    codecs = MessageCodecs()
    store = get_typestore(Stores.LATEST)
    for name, each in [
        ("a.b", {"c": {"x": 1}}),
        ("a_b", {"c": {"x": 1.5}}),
        ("a.b.c", {"y": ""}),
        ("msgpack", {"data": "no bytes"}),
    ]:
        codec, _ = codecs.encode(name, each)
        store.register(get_types_from_msg(codec.definition.text, codec.definition.name))


def test_names_of_fields_are_those_of_ros() -> None:
    """Fields get names that ROS allows; the names in the map stay."""
    each = {"frameId": 1, "frame_id": 2, "été": 3, "2d": 4, "_x_": 5, "": 6, "class": 7, "日": 8}
    codec = MessageCodec.of_values("T", each)
    lines = codec.definition.text.splitlines()
    names = [line.split()[1] for line in lines]
    assert names == [
        "frame_id",
        "frame_id_2",
        "t",
        "field_2d",
        "x",
        "field",
        "class",
        "field_2",
    ]
    data = codec.encode(each)
    assert data is not None and read_back(codec, data) == each


# Definitions of others


FOREIGN = f"""\
# A comment = with signs
int32 NUMBER=5  # a constant
string TEXT = "a # b"
std_msgs/Header header
Part[<=3] parts
  float32[4] four  # of them
string<=5 short "default"
string<=3[<=2] names
byte[] raw
bool[2] flags
char letter
time at
duration long
float64[] empty
builtin_interfaces/msg/Duration last
{SEPARATOR}
MSG: my_msgs/Part
uint16 id
int8[] numbers
Nothing nothing
{SEPARATOR}
MSG: my_msgs/Nothing
"""


@pytest.mark.parametrize("order", ["le", "be"])
def test_any_message_of_ros_is_read(order: str) -> None:
    """Every kind of field of a foreign definition, in both byte orders, as rosbags writes it."""
    definition = Definition("my_msgs/msg/Whole", FOREIGN)
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(FOREIGN, definition.name))
    types: Any = store.types
    time = types["builtin_interfaces/msg/Time"]
    duration = types["builtin_interfaces/msg/Duration"]
    nothing = types["my_msgs/msg/Nothing"]()
    part = types["my_msgs/msg/Part"](7, np.array([-1, 2], np.int8), nothing)
    message = types[definition.name](
        types["std_msgs/msg/Header"](time(-1, 2), "map"),
        [part, part],
        np.array([0, 1, 2, 3.5], np.float32),
        "abcé",
        ["", "xyz"],
        np.array([1, 255], np.uint8),
        np.array([True, False]),
        65,
        time(1, 999_999_999),
        duration(-5, 1),
        np.array([], np.float64),
        duration(3, 4),
    )
    data = bytes(store.serialize_cdr(message, definition.name, little_endian=order == "le"))
    codec = MessageCodec.of_definition(definition)
    expected = {
        "header": {"stamp": {"sec": -1, "nanosec": 2}, "frame_id": "map"},
        "parts": [{"id": 7, "numbers": [-1, 2], "nothing": {}}] * 2,
        "four": [0.0, 1.0, 2.0, 3.5],
        "short": "abcé",
        "names": ["", "xyz"],
        "raw": b"\x01\xff",
        "flags": [True, False],
        "letter": 65,
        "at": {"sec": 1, "nanosec": 999_999_999},
        "long": {"sec": -5, "nanosec": 1},
        "empty": [],
        "last": {"sec": 3, "nanosec": 4},
    }
    assert codec.decode(data) == expected
    if order == "le":
        assert codec.encode(expected) == data


def all_definitions() -> list[Definition]:
    """The types that rosbags knows of ROS 2."""
    store = get_typestore(Stores.LATEST)
    return [
        Definition(name, store.generate_msgdef(name, ros_version=2)[0])
        for name in sorted(store.types)
        if "/msg/" in name and "wstring" not in store.generate_msgdef(name, ros_version=2)[0]
    ]


def test_all_types_of_ros_are_read() -> None:
    """Every definition of ROS 2's own messages is read, under the name it has."""
    definitions = all_definitions()
    assert len(definitions) > 150
    for definition in definitions:
        MessageCodec.of_definition(definition)


def test_the_definition_of_transforms_is_that_of_ros() -> None:
    """Ours is the text that rosbags makes, and reads what the fast way writes."""
    store = get_typestore(Stores.LATEST)
    assert store.generate_msgdef(TF_MESSAGE.name, ros_version=2)[0] == TF_MESSAGE.text
    data = MessageCodec.of_definition(TF_MESSAGE).encode({"transforms": []})
    assert data is not None and TFMessageReader().read(data).count == 0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("wstring name", "has a wstring"),
        ("float64", "'float64' in the definition of a/msg/T is no field"),
        ("float64[ x", "is no field"),
        ("int32<=5 x", "is no field"),
        ("int32[0] x", "is no field"),
        ("b/Missing x", "the definition of b/msg/Missing is missing"),
        ("T x", "contains itself"),
        (f"b/U x\n{SEPARATOR}\nMSG: b/U\na/T x", "contains itself"),
        ("float64 \x1b[31mx", r"\\x1b\[31m"),
        ("#" * 1_000_001, "at most a million"),
    ],
)
def test_a_wrong_definition_is_refused(text: str, reason: str) -> None:
    """One sentence says what is wrong in which message; nothing of it reaches a terminal raw."""
    with pytest.raises(DecodeError, match=reason):
        MessageCodec.of_definition(Definition("a/msg/T", text))


def test_remarks_of_others_are_comments() -> None:
    """Only our own messages say with a comment what their value is."""
    text = '# tfbus: value\nint64 x # tfbus: "y"\n'
    data = b"\0\1\0\0" + struct.pack("<q", 5)
    assert MessageCodec.of_definition(Definition("a/msg/T", text)).decode(data) == {"x": 5}
    ours = Definition("tfbus_msgs/msg/T", 'int64 x # tfbus: "y"\n')
    assert MessageCodec.of_definition(ours).decode(data) == {"y": 5}
