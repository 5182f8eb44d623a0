"""Why tfbus has definitions, CDR and hashes of its own: each promise with rosbags beside it.

A part of rosbags that fails is expected to, and no failure once it does better: then that part of
tfbus/ros may give way to it.
"""

import json
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from tfbus import DecodeError
from tfbus.ros.definitions import Definition, known_definition, message_named, standard_definition
from tfbus.ros.message_type import message_of
from tfbus.ros.rmw import type_hash
from tfbus.ros.schema import MessageCodec

typesys = pytest.importorskip("rosbags.typesys")

not_yet = pytest.mark.xfail(reason="rosbags does not", strict=False)

# std_msgs/msg/Char.json of ROS 2 Kilted.
HASH_OF_CHAR = "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9"

REQUEST = "std_srvs/srv/SetBool_Request"
WITH_DEFAULT = Definition("my_msgs/msg/Gain", "float64 gain 2.5\n")
WITH_KEY = Definition("tfbus_msgs/msg/Gps", 'int64 i_tow # tfbus: "iTOW"\n')
IN_ITSELF = Definition("my_msgs/msg/Tree", "my_msgs/Tree[] below\n")
MANY = Definition("my_msgs/msg/Names", "string[500] names\n")
TEXT = Definition("std_msgs/msg/String", "string data\n")
# A text without the zero at its end, as some writers make an empty one.
EMPTY = b"\0\1\0\0" + struct.pack("<I", 0)


def store_of(definition: Definition) -> Any:
    """A store of rosbags that knows this type only."""
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(definition.text, definition.name))
    return store


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """How many lines of code rosbags makes for each function."""
    cdr = pytest.importorskip("rosbags.serde.cdr")
    counts: list[int] = []
    compile_lines = cdr.compile_lines

    def compiled(code: list[str]) -> Any:
        counts.append(len(code))
        return compile_lines(code)

    monkeypatch.setattr(cdr, "compile_lines", compiled)
    return counts


def test_messages_of_services_are_known() -> None:
    """By the name that ROS has for the request of a service."""
    assert message_named(REQUEST).fields[0].name == "data"


@not_yet
def test_rosbags_knows_messages_of_services() -> None:
    """By the same name."""
    definition = standard_definition(REQUEST)
    assert definition is not None
    assert REQUEST in store_of(definition).fielddefs


def test_default_values_and_names_are_kept() -> None:
    """A default stands behind a field in a definition, a name in a comment in a recording."""
    assert message_of(WITH_DEFAULT).fields[0].default == 2.5
    assert message_of(WITH_KEY).fields[0].key == "iTOW"


@not_yet
def test_rosbags_keeps_default_values() -> None:
    """Somewhere among what it knows of the type."""
    _, fields = store_of(WITH_DEFAULT).fielddefs[WITH_DEFAULT.name]
    assert "2.5" in json.dumps(fields, default=str)


def test_a_message_in_itself_is_refused() -> None:
    """By the sentence that names it."""
    with pytest.raises(DecodeError, match="contains itself"):
        message_of(IN_ITSELF)


@not_yet
def test_rosbags_refuses_a_message_in_itself() -> None:
    """By an error of its own, where it is read or used."""
    with pytest.raises((typesys.TypesysError, ValueError)):
        store_of(IN_ITSELF).deserialize_cdr(EMPTY, IN_ITSELF.name)


def test_a_fixed_array_costs_what_its_message_has() -> None:
    """A definition of many items in one line is refused with the first short message."""
    with pytest.raises(DecodeError, match="bytes"):
        MessageCodec.of_definition(MANY).decode(EMPTY)


@not_yet
def test_a_fixed_array_costs_rosbags_what_its_message_has(lines: list[int]) -> None:
    """The code for it does not grow with the number that the definition says."""
    with pytest.raises(Exception, match=r"."):
        store_of(MANY).deserialize_cdr(EMPTY, MANY.name)
    assert max(lines) < 500


def test_an_empty_text_is_read_without_its_zero() -> None:
    """As some writers make it."""
    assert MessageCodec.of_definition(TEXT).decode(EMPTY) == {"data": ""}


@not_yet
def test_rosbags_reads_an_empty_text_without_its_zero() -> None:
    """The same bytes."""
    assert store_of(TEXT).deserialize_cdr(EMPTY, TEXT.name).data == ""


def test_the_hash_of_a_char_is_ros_s() -> None:
    """A char of a .msg file is a number of one byte."""
    assert type_hash(known_definition("std_msgs/msg/Char")) == HASH_OF_CHAR


@not_yet
def test_the_hash_of_a_char_is_ros_s_in_rosbags() -> None:
    """The same hash."""
    definition = known_definition("std_msgs/msg/Char")
    assert store_of(definition).hash_rihs01(definition.name) == HASH_OF_CHAR
