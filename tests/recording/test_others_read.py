"""Our files read by programs that others wrote: every transform and every field is equal."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from tests import needs
from tests.builders import S, in_recording
from tfbus import Transform, TransformStamped
from tfbus.messages import LaserScan, PointCloud
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.wire.codec import decode_map, encode_message, from_map, type_name

T0 = 1_700_000_000 * S


def items() -> list[Item]:
    """Transforms of two streams, one static, and topics whose types tfbus knows, or not."""
    rng = np.random.default_rng(1)
    found: list[Item] = [
        EventItem(T0, "stream", "sim", {"epoch": 1, "frames": []}),
        in_recording(T0, [pose(rng, "base", "läser", T0)], static=True, seq=0),
    ]
    for i in range(200):
        now = T0 + i * S // 10 + i
        stream = "robot7/arm" if i % 3 == 0 else "sim"
        sent = [pose(rng, "map", f"link{n}", now - n) for n in range(i % 5 + 1)]
        found.append(in_recording(now, sent, stream=stream, seq=i))
        if i % 10 == 0:
            values = {"stamp_ns": now, "x": float(rng.normal()), "y": 0.1, "theta": -0.0}
            values |= {"linear_velocity": 1e300, "angular_velocity": 5e-324}
            found.append(TopicItem(now, "turtle1/pose", "Pose", values))
            found.append(TopicItem(now, "own", "Own", {"name": "ä", "sizes": [i, 2], "ok": True}))
    return found


def pose(rng: np.random.Generator, parent: str, child: str, stamp_ns: int) -> TransformStamped:
    """Any pose."""
    quat = rng.normal(size=4)
    turned = tuple((quat / np.linalg.norm(quat)).tolist())
    return TransformStamped(stamp_ns, parent, child, Transform(rng.normal(size=3).tolist(), turned))


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of these items."""
    path = tmp_path_factory.mktemp("bag") / "a.mcap"
    with RecordingWriter(path, compression=request.param) as writer:
        for number, item in enumerate(items()):
            writer.write(item)
            if number % 30 == 0:
                writer.flush()
    return path


Row = tuple[int, str, str, tuple[float, ...]]


def rows_of(transforms: Any) -> list[Row]:
    """The rows of a TFMessage as a library reads it."""
    rows = []
    for each in transforms:
        stamp = each.header.stamp
        xyz, quat = each.transform.translation, each.transform.rotation
        numbers = (xyz.x, xyz.y, xyz.z, quat.x, quat.y, quat.z, quat.w)
        rows.append(
            (stamp.sec * S + stamp.nanosec, each.header.frame_id, each.child_frame_id, numbers)
        )
    return rows


def sent_rows(item: TransformItem) -> list[Row]:
    """The same of an item."""
    return [
        (each.stamp_ns, each.frame_id, each.child_frame_id, each.transform.as_pose())
        for each in item.rows
    ]


def test_rosbags_reads_all(bag: Path) -> None:
    """Every transform, bit by bit, and every field of the topics."""
    transforms: list[tuple[int, list[Row]]] = []
    topics: list[tuple[str, Any]] = []
    with AnyReader([bag]) as reader:
        for connection, log_ns, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/tf":
                transforms.append((log_ns, rows_of(message.transforms)))
            elif connection.topic == "/turtle1/pose":
                topics.append(("Pose", (message.stamp_ns, message.x, message.angular_velocity)))
            elif connection.topic == "/own":
                topics.append(("Own", (message.name, list(message.sizes), message.ok)))
    expected = [item for item in items() if isinstance(item, TransformItem) and not item.static]
    assert transforms == [(item.log_ns, sent_rows(item)) for item in expected]
    keys = {"Pose": ("stamp_ns", "x", "angular_velocity"), "Own": ("name", "sizes", "ok")}
    assert topics == [
        (item.type_name, tuple(item.values[key] for key in keys[item.type_name]))
        for item in items()
        if isinstance(item, TopicItem)
    ]


def test_rosbags_sees_latched_statics(bag: Path) -> None:
    """`/tf_static` has the durability that a listener of ROS needs: transient local."""
    with AnyReader([bag]) as reader:
        [static] = [each for each in reader.connections if each.topic == "/tf_static"]
        dynamic = [each for each in reader.connections if each.topic == "/tf"]
        durabilities = [each.ext.offered_qos_profiles[0].durability for each in (static, *dynamic)]
        assert [durability.value for durability in durabilities] == [1, 2, 2]
        sets = [
            rows_of(reader.deserialize(data, static.msgtype).transforms)
            for _, _, data in reader.messages([static])
        ]
    item = items()[1]
    assert isinstance(item, TransformItem)
    assert len(sets) >= 4 and all(each == sent_rows(item) for each in sets)


def test_the_reader_of_mcap_finds_all(bag: Path) -> None:
    """Profile, streams, sequence numbers and times, and the events as metadata."""
    with bag.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_messages(topics=["/tf"]))
        events = [each for each in reader.iter_metadata() if each.name == "tfbus.event"]
    sent = [item for item in items() if isinstance(item, TransformItem) and not item.static]
    assert [
        (channel.metadata["tfbus.stream"], message.sequence, message.log_time, message.publish_time)
        for _, channel, message in messages
    ] == [
        (item.stream.name, item.seq, item.log_ns, max(item.rows.stamps_as_ints())) for item in sent
    ]
    assert json.loads(events[0].metadata["facts"]) == {"epoch": 1, "frames": []}


@pytest.mark.real
def test_pymcap_cli_follows_the_tree(bag: Path) -> None:
    """A program of others looks up a transform across our channels."""
    program = os.environ.get("PYMCAP_CLI") or shutil.which("pymcap-cli")
    if program is None:
        needs.skip("pymcap-cli", "pip install pymcap-cli, in an environment of its own")
    done = subprocess.run(
        [program, "info", str(bag)], capture_output=True, text=True, check=True, timeout=120
    )
    assert "/tf_static" in done.stdout and "/turtle1/pose" in done.stdout


def test_sensors_are_recorded_as_types_of_ros(tmp_path: Path) -> None:
    """rosbags reads a cloud and a scan by ROS's own names, with equal arrays; so do we. Floats
    of 32 bits that a program gave as 0.1 are rounded as ROS has them.
    """
    ranges = np.arange(200, dtype=np.float32)
    cloud = PointCloud.from_xyz(S, "lidar", ranges[:198].reshape(66, 3))
    scan = LaserScan(S, "laser", -1.0, 1.0, 0.01, 0.0, 0.1, 0.1, 30.0, ranges)
    path = tmp_path / "sensors.mcap"
    with RecordingWriter(path) as writer:
        for topic, message in (("points", cloud), ("scan", scan)):
            values = decode_map(encode_message(message))
            writer.write(TopicItem(S, topic, type_name(type(message)), values))
    with AnyReader([path]) as reader:
        read: dict[str, Any] = {
            connection.msgtype: reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
        }
    assert np.array_equal(read["sensor_msgs/msg/PointCloud2"].data, cloud.data)
    assert np.array_equal(read["sensor_msgs/msg/LaserScan"].ranges, ranges)
    assert read["sensor_msgs/msg/LaserScan"].header.frame_id == "laser"
    with RecordingReader(path) as ours:
        items = {each.topic: each for each in ours.items() if isinstance(each, TopicItem)}
    assert np.array_equal(from_map(PointCloud, items["points"].values).xyz(), cloud.xyz())
    back = from_map(LaserScan, items["scan"].values)
    assert np.array_equal(back.ranges, ranges)
    assert back.angle_increment == np.float32(0.01)


def test_the_publish_time_of_a_message_is_its_stamp(tmp_path: Path) -> None:
    """That of a header of ROS's too; without one, or with 0, it is the log time."""
    path = tmp_path / "stamps.mcap"
    header = {"stamp": {"sec": 3, "nanosec": 5}, "frame_id": "lidar"}
    with RecordingWriter(path) as writer:
        for topic, values in {
            "ours": {"stamp_ns": 2 * S, "x": 1.0},
            "header": {"header": header, "x": 1.0},
            "zero": {"stamp_ns": 0, "x": 1.0},
            "none": {"x": 1.0},
        }.items():
            writer.write(TopicItem(9 * S, topic, "", values))
    with path.open("rb") as file:
        found = {
            channel.topic: message.publish_time
            for _, channel, message in make_reader(file).iter_messages()
        }
    assert found == {"/ours": 2 * S, "/header": 3 * S + 5, "/zero": 9 * S, "/none": 9 * S}
