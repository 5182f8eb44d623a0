"""Messages on the command line: their parts, cuts, filters, and typing them in."""

import re
from typing import Any

import click
import numpy as np
import pytest

from tests.simulated_bus import Bus
from tfbus.base.errors import DecodeError
from tfbus.cli.message import (
    complete_values,
    find_type,
    supplied_calls,
    supplied_type,
)
from tfbus.cli.topic.message_view import MessageFilter, Shortening, csv_row, part_of
from tfbus.cli.topic.source import reader_of
from tfbus.geometry.batch import TransformBatch
from tfbus.messages import Color, JointState, Odometry, Path, PoseStamped, TeleportRelative, Twist
from tfbus.wire.codec import encode_map
from tfbus.wire.transforms import TransformMessage, encode_transforms

MESSAGE = {"x": 1.5, "cells": [3.5, {"name": "left"}], "linear": {"x": 2, "y": 0}}


def usage_error(function: Any, *arguments: Any) -> str:
    """The sentence of the usage error that the call raises."""
    with pytest.raises(click.UsageError) as caught:
        function(*arguments)
    return caught.value.message


@pytest.mark.parametrize(
    ("path", "part"),
    [("x", 1.5), ("linear.x", 2), ("cells[1].name", "left"), ("cells.0", 3.5), ("", MESSAGE)],
)
def test_a_part_is_found_by_its_path(path: str, part: object) -> None:
    """A path goes through maps by name and through lists by index."""
    assert part_of(MESSAGE, path) == part


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("z", "there is no field 'z'; available: cells, linear, x"),
        ("liner.x", "there is no field 'liner.x': no 'liner'; did you mean 'linear'?"),
        ("x.y", "there is no field 'x.y': the value there has no fields, so no 'y'"),
        ("cells[2]", "there is no field 'cells[2]': '2' is not an index of a list of 2"),
    ],
)
def test_an_unknown_part_is_an_error_with_a_near_name(path: str, sentence: str) -> None:
    """An unknown path is an error that names its wrong part."""
    assert usage_error(part_of, MESSAGE, path) == sentence


@pytest.mark.parametrize(
    ("path", "part"),
    [("frame_id", "laser"), ("stamp_ns", 3_000_000_007), ("header.frame_id", "laser")],
)
def test_a_field_of_the_header_has_our_name_too(path: str, part: object) -> None:
    """As `tfbus topic show` and Python name it, also in an expression; and as it is printed."""
    stamp = {"sec": 3, "nanosec": 7}
    scan = {"header": {"stamp": stamp, "frame_id": "laser"}, "ranges": [1.0]}
    assert part_of(scan, path) == part
    assert part_of({"poses": [scan]}, f"poses[0].{path}") == part
    assert MessageFilter(f"m.{path} == {part!r}").takes(scan)


def test_what_is_too_long_is_cut() -> None:
    """Texts, bytes and lists are cut at a length, and marked; without one nothing is cut."""
    message = {"a": "abcdef", "b": b"\x01\x02\x03", "c": [1, 2, 3], "d": {"e": "ab"}, "f": None}
    assert Shortening(2).shorten(message) == {
        "a": "ab...",
        "b": "0102...",
        "c": [1, 2, "..."],
        "d": {"e": "ab"},
        "f": None,
    }
    assert Shortening(None).shorten(message) == message | {"b": "010203"}


def test_long_values_can_be_left_out() -> None:
    """Lists and texts can be shown by their lengths alone."""
    message = {"a": "abcdef", "b": b"\x01", "c": [1, 2, 3]}
    assert Shortening(2, lists=False).shorten(b"123") == "<3 bytes>"
    assert Shortening(2, lists=False, texts=False).shorten(message) == {
        "a": "<text of 6>",
        "b": "<1 bytes>",
        "c": "<list of 3>",
    }


def test_a_row_of_csv_has_all_values() -> None:
    """Maps and lists become one row, in order; a text with a comma is quoted."""
    assert csv_row({"x": 1.5, "l": [2, {"n": "a,b"}], "e": []}) == '1.5,2,"a,b"'
    assert csv_row(7) == "7"


def test_a_filter_sees_fields_as_attributes() -> None:
    """A filter is a Python expression of the message `m`."""
    assert MessageFilter("m.x > 1 and m.cells[1].name == 'left'").takes(MESSAGE)
    assert not MessageFilter("m.linear.x > 2").takes(MESSAGE)


@pytest.mark.parametrize(
    ("expression", "sentence"),
    [
        ("m.z > 1", "--filter 'm.z > 1' fails: AttributeError: no field 'z'; available: cells, "),
        ("m.x >", "--filter 'm.x >' is not a Python expression: invalid syntax"),
        ("m.x.y", "--filter 'm.x.y' fails: AttributeError: 'float' object has no attribute 'y'"),
    ],
)
def test_an_invalid_filter_is_an_error(expression: str, sentence: str) -> None:
    """A filter that is not an expression, or fails, is a usage error."""
    report = usage_error(lambda: MessageFilter(expression).takes(MESSAGE))
    assert report.startswith(sentence)


def test_missing_fields_take_their_defaults() -> None:
    """A map becomes a whole message of its type, numbers as the type has them."""
    assert complete_values({"linear": {"x": 2}}, Twist) == {
        "linear": {"x": 2.0, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": 0.0},
    }
    assert complete_values({"linear": 1}, TeleportRelative.Request) == {
        "linear": 1.0,
        "angular": 0.0,
    }
    path = complete_values({"poses": [{"pose": {"position": {"x": 1}}}]}, Path)
    [pose] = path["poses"]
    assert pose["pose"]["position"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    assert pose["header"]["frame_id"] == ""


def test_fields_may_be_those_of_ros() -> None:
    """Of a type that ROS has with others; what is missing is as in a new message of ROS."""
    pose = {"header": {"frame_id": "map", "stamp": {"sec": 1}}, "pose": {"position": {"x": 1}}}
    for name in ("PoseStamped", "geometry_msgs/msg/PoseStamped"):
        assert complete_values(pose, find_type(name)) == {
            "stamp_ns": 1_000_000_000,
            "frame_id": "map",
            "pose": {
                "position": {"x": 1.0, "y": 0.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        }
    twist = {"twist": {"twist": {"linear": {"x": 2}}}}
    assert complete_values(twist, Odometry)["twist"]["twist"]["linear"]["x"] == 2.0


def test_fields_may_have_their_former_names() -> None:
    """A command that was written down before a field had ROS's name still sends its value."""
    state = complete_values({"names": ["a"], "positions": [1]}, JointState)
    assert (state["name"], state["position"]) == (["a"], [1.0])
    pose = complete_values({"frame": "map", "position": {"x": 1}}, PoseStamped)
    assert (pose["frame_id"], pose["pose"]["position"]["x"]) == ("map", 1.0)


@pytest.mark.parametrize(
    ("values", "message_type", "sentence"),
    [
        (
            {"header": {"frame": "map"}},
            PoseStamped,
            "not a valid geometry_msgs/msg/PoseStamped: there is no field 'header.frame'; "
            "std_msgs/msg/Header has stamp, frame_id",
        ),
        (
            {"polygon": {"points": [{"x": 1, "w": 2}]}},
            find_type("geometry_msgs/msg/PolygonInstance"),
            "not a valid geometry_msgs/msg/PolygonInstance: there is no field "
            "'polygon.points[0].w'; "
            "geometry_msgs/msg/Point32 has x, y, z",
        ),
        ({"linaer": {}}, Twist, "Twist has no field 'linaer'; did you mean 'linear'?"),
        ({"linear": {"w": 2}}, Twist, "Vector3 has no field 'linear.w'; available: x, y, z"),
        ({"linear": 2}, Twist, "not a valid Twist: field 'linear' must be a map, not an integer"),
        (
            {"r": 300, "g": 0, "b": 0},
            Color,
            "not a valid Color: r must be from 0 to 255, not 300",
        ),
    ],
)
def test_values_of_another_type_are_errors(
    values: dict[str, Any], message_type: type, sentence: str
) -> None:
    """An unknown field or an invalid value is an error, with a near name."""
    assert usage_error(complete_values, values, message_type) == sentence


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "Twits",
            "tfbus.messages has no message 'Twits' (write your own as package.module:Name); did "
            "you mean 'Twist'?",
        ),
        ("nosuch.module:A", "'nosuch.module' cannot be imported: No module named 'nosuch'"),
        ("json:Battery", "json has no dataclass 'Battery'; a message must be one"),
        (":Battery", "'' is no module: write package.module:Battery"),
        (".messages:Battery", "'.messages' is no module"),
    ],
)
def test_an_unknown_type_is_an_error(text: str, sentence: str) -> None:
    """A type is one of tfbus.messages, or a dataclass by its module."""
    assert usage_error(find_type, text).startswith(sentence)


def test_types_are_found_by_name() -> None:
    """`Twist` is tfbus's own; another is named by its module and a colon."""
    assert find_type("Twist") is supplied_type("Twist") is Twist
    assert find_type("tfbus.messages:Color") is Color
    assert supplied_type("Spawn") is None  # a service


def test_messages_are_read_by_the_name_of_their_type() -> None:
    """A supplied type is checked; of any other, the map is what it is."""
    payload = encode_map({"r": 1, "g": 2, "b": 3, "a": 4})
    assert reader_of("Color")(payload) == {"r": 1, "g": 2, "b": 3}
    assert reader_of("Colour")(payload) == {"r": 1, "g": 2, "b": 3, "a": 4}
    with pytest.raises(DecodeError, match=re.escape("field 'x' is missing")):
        reader_of("Pose")(encode_map({"stamp_ns": 1}))


def test_transforms_are_shown_as_they_came() -> None:
    """Of transforms each row is shown, also one that a buffer would refuse."""
    edges = np.array([[0, 1]], dtype=np.uint32)
    poses = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 9.0]])
    batch = TransformBatch(("w", ""), edges, np.array([7]), poses)
    read = reader_of("TransformMessage")(encode_transforms(TransformMessage(batch, 5)))
    assert read == {
        "epoch": 5,
        "transforms": [
            {
                "stamp_ns": 7,
                "frame_id": "w",
                "child_frame_id": "",
                "transform": {
                    "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
                    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 9.0},
                },
            }
        ],
    }


class TestShow:
    def run(self, bus: Bus, *arguments: str) -> str:
        done = bus.run(*arguments)
        assert done.stderr == ""
        return done.stdout

    def test_a_type_has_its_fields_and_defaults(self, bus: Bus) -> None:
        """`topic show` and `service show` print fields, types and defaults, nested ones too."""
        assert self.run(bus, "service", "show", "turtlesim/srv/Spawn").splitlines() == [
            "Spawn: Puts another turtle on the field.",
            "",
            "Request: The start, in m and rad; an empty name means the next free turtleN.",
            "  x: float",
            "  y: float",
            "  theta: float = 0.0",
            '  name: str = ""',
            "",
            "Response: The name of the new turtle.",
            "  name: str",
        ]
        assert "  linear: Vector3\n    x: float = 0.0\n" in self.run(bus, "topic", "show", "Twist")

    def test_what_is_on_the_bus_is_shown_by_its_type(self, bus: Bus) -> None:
        """A topic or service stands for its type; of a foreign one it says where to look."""
        node = bus.node("sim")
        node.create_publisher(Twist, "cmd")
        node.create_raw_publisher("power", type_name="Battery")
        node.create_service(TeleportRelative, "move", lambda by: TeleportRelative.Response())
        assert self.run(bus, "topic", "show", "cmd").startswith("Twist: ")
        assert self.run(bus, "service", "show", "move").startswith("TeleportRelative: ")
        foreign = bus.run("topic", "show", "power")
        assert foreign.returncode == 1
        assert "is of type Battery" in foreign.stderr
        assert "did you mean 'Twist'?" in bus.run("topic", "show", "Twits").stderr

    def test_all_types_are_listed(self, bus: Bus) -> None:
        """Without an argument there is a line for each type, with what it is for."""
        listed = self.run(bus, "service", "show").splitlines()
        assert [line.split()[0] for line in listed] == [
            type_.__name__ for type_ in supplied_calls()
        ]
        [kill] = [line for line in listed if line.startswith("Kill ")]
        assert "a turtle" in kill
