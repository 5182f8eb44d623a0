"""Writes a recording as docs/reference/recording.md describes it, without tfbus.

    python examples/wire/write_recording.py mine.mcap

It needs the library mcap. `tfbus bag info mine.mcap` then lists one stream, `robot`, at 50 Hz.
"""

import json
import struct
import sys
from pathlib import Path

from mcap.writer import Writer

START_NS = 1_700_000_000_000_000_000

DEFINITION = """\
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def text(data: bytes, word: str) -> bytes:
    data += bytes(-len(data) % 4)  # CDR aligns from behind its four bytes of header
    return data + struct.pack("<I", len(word.encode()) + 1) + word.encode() + b"\0"


def tf_message(stamp_ns: int, parent: str, child: str, pose: tuple[float, ...]) -> bytes:
    data = struct.pack("<IiI", 1, *divmod(stamp_ns, 10**9))
    data = text(text(data, parent), child)
    data += bytes(-len(data) % 8) + struct.pack("<7d", *pose)
    return b"\0\1\0\0" + data


with Path(sys.argv[1]).open("wb") as file:
    writer = Writer(file, chunk_size=128 * 1024)
    writer.start("ros2", "mine")
    schema = writer.register_schema("tf2_msgs/msg/TFMessage", "ros2msg", DEFINITION.encode())
    about = {"tfbus.stream": "robot", "tfbus.node": "/robot", "tfbus.epoch": str(START_NS)}
    channel = writer.register_channel("/tf", "cdr", schema, about)
    frames = {"epoch": START_NS, "frames": [["map", "base_link", False]]}
    writer.add_metadata(
        "tfbus.event",
        {
            "log_time": str(START_NS),
            "kind": "stream",
            "name": "robot",
            "facts": json.dumps(frames),
        },
    )
    for i in range(101):
        stamp_ns = START_NS + i * 20_000_000
        data = tf_message(stamp_ns, "map", "base_link", (i / 50, 0, 0, 0, 0, 0, 1))
        writer.add_message(channel, stamp_ns + 1_000_000, data, stamp_ns, sequence=i)
    writer.finish()
