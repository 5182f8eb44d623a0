"""The descriptions of streams, as they come in."""

import msgpack
import pytest

from tests.builders import description
from tfbus import DecodeError
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import (
    DelayDescription,
    FailureDescription,
    ParameterDescription,
    facts_of_stream,
    read_description,
)
from tfbus.wire.numbered import IDENTITY


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("", "must not be empty"),
        ("/a", "'/a' begins with a slash; write 'a'"),
        ("a\x1b[31m", "'a\\x1b[31m' contains U+001B, which cannot be printed"),
        ("a\u202eb", "'a\\u202eb' contains U+202E, which cannot be printed"),
        ("a" * 256, "has 256 letters; at most 255 are allowed"),
    ],
)
def test_a_frame_with_a_name_that_none_can_have_is_left_out(name: str, mistake: str) -> None:
    """The others of the stream stay, and the first mistake is reported."""
    rows = [("world", "robot", False), ("world", name, True), (name, "arm", False)]
    found, told = read_description(encode_message(description(rows, host="h")))
    assert found == description(rows[:1], host="h")
    assert mistake in told


def test_a_description_without_mistakes_is_as_it_was_sent() -> None:
    """All its frames are there."""
    sent = description([("world", "wörld \N{TURTLE}", False)], session="ab12")
    assert read_description(encode_message(sent)) == (sent, "")


def test_names_in_a_node_s_description_come_as_they_can_be_shown() -> None:
    """Of its parameters, of what held its callbacks up, and of what they raised, too."""
    evil, shown = "a\x1b[31m", "a\\x1b[31m"
    parameter = ParameterDescription(evil, 1, evil, evil)
    assert (parameter.name, parameter.type, parameter.description) == (shown, shown, shown)
    delay = DelayDescription(evil, 2, evil, 0.5)
    assert (delay.what, delay.by) == (shown, shown)
    failure = FailureDescription(evil, 1, evil, 0)
    assert (failure.what, failure.error) == (shown, shown)


@pytest.mark.parametrize("field", ["host", "session"])
@pytest.mark.parametrize("name", ["a\nb", "a" * 256])
def test_a_description_with_a_name_that_cannot_be_shown_is_refused(field: str, name: str) -> None:
    """It would forge lines in tables and logs."""
    values = {"v": 1, "node": "/node", "epoch": 1, "frames": [], field: name}
    with pytest.raises(DecodeError, match=f"field '{field}' is 'a"):
        read_description(msgpack.packb(values))


def test_the_origin_of_a_stream_is_known_where_it_is_said() -> None:
    """The publishers of ROS that it stands for; older processes do not say any."""
    told = encode_message(description([], host="h", origin=("ab", "cd")))
    assert read_description(told)[0].origin == ("ab", "cd")
    values = msgpack.unpackb(told)
    del values["origin"]
    assert read_description(msgpack.packb(values))[0].origin == ()


def test_a_recording_says_of_numbers_only_that_there_are_some() -> None:
    """Of a stream that names its frames the facts are those of before; of another one the poses."""
    rows = [("world", "robot", False)]
    named = facts_of_stream(description(rows))
    assert not named.keys() & {"poses", "next_number", "numbered", "origins"}
    numbered = description(
        rows, poses="compact", next_number=1, numbered=((0, "world", "robot"),), origins=IDENTITY
    )
    assert facts_of_stream(numbered) == named | {"poses": "compact"}
