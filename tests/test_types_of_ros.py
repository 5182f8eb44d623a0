"""Types of tfbus.messages that are on the bus as in ROS: each works wherever messages go.

To add one, write its class in tfbus/messages, and a message of it in MESSAGES here.
"""

import json
import re
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.buses import eventually, send_until
from tests.simulated_bus import Bus
from tfbus import Recording, messages
from tfbus.recording.items import TopicItem
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.bridge.common import BridgeOptions, RosFrameNames
from tfbus.ros.bridge.topic_table import TopicTable
from tfbus.ros.bridge.topics import Translation
from tfbus.ros.counterparts import AS_IN_ROS
from tfbus.ros.message_classes import message_class
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
    messages.PointStamped(STAMP_NS, "map", messages.Vector3(1.5, -2.0, 0.25)),
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

MESSAGES += (
    messages.RegionOfInterest(1, 2, 3, 4, True),
    messages.ColorRGBA(1.0, 0.5, 0.25, 1.0),
    messages.MapMetaData(STAMP_NS, 0.25, 3, 2, messages.Pose3D(messages.Vector3(1.0))),
    messages.MeshFile("mesh.stl", np.array([4, 5, 6], np.uint8)),
    messages.NavSatStatus(messages.NavSatStatus.STATUS_FIX, messages.NavSatStatus.SERVICE_GPS),
    messages.PointField("x", 4, messages.PointField.FLOAT64, 2),
)

CLOUD = np.array(
    [(1.5, 2.0, 3.0, 7, 0), (-1.0, 0.0, np.nan, 9, 1)],
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f8"), ("ring", "u2")],
)
TURNED = messages.Pose3D(messages.Vector3(1.0), messages.Quaternion(z=0.6, w=0.8))

MESSAGES += (
    messages.Polygon([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]),
    messages.PolygonStamped(STAMP_NS, "base", messages.Polygon([[0.5, 0.0, 0.0]])),
    messages.PoseArray(STAMP_NS, "map", [[1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]]),
    messages.CameraInfo(
        STAMP_NS,
        "camera",
        480,
        640,
        "plumb_bob",
        [0.5, -0.25, 0.0, 0.0, 0.125],
        (500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0),
        (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        (500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        2,
        2,
        messages.RegionOfInterest(1, 2, 3, 4, True),
    ),
    messages.CompressedImage(STAMP_NS, "camera", "png", np.arange(100, dtype=np.uint8)),
    messages.Image.from_pixels(STAMP_NS, "camera", np.arange(60, dtype=np.uint16).reshape(5, 12)),
    messages.Log(STAMP_NS, messages.Log.WARN, "node", "text", "file.py", "run", 7),
    messages.Marker(
        STAMP_NS,
        "map",
        "ns",
        -3,
        messages.Marker.POINTS,
        messages.Marker.ADD,
        TURNED,
        messages.Vector3(0.5, 0.5, 0.5),
        messages.ColorRGBA(1.0, 0.5, 0.25, 1.0),
        2_500_000_000,
        True,
        [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
        [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.5]],
        "texture",
        messages.CompressedImage(STAMP_NS, "map", "png", [1, 2, 3]),
        [[0.0, 0.5]],
        "text",
        "package://some/mesh.stl",
        messages.MeshFile("mesh.stl", [4, 5, 6]),
        True,
    ),
    messages.MarkerArray((messages.Marker(STAMP_NS, "map"), messages.Marker(STAMP_NS, "odom"))),
    messages.OccupancyGrid.from_cells(
        STAMP_NS, "map", np.array([[-1, 0, 100], [50, 3, 2]], np.int8), 0.25, TURNED
    ),
    messages.LaserScan(
        STAMP_NS,
        "laser",
        -1.5,
        1.5,
        1.0,
        0.125,
        0.25,
        0.5,
        30.0,
        [1.5, np.inf, np.nan, 2.0],
        [1.0, 2.0, 3.0, 4.0],
    ),
    messages.NavSatFix(
        STAMP_NS,
        "gps",
        messages.NavSatStatus(messages.NavSatStatus.STATUS_FIX, messages.NavSatStatus.SERVICE_GPS),
        52.5,
        13.25,
        34.5,
        (1.0, *[0.0] * 7, 4.0),
        messages.NavSatFix.COVARIANCE_TYPE_KNOWN,
    ),
    messages.PointCloud.from_array(STAMP_NS, "lidar", CLOUD),
    messages.Range(STAMP_NS, "sonar", messages.Range.INFRARED, 0.5, 0.25, 4.0, 1.5, 0.5),
)

every_type = pytest.mark.parametrize("message", MESSAGES, ids=lambda each: type(each).__name__)


def as_json(message: Any) -> str:
    """The message as it goes over the bus, its arrays as lists."""
    return json.dumps(as_map(message), default=lambda array: array.tolist())


def assert_frames_are_renamed(message: Any, sent: str, read: str) -> None:
    """All is as it was sent but for the names of frames."""
    frames = re.findall(r'frame_id": "(\w+)"', sent)
    assert bool(frames) == ("frame_id" in sent)
    for frame in {*frames}:
        sent = sent.replace(f'frame_id": "{frame}"', f'frame_id": "r1/{frame}"')
    assert read == sent


def test_each_type_has_a_message_here() -> None:
    """Each type that names its type in ROS as its own on the bus, and each fits its definition."""
    kinds = [each for each in vars(messages).values() if hasattr(each, "__msgtype__")]
    assert {*map(type, MESSAGES)} == {each for each in kinds if is_dataclass(each)}
    assert len({*map(type, MESSAGES)}) == len(MESSAGES)


@every_type
def test_ros_reads_it(message: Any) -> None:
    """Its bytes are those that another implementation of ROS's encoding writes."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    data = MessageCodec.of_type(type(message)).encode(as_map(message))
    assert data is not None
    name = type_name(type(message))
    read = store.deserialize_cdr(data, name)
    if hasattr(read, "header"):
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
    if hasattr(ported, "header"):
        assert ported.header.frame_id == message.frame_id
    back = other.create_publisher(compat, f"{name}/back")
    send_until(lambda: back.publish(ported), lambda: message in got)


@every_type
def test_the_command_line_has_it(message: Any, bus: Bus) -> None:
    """`topic pub` sends it, with our fields or ROS's, by its short name; `topic echo` shows it."""
    node, got = bus.node("reader"), []
    node.create_subscription(type(message), "there", got.append)
    beginning = {
        name: getattr(message, name) for name in ("stamp_ns", "frame_id") if hasattr(message, name)
    }
    ours = json.dumps(beginning)
    of_ros = as_json(message).replace("NaN", ".nan").replace("Infinity", ".inf")
    for values in (ours, of_ros):
        bus.run("topic", "pub", "--once", "there", type(message).__name__, values)
    eventually(lambda: len(got) == 2)
    assert {name: getattr(got[0], name) for name in beginning} == beginning
    assert got[1] == message
    sender = node.create_publisher(type(message), "here")
    echo = bus.start("topic", "echo", "here", type(message).__name__, "--json")
    send_until(lambda: sender.publish(message), lambda: bool(echo.out))
    # JSON has no other word for what is no number.
    shown = as_json(message).replace("NaN", "null").replace("Infinity", "null")
    assert json.dumps(json.loads(echo.out[0])) == shown


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
    assert_frames_are_renamed(message, as_json(message), as_json(read))
