"""The topics that cross, by the table, a file and the command line."""

import re
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tfbus import SettingsError, TfbusError
from tfbus.ros.bridge.common import BridgeOptions, RosFrameNames
from tfbus.ros.bridge.topic_table import TABLE, TopicTable
from tfbus.ros.bridge.topics import Translation
from tfbus.ros.counterparts import LIVE_COUNTERPARTS
from tfbus.wire.codec import decode_map, encode_map

BATTERY = "sensor_msgs/msg/BatteryState"


def table(folder: Path, text: str, *topics: str) -> TopicTable:
    """The table with the lines of a file."""
    (folder / "topics.yaml").write_text(text)
    return TopicTable.of_file(folder / "topics.yaml", topics)


def mistake(folder: Path, text: str) -> str:
    """What is said of a file, without its folder."""
    with pytest.raises(TfbusError) as caught:
        table(folder, text)
    return str(caught.value).replace(f"{folder}/", "")


@pytest.mark.parametrize("line", TABLE, ids=lambda line: line.type_name)
def test_the_definitions_are_those_of_ros(line: object) -> None:
    """Each type of the table has the fields that ROS 2 gives it."""
    definition = line.counterpart.definition
    store = get_typestore(Stores.ROS2_KILTED)
    types = get_types_from_msg(definition.text, definition.name)
    for name, (_, fields) in types.items():
        if name in store.fielddefs:
            assert fields == store.fielddefs[name][1], name


def test_a_topic_of_the_bus_is_found_by_its_type() -> None:
    """Whatever its name is; a type that is not in the table does not cross."""
    lines = TopicTable()
    found = lines.line_of("robot/goal", "PoseStamped")
    assert found is not None and found.ros_type == "geometry_msgs/msg/PoseStamped"
    assert lines.line_of("robot/goal", "Goal") is None


def test_usual_names_are_looked_for_in_ros() -> None:
    """cmd_vel, odom and their like, each by its type."""
    names = {name: line.ros_type for name, line in TopicTable().names.items()}
    assert names["cmd_vel"] == "geometry_msgs/msg/Twist"
    assert names["turtle1/pose"] == "turtlesim/msg/Pose"
    assert names["odom"] == "nav_msgs/msg/Odometry"


def test_a_topic_may_be_asked_for() -> None:
    """By its name where that says the type, or with one of ours or of ROS's."""
    asked = ("/arm/cmd_vel", "arm/goal=PoseStamped", "arm/state=sensor_msgs/msg/JointState")
    names = TopicTable.of_file(None, asked).names
    assert names["arm/cmd_vel"].type_name == "Twist"
    assert names["arm/goal"].type_name == "PoseStamped"
    assert names["arm/state"].type_name == "JointState"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("arm/target", "give it as arm/target=TYPE, one of Twist, Pose, "),
        ("goal=PoseStampd", "no type that crosses; did you mean 'PoseStamped'?"),
        ("goal=Nope", "'Nope' is no type that crosses; available: "),
        ("", "is no topic"),
    ],
)
def test_what_is_asked_for_must_be_clear(text: str, said: str) -> None:
    """The error says how to ask, and is of the command line."""
    with pytest.raises(SettingsError, match=re.escape(said)) as caught:
        TopicTable.of_file(None, [text])
    assert str(caught.value).count("JointState") <= 1


def test_a_line_maps_an_own_type(tmp_path: Path) -> None:
    """Fields cross by the paths that it gives, times as nanoseconds; the rest is as ROS has it."""
    lines = table(
        tmp_path,
        "my_robot/battery:\n"
        f"  type: my_msgs.Battery\n  ros: {BATTERY}\n  direction: to-ros\n"
        "  fields: {charge: percentage, stamp_ns: header.stamp, pack.id: serial_number}\n",
    )
    line = lines.line_of("my_robot/battery", "Battery")
    assert line is not None and (line.type_name, line.ros_type) == ("Battery", BATTERY)
    assert line.goes_to_ros and not line.comes_from_ros
    ours = {"charge": 0.5, "stamp_ns": 7_000_000_005, "pack": {"id": "A7"}, "other": 1}
    theirs = line.counterpart.to_ros(ours)
    assert theirs == {
        "percentage": 0.5,
        "header": {"stamp": 7_000_000_005},
        "serial_number": "A7",
    }


def test_a_type_of_its_own_is_given_by_a_file(tmp_path: Path) -> None:
    """Standard types in it need no definition."""
    (tmp_path / "Gripper.msg").write_text("std_msgs/Header header\nfloat32 width\n")
    lines = table(tmp_path, "gripper: {ros: my_msgs/Gripper, msg: Gripper.msg}\n")
    line = lines.names["gripper"]
    assert line.type_name == line.ros_type == "my_msgs/msg/Gripper"
    assert "MSG: std_msgs/Header" in line.counterpart.definition.text


def test_without_a_type_a_message_is_as_in_ros(tmp_path: Path) -> None:
    """With its full name and its fields, as programs with ROS's messages have it on the bus."""
    lines = table(tmp_path, f"a: {{ros: {BATTERY}}}\nb: {{type: {BATTERY}, ros: {BATTERY}}}\n")
    values = {"header": {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "base"}, "voltage": 0.5}
    for name in ("a", "b"):
        line = lines.line_of(name, BATTERY)
        assert line is not None and line.type_name == BATTERY
        translation = Translation(line, RosFrameNames(BridgeOptions()), lambda: 0)
        there = translation.to_ros(encode_map(values))
        back = decode_map(translation.of_ros(there))
        assert {field: back[field] for field in values} == values
    with pytest.raises(TfbusError, match=r"Battery.*`type: Battery`"):
        lines.line_of("a", "Battery")


def test_without_a_type_one_that_tfbus_has_is_that(tmp_path: Path) -> None:
    """A PoseStamped on the bus is that of tfbus.messages, also by a line of its own."""
    lines = table(tmp_path, "target: {ros: geometry_msgs/msg/PoseStamped, direction: from-ros}\n")
    line = lines.names["target"]
    assert line.counterpart is LIVE_COUNTERPARTS["PoseStamped"]


def test_a_line_goes_before_the_table(tmp_path: Path) -> None:
    """It may turn a topic off, or have it cross one way only."""
    lines = table(tmp_path, 'turtle1/pose: {direction: to-ros}\n"debug/*": off\n')
    pose = lines.line_of("turtle1/pose", "Pose")
    assert pose is not None and not pose.comes_from_ros and pose.stamps
    assert pose.counterpart is LIVE_COUNTERPARTS["Pose"]
    off = lines.line_of("debug/pose", "Pose")
    assert off is not None and off.direction == "off"
    assert not lines.names["turtle1/pose"].comes_from_ros


def test_another_type_than_that_of_its_line_is_said(tmp_path: Path) -> None:
    """With both types."""
    lines = table(tmp_path, f"battery: {{type: Battery, ros: {BATTERY}}}\n")
    with pytest.raises(TfbusError, match=r"Pose.*Battery"):
        lines.line_of("battery", "Pose")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: {ros: sensor_msgs/msg/BateryState}", "topics.yaml:1: a.ros: sensor_msgs/msg/Bat"),
        (
            f"a:\n  ros: {BATTERY}\n  fields: {{c: percent}}",
            "a.fields.c: sensor_msgs/msg/BatterySt",
        ),
        (
            f"a: {{ros: {BATTERY}, fields: {{a: voltage, a.b: charge}}}}",
            "a.fields.a.b: 'a.b' overlaps with 'a': give each field once",
        ),
        (
            f"a: {{ros: {BATTERY}, fields: {{f: header.frame_id, h: header}}}}",
            "'header.frame_id' overlaps with 'header'",
        ),
        (
            f"a: {{ros: {BATTERY}, fields: {{a: voltage, b: voltage}}}}",
            "'voltage' overlaps with 'voltage'",
        ),
        (f"a: {{ros: {BATTERY}, direction: up}}", "must be one of both, to-ros, from-ros, off"),
        (
            "a: {direction: sideways}",
            "a.direction: must be one of both, to-ros, from-ros, off, not",
        ),
        (f"a: {{rso: {BATTERY}}}", "unknown key 'rso'; did you mean 'ros'?"),
        ("a: {type: Battery}", "needs `ros`, the type in ROS"),
        ("a: on", "must be a map with `type` and `ros`, or off"),
        (f"a: {{ros: {BATTERY}, depth: 0}}", "must be a number from 1 to 10,000, not '0'"),
        ("a: {type: Pose, ros: geometry_msgs/msg/Pose}", "Pose is turtlesim/msg/Pose in ROS"),
        ("a: {ros: my_msgs/msg/A, msg: none.msg}", "a.msg: none.msg cannot be read: No such file"),
        ("- a", "must be a mapping"),
    ],
)
def test_a_mistake_has_its_line(tmp_path: Path, text: str, said: str) -> None:
    """And its key, and what is allowed."""
    assert said in mistake(tmp_path, text)
    assert mistake(tmp_path, text).startswith("topics.yaml:")


def test_the_page_has_this_table() -> None:
    """docs/guide/ros2.md has each type of the bus's own, its type in ROS, and the names
    looked for.
    """
    page = (Path(__file__).parents[3] / "docs" / "guide" / "ros2.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| `([\w/]+)` \| (.*) \|$", page, re.M)
    assert rows == [
        (
            line.type_name,
            line.ros_type,
            ", ".join([f"`{name}`" for name in line.names]) + ", retained" * line.retained,
        )
        for line in TABLE
        if line.type_name != line.ros_type
    ]
