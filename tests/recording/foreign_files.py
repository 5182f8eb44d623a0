"""Files of ROS and Foxglove as their own libraries write them. Not a test itself."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests import needs

TF_MESSAGE = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True)
class RawTransform:
    """A transform as ROS takes any: names and numbers are not checked."""

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    pose: Sequence[float]


@dataclass(frozen=True)
class Sent:
    """A message of another program: transforms on a topic."""

    log_ns: int
    transforms: Sequence[RawTransform]
    topic: str = "/tf"
    publisher: str = ""


@cache
def store_of(ros: int) -> Any:
    """The types of ROS 1 or 2, as rosbags has them; made once, as that takes a while."""
    typesys = needs.module("rosbags.typesys")
    stores = typesys.Stores
    store = typesys.get_typestore(stores.ROS1_NOETIC if ros == 1 else stores.ROS2_HUMBLE)
    if TF_MESSAGE not in store.fielddefs:
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(typesys.get_types_from_msg(text, TF_MESSAGE))
    return store


def tf_message(store: Any, transforms: Iterable[RawTransform]) -> Any:
    """A TFMessage of these types."""
    types = store.types
    has_seq = any(name == "seq" for name, _ in store.fielddefs["std_msgs/msg/Header"][1])
    made = []
    for ts in transforms:
        stamp = types["builtin_interfaces/msg/Time"](*divmod(ts.stamp_ns, 10**9))
        header = types["std_msgs/msg/Header"](*[0] * has_seq, stamp, ts.frame_id)
        pose = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*ts.pose[:3]),
            types["geometry_msgs/msg/Quaternion"](*ts.pose[3:]),
        )
        made.append(types["geometry_msgs/msg/TransformStamped"](header, ts.child_frame_id, pose))
    return types[TF_MESSAGE](made)


def write_bag(path: Path, sent: Iterable[Sent], *, compression: str = "") -> Path:
    """A .bag of rosbag1; its chunks compressed, as by BZ2 or LZ4."""
    store = store_of(1)
    from rosbags.rosbag1 import Writer

    connections: dict[tuple[str, str], Any] = {}
    bag = Writer(path)
    if compression:
        bag.set_compression(Writer.CompressionFormat[compression])
    with bag:
        for each in sent:
            key = each.topic, each.publisher
            if key not in connections:
                connections[key] = bag.add_connection(
                    each.topic, TF_MESSAGE, typestore=store, callerid=each.publisher or None
                )
            message = tf_message(store, each.transforms)
            data = store.serialize_ros1(message, TF_MESSAGE)
            bag.write(connections[key], each.log_ns, bytes(data))
    return path


def write_rosbag2(path: Path, sent: Iterable[Sent], *, storage: str, packed: str = "") -> Path:
    """A folder of rosbag2, stored as SQLITE3 or MCAP; each FILE or MESSAGE of it compressed."""
    store = store_of(2)
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    connections: dict[str, Any] = {}
    bag = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if packed:
        bag.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with bag:
        for each in sent:
            if each.topic not in connections:
                connections[each.topic] = bag.add_connection(
                    each.topic, TF_MESSAGE, typestore=store
                )
            message = tf_message(store, each.transforms)
            data = store.serialize_cdr(message, TF_MESSAGE)
            bag.write(connections[each.topic], each.log_ns, bytes(data))
    return path


def write_bare_mcap(path: Path, sent: Iterable[Sent], *, ros: int) -> Path:
    """An MCAP file with messages of ROS 1 or 2, without anything of rosbag2."""
    store = store_of(ros)
    text, _ = store.generate_msgdef(TF_MESSAGE, ros_version=ros)
    serialize = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    return _write_mcap(
        path,
        sent,
        schema=("tf2_msgs/TFMessage" if ros == 1 else TF_MESSAGE, f"ros{ros}msg", text.encode()),
        encoding="ros1" if ros == 1 else "cdr",
        encode=lambda rows: bytes(serialize(tf_message(store, rows), TF_MESSAGE)),
    )


def write_foxglove_json(path: Path, sent: Iterable[Sent]) -> Path:
    """An MCAP file with Foxglove's FrameTransforms in JSON."""

    def encode(rows: Iterable[RawTransform]) -> bytes:
        return json.dumps(
            {
                "transforms": [
                    {
                        "timestamp": {"sec": ts.stamp_ns // 10**9, "nsec": ts.stamp_ns % 10**9},
                        "parent_frame_id": ts.frame_id,
                        "child_frame_id": ts.child_frame_id,
                        "translation": dict(zip("xyz", ts.pose[:3], strict=True)),
                        "rotation": dict(zip("xyzw", ts.pose[3:], strict=True)),
                    }
                    for ts in rows
                ]
            }
        ).encode()

    schema = ("foxglove.FrameTransforms", "jsonschema", b"{}")
    return _write_mcap(path, sent, schema=schema, encoding="json", encode=encode)


def _write_mcap(
    path: Path,
    sent: Iterable[Sent],
    *,
    schema: tuple[str, str, bytes],
    encoding: str,
    encode: Callable[[Iterable[RawTransform]], bytes],
) -> Path:
    writer_module = needs.module("mcap.writer")
    channels: dict[str, int] = {}
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start("", "somebody else")
        number = writer.register_schema(*schema)
        for each in sent:
            if each.topic not in channels:
                metadata = {"callerid": each.publisher} if each.publisher else {}
                channels[each.topic] = writer.register_channel(
                    each.topic, encoding, number, metadata
                )
            data = encode(each.transforms)
            writer.add_message(channels[each.topic], each.log_ns, data, each.log_ns)
        writer.finish()
    return path
