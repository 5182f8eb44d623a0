"""Types of tfbus.messages that are on the bus as in ROS: each works wherever messages go.

To add one, write its class in tfbus/messages.py, and a message of it in MESSAGES here.
"""

import json
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.buses import eventually, send_until
from tests.simulated_bus import Bus
from tfbus import Recording, messages
from tfbus.bridge.common import BridgeOptions, RosFrameNames
from tfbus.bridge.topic_table import TopicTable
from tfbus.bridge.topics import Translation
from tfbus.compat.message_classes import message_class
from tfbus.recording.items import TopicItem
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.counterparts import AS_IN_ROS
from tfbus.ros.schema import MessageCodec
from tfbus.wire.codec import as_map, decode_message, encode_message, type_name

STAMP_NS = 7_000_000_005

# One of each type, with a value in each of its fields.
MESSAGES: tuple[Any, ...] = (
    messages.Path(
        STAMP_NS,
        "map",
        (
            messages.PoseStamped(STAMP_NS + 1, "map"),
            messages.PoseStamped(
                STAMP_NS + 2, "odom", messages.Pose3D(messages.Vector3(1.0, 2.0, 3.0))
            ),
        ),
    ),
    messages.PoseWithCovarianceStamped(
        STAMP_NS,
        "map",
        messages.PoseWithCovariance(
            messages.Pose3D(messages.Vector3(1.5)), (0.25, *[0.0] * 34, 0.5)
        ),
    ),
    messages.Imu(
        STAMP_NS,
        "imu",
        messages.Quaternion(z=0.6, w=0.8),
        (0.25, *[0.0] * 8),
        messages.Vector3(0.5),
        (0.5, *[0.0] * 8),
        messages.Vector3(z=9.81),
        (-1.0, *[0.0] * 8),
    ),
)

every_type = pytest.mark.parametrize("message", MESSAGES, ids=lambda each: type(each).__name__)


def test_each_type_has_a_message_here() -> None:
    """Each type that names its type in ROS as its own on the bus, and each fits its definition."""
    kinds = [each for each in vars(messages).values() if hasattr(each, "__msgtype__")]
    assert {*map(type, MESSAGES)} == {each for each in kinds if is_dataclass(each)}


@every_type
def test_ros_reads_it(message: Any) -> None:
    """Its bytes are those that another implementation of ROS's encoding writes."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    data = MessageCodec.of_type(type(message)).encode(as_map(message))
    assert data is not None
    name = type_name(type(message))
    read = store.deserialize_cdr(data, name)
    assert read.header.stamp.nanosec == message.stamp_ns % 1_000_000_000
    assert bytes(store.serialize_cdr(read, name)) == data


@every_type
def test_programs_of_ros_have_it_too(message: Any, bus: Bus) -> None:
    """What one class sends, the other receives: that of tfbus.messages and that of tfbus.compat."""
    compat, name = message_class(type_name(type(message))), type(message).__name__
    node, other = bus.node("own"), bus.node("ported")
    got: list[Any] = []
    other.create_subscription(compat, name, got.append)
    node.create_subscription(type(message), f"{name}/back", got.append)
    there = node.create_publisher(type(message), name)
    send_until(lambda: there.publish(message), lambda: bool(got))
    ported = got[0]
    assert ported.header.frame_id == message.frame_id
    back = other.create_publisher(compat, f"{name}/back")
    send_until(lambda: back.publish(ported), lambda: message in got)


@every_type
def test_the_command_line_has_it(message: Any, bus: Bus) -> None:
    """`topic pub` sends it, with our fields or ROS's, by its short name; `topic echo` shows it."""
    node, got = bus.node("reader"), []
    node.create_subscription(type(message), "there", got.append)
    ours = json.dumps({"stamp_ns": message.stamp_ns, "frame_id": message.frame_id})
    of_ros = json.dumps(as_map(message))
    for values in (ours, of_ros):
        bus.run("topic", "pub", "--once", "there", type(message).__name__, values)
    eventually(lambda: len(got) == 2)
    assert (got[0].stamp_ns, got[0].frame_id) == (message.stamp_ns, message.frame_id)
    assert got[1] == message
    sender = node.create_publisher(type(message), "here")
    echo = bus.start("topic", "echo", "here", type(message).__name__, "--json")
    send_until(lambda: sender.publish(message), lambda: bool(echo.out))
    assert json.loads(echo.out[0]) == as_map(message)


@every_type
def test_recordings_have_it(message: Any, tmp_path: Path) -> None:
    """A recording has ROS's type, and gives the message back."""
    name = type_name(type(message))
    codec = MessageCodec.of_type(type(message))
    data = codec.encode(as_map(message))
    assert data is not None
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.write(TopicItem(1, "there", name, as_map(message), (codec.definition, data)))
    with Recording(path) as recording:
        assert [topic.type_name for topic in recording.topics] == [name]
        assert [*recording.messages("there", type(message))] == [(1, message)]


@every_type
def test_bridges_pass_it_on(message: Any) -> None:
    """A topic of this type crosses by itself, and frames have the prefix on the bus only."""
    name = type_name(type(message))
    line = TopicTable().line_of("there", name)
    assert line is not None and line.counterpart is AS_IN_ROS[name]
    _, asked = next(iter(TopicTable.of_file(None, [f"a={type(message).__name__}"]).names.items()))
    assert asked.ros_type == name
    translation = Translation(line, RosFrameNames(BridgeOptions(frame_prefix="r1/")), lambda: 0)
    on_bus = translation.of_ros(translation.to_ros(encode_message(message)))
    read = decode_message(type(message), on_bus)
    assert (read.stamp_ns, read.frame_id) == (message.stamp_ns, f"r1/{message.frame_id}")
    assert f'"{message.frame_id}"' not in json.dumps(as_map(read))
