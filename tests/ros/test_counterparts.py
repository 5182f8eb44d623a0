"""Joint states and descriptions of robots, which ROS has under its own names."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tfbus import DecodeError, messages
from tfbus.cli.message import prototype
from tfbus.ros.counterparts import COUNTERPARTS, LIVE_COUNTERPARTS, counterpart_of_ros
from tfbus.ros.definitions import JOINT_STATE, STRING, Definition
from tfbus.ros.schema import MessageCodec, MessageCodecs
from tfbus.ros.value_codec import UnfitError
from tfbus.wire.codec import as_map, from_map

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
STATE = messages.JointState(
    1_795_354_648_223_567_966, ("a", "b"), (0.5, -1.0), (math.inf, 2.0), (0.0, -0.0)
)


def test_ros_reads_a_joint_state() -> None:
    """A JointState is a sensor_msgs/msg/JointState of ROS 2, field by field."""
    codec, data = MessageCodecs().encode("JointState", as_map(STATE))
    assert codec.definition == JOINT_STATE
    store = get_typestore(Stores.ROS2_JAZZY)
    read = store.deserialize_cdr(data, JOINT_STATE.name)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_795_354_648, 223_567_966)
    assert read.header.frame_id == ""
    assert (read.name, list(read.position)) == (["a", "b"], [0.5, -1.0])
    assert (list(read.velocity), list(read.effort)) == ([math.inf, 2.0], [0.0, 0.0])
    assert codec.decode(data) == as_map(STATE)


def test_a_joint_state_of_ros_is_ours() -> None:
    """What ROS wrote reads as a JointState, with velocities that are not known."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    time = types["builtin_interfaces/msg/Time"](7, 5)
    header = types["std_msgs/msg/Header"](time, "base")
    import numpy as np

    made = types[JOINT_STATE.name](
        header, ["a"], np.array([1.0]), np.array([math.nan]), np.array([])
    )
    data = bytes(store.serialize_cdr(made, JOINT_STATE.name))
    text, _ = store.generate_msgdef(JOINT_STATE.name, ros_version=2)
    codec = MessageCodec.of_definition(
        Definition(JOINT_STATE.name, text), counterpart_of_ros(JOINT_STATE.name, "", "joint_states")
    )
    values = codec.decode(data)
    assert math.isnan(values.pop("velocity")[0])
    assert values == {
        "stamp_ns": 7_000_000_005,
        "frame_id": "base",
        "name": ["a"],
        "position": [1.0],
        "effort": [],
    }


@pytest.mark.parametrize(
    "values",
    [
        {"stamp_ns": 2**62, "name": [], "position": [], "velocity": [], "effort": []},
        {"stamp_ns": 0.5, "name": [], "position": [], "velocity": [], "effort": []},
        {"stamp_ns": 0, "name": [], "position": []},
        {"stamp_ns": 0, "name": ["a"], "position": ["x"], "velocity": [], "effort": []},
        {"stamp_ns": 0, "names": ["a"], "positions": [], "velocities": []},
    ],
)
def test_what_ros_cannot_hold_is_kept_as_it_is(values: dict[str, object]) -> None:
    """A joint state after 2038, or with other fields, is another type, and comes back as it was."""
    codec, data = MessageCodecs().encode("JointState", values)
    assert codec.definition.name != JOINT_STATE.name
    assert codec.decode(data) == values


POSE = messages.PoseStamped(
    7_000_000_005,
    "map",
    messages.Pose3D(messages.Vector3(1.0, 2.0), messages.Quaternion(z=0.6, w=0.8)),
)
ODOM = messages.Odometry(
    7_000_000_005,
    "odom",
    "base_link",
    messages.PoseWithCovariance(messages.Pose3D(messages.Vector3(1.5)), (0.25, *[0.0] * 34, 0.5)),
    messages.TwistWithCovariance(messages.Twist(messages.Vector3(x=0.5))),
)

# As the fields were called before they had ROS's names.
FORMER: list[tuple[Any, dict[str, Any]]] = [
    (
        STATE,
        {
            "stamp_ns": STATE.stamp_ns,
            "names": ["a", "b"],
            "positions": [0.5, -1.0],
            "velocities": [math.inf, 2.0],
            "efforts": [0.0, -0.0],
        },
    ),
    (
        POSE,
        {
            "stamp_ns": 7_000_000_005,
            "frame": "map",
            "position": {"x": 1.0, "y": 2.0, "z": 0.0},
            "quat_xyzw": [0.0, 0.0, 0.6, 0.8],
        },
    ),
    (
        ODOM,
        {
            "stamp_ns": 7_000_000_005,
            "frame": "odom",
            "child_frame": "base_link",
            "position": {"x": 1.5, "y": 0.0, "z": 0.0},
            "quat_xyzw": [0.0, 0.0, 0.0, 1.0],
            "twist": as_map(messages.Twist(messages.Vector3(x=0.5))),
            "pose_covariance": [0.25, *[0.0] * 34, 0.5],
            "twist_covariance": [0.0] * 36,
        },
    ),
]


@pytest.mark.parametrize(("message", "former"), FORMER, ids=lambda it: type(it).__name__)
def test_former_names_of_fields_are_read(message: Any, former: dict[str, Any]) -> None:
    """A message with the names that fields had before is the same message, also recorded."""
    assert from_map(type(message), former) == message
    codec, data = MessageCodecs().encode(type(message).__name__, former)
    assert codec.decode(data) == as_map(message)


@pytest.mark.parametrize(("message", "former"), FORMER, ids=lambda it: type(it).__name__)
def test_fields_of_ros_are_read(message: Any, former: dict[str, Any]) -> None:
    """A message in ROS's own layout, with a header, is the same message, also recorded."""
    counterpart = COUNTERPARTS[type(message).__name__]
    of_ros = counterpart.to_ros(former)
    assert of_ros["header"]["stamp"]["nanosec"] == message.stamp_ns % 1_000_000_000
    assert from_map(type(message), of_ros) == message
    assert counterpart.of_ros(of_ros) == as_map(message)
    codec, data = MessageCodecs().encode(type(message).__name__, of_ros)
    assert codec.definition == counterpart.definition
    assert codec.decode(data) == as_map(message)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"frame": "map", "pose": 5, "position": {"x": 1.0}, "stamp_ns": 1}, ""),
        ({"frame": "map", "quat_xyzw": [0.0], "stamp_ns": 1}, ""),
        ({"frame": "map", "position": 5, "stamp_ns": 1}, "field 'pose.position' must be a map"),
        ({"frame_id": "map", "header": 5}, "field 'header' must have a stamp of sec and nanosec"),
        ({"header": {"stamp": {"sec": 0.5, "nanosec": 1}, "frame_id": ""}}, "field 'header' must"),
    ],
)
def test_mixed_names_are_no_trap(values: dict[str, Any], sentence: str) -> None:
    """Former names beside those of today, and other values in them, are read or refused by name."""
    if not sentence:
        assert from_map(messages.PoseStamped, values).frame_id == "map"
        return
    with pytest.raises(DecodeError, match=sentence):
        from_map(messages.PoseStamped, values)


@pytest.mark.parametrize("message", [POSE, ODOM], ids=lambda message: type(message).__name__)
def test_a_pose_without_its_frame_is_no_pose_in_ros(message: Any) -> None:
    """A required field that is missing is not made up; a recording keeps the message as it is."""
    name, values = type(message).__name__, as_map(message)
    del values["frame_id"]
    with pytest.raises(UnfitError, match="frame_id"):
        COUNTERPARTS[name].to_ros(values)
    codec, data = MessageCodecs().encode(name, values)
    assert codec.decode(data) == values


def test_a_joint_state_of_an_old_publisher_has_no_frame() -> None:
    """The field came later, with a default, so that it may be missing."""
    values = as_map(STATE)
    del values["frame_id"]
    assert COUNTERPARTS["JointState"].to_ros(values)["header"]["frame_id"] == ""


def test_a_header_beside_a_stamp_is_an_unknown_field() -> None:
    """As any other field that a later version adds: it is ignored, and recorded as it is."""
    values = {**as_map(POSE), "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "odom"}}
    assert from_map(messages.PoseStamped, values) == POSE
    assert from_map(messages.PoseStamped, {**values, "header": "of a page"}) == POSE
    codec, data = MessageCodecs().encode("PoseStamped", values)
    assert codec.decode(data) == values


def test_every_type_that_ros_has_fits_its_definition() -> None:
    """A new message of each type that names one of ROS has exactly ROS's fields."""
    for name, counterpart in LIVE_COUNTERPARTS.items():
        values = prototype(getattr(messages, name))
        if name in ("Odometry", "PoseStamped"):
            values["frame_id"] = "map"
        codec = MessageCodec.of_definition(counterpart.definition)
        data = codec.encode(counterpart.to_ros(values))
        assert data is not None, name
        assert codec.decode(data) == counterpart.to_ros(values), name


@pytest.mark.parametrize("message", [POSE, ODOM], ids=lambda message: type(message).__name__)
def test_poses_and_odometry_come_back(message: object) -> None:
    """As types of ROS, with every field."""
    name = type(message).__name__
    codec, data = MessageCodecs().encode(name, as_map(message))
    assert codec.definition == COUNTERPARTS[name].definition
    assert codec.decode(data) == as_map(message)


def test_ros_reads_odometry() -> None:
    """An Odometry is a nav_msgs/msg/Odometry of ROS 2, field by field."""
    _, data = MessageCodecs().encode("Odometry", as_map(ODOM))
    read = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, "nav_msgs/msg/Odometry")
    assert (read.header.frame_id, read.child_frame_id) == ("odom", "base_link")
    assert (read.pose.pose.position.x, read.pose.pose.orientation.w) == (1.5, 1.0)
    assert (read.pose.covariance[0], read.pose.covariance[35]) == (0.25, 0.5)
    assert read.twist.twist.linear.x == 0.5


def test_integers_in_fields_of_floats_leave_a_message_its_type_of_ros() -> None:
    """As programs write them, Vector3(1, 0, 0); one that no float is leaves it as it was."""
    twist = messages.Twist(messages.Vector3(1, 0, 0))
    odom = replace(ODOM, twist=messages.TwistWithCovariance(twist, (0,) * 36))
    codec, data = MessageCodecs().encode("Odometry", as_map(odom))
    assert codec.definition == COUNTERPARTS["Odometry"].definition
    assert codec.decode(data) == as_map(odom)
    state = {**as_map(STATE), "position": [2**60 + 1, math.nan]}
    codec, data = MessageCodecs().encode("JointState", state)
    assert codec.definition != JOINT_STATE
    assert codec.decode(data)["position"][0] == 2**60 + 1


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: messages.Pose3D(orientation=messages.Quaternion(w=0.0)), "must be a unit quater"),
        (lambda: messages.PoseWithCovariance(covariance=(0.0,)), "must be 36 numbers, not 1"),
        (lambda: replace(ODOM, stamp_ns=-1), "must be nanoseconds"),
    ],
)
def test_odometry_says_what_is_wrong(make: Callable[[], object], said: str) -> None:
    """A value that cannot be is named."""
    with pytest.raises(ValueError, match=said):
        make()


@given(texts, texts, texts)
def test_a_description_comes_back(urdf: str, prefix: str, source: str) -> None:
    """A description is a std_msgs/msg/String, and nothing of it is lost."""
    values = {"urdf": urdf, "prefix": prefix, "source": source}
    codec, data = MessageCodecs().encode("RobotDescription", values)
    assert codec.definition == STRING
    assert codec.decode(data) == values


@pytest.mark.parametrize("inside", ["\n<!-- tfbus: x -->", '\n<!-- tfbus: ["a", "b"] -->', "--"])
def test_a_description_that_looks_like_ours_comes_back(inside: str) -> None:
    """What stands behind a description cannot be taken for a part of it."""
    values = {"urdf": f"<robot/>{inside}", "prefix": "", "source": inside}
    codec, data = MessageCodecs().encode("RobotDescription", values)
    assert codec.decode(data) == values


def test_a_description_stays_xml() -> None:
    """The text that others read parses, and says the same robot."""
    from xml.etree import ElementTree

    values = {"urdf": "<robot name='r'/>", "prefix": "--", "source": "<-->"}
    text = COUNTERPARTS["RobotDescription"].to_ros(values)["data"]
    assert ElementTree.fromstring(text).attrib == {"name": "r"}


def test_a_text_of_ros_is_a_description_on_its_topic_only() -> None:
    """A std_msgs/msg/String is a description on robot_description, and a plain text elsewhere."""
    found = counterpart_of_ros(STRING.name, STRING.name, "robot7/robot_description")
    assert found is COUNTERPARTS["RobotDescription"]
    assert counterpart_of_ros(STRING.name, STRING.name, "chatter") is None


def test_other_fields_under_the_name_are_refused() -> None:
    """A type that only has the name of ROS's is named as such."""
    definition = Definition(JOINT_STATE.name, "float64 x\n")
    codec = MessageCodec.of_definition(definition, COUNTERPARTS["JointState"])
    data = MessageCodec.of_definition(definition).encode({"x": 1.0})
    assert data is not None
    with pytest.raises(DecodeError, match="other fields than"):
        codec.decode(data)


@pytest.mark.parametrize(
    "values", [{"data": "x"}, {"data": None}, {"data": 5}, {"urdf": 1, "prefix": "", "source": ""}]
)
def test_a_type_of_that_name_with_other_fields_comes_back(
    tmp_path: Path, values: dict[str, object]
) -> None:
    """Also where its fields are those of ROS's type: it is a type of its own."""
    pytest.importorskip("mcap")
    from tfbus.recording.items import TopicItem
    from tfbus.recording.reader import RecordingReader
    from tfbus.recording.writer import RecordingWriter

    item = TopicItem(1, "robot_description", "RobotDescription", values)
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        writer.write(item)
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert list(reader.items()) == [item]
        assert reader.damage == ()


def test_a_recording_has_them_for_ros(tmp_path: Path) -> None:
    """In a file they are types of ROS, the description transient local; read, they are ours."""
    pytest.importorskip("mcap")
    from rosbags.highlevel import AnyReader

    from tfbus.recording.items import TopicItem
    from tfbus.recording.reader import RecordingReader
    from tfbus.recording.writer import RecordingWriter

    described = {"urdf": "<robot/>", "prefix": "a_", "source": "r.urdf"}
    items = [
        TopicItem(1, "robot_description", "RobotDescription", described, retained=True),
        TopicItem(2, "joint_states", "JointState", as_map(STATE)),
    ]
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        for item in items:
            writer.write(item)
    with AnyReader([path]) as reader:
        types = {each.topic: each.msgtype for each in reader.connections}
    assert types == {"/robot_description": STRING.name, "/joint_states": JOINT_STATE.name}
    with RecordingReader(path) as ours:
        assert list(ours.items()) == items
        assert {topic.name: topic.is_retained for topic in ours.topics} == {
            "joint_states": False,
            "robot_description": True,
        }
        assert ours.state_at(2).items(9)[0].values == described
