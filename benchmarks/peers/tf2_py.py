"""tf2's C++ core through its own Python binding: Debian's python3-tf2, under Debian's Python."""

import sys
from collections.abc import Sequence
from typing import Any

import rospy
import tf2_py
from geometry_msgs.msg import TransformStamped

from benchmarks.data import INSERTS_AT_ONCE, SAMPLES, anywhere, frame, pose, recent, rows, stamp_ns
from benchmarks.worker import Loop


def version() -> str:
    """What runs here."""
    return f"tf2_py of ROS Noetic, Python {sys.version.split()[0]}"


def lookup(edges: int) -> Loop:
    """From end to end of a chain, at recent stamps."""
    return _lookups(edges, recent)


def lookup_anywhere(edges: int) -> Loop:
    """The same at any stamp of the ten seconds."""
    return _lookups(edges, anywhere)


def latest(edges: int) -> Loop:
    """At the latest common time."""
    return _lookups(edges, lambda count: [0] * count)


def insert(edges: int) -> Loop:
    """Transforms one after the other, made before."""
    core = _chain(edges)
    samples = iter(range(SAMPLES, sys.maxsize))

    def items(count: int) -> list[Any]:
        times = (next(samples) for _ in range(count // edges))
        return [_message(*row) for row in rows(edges, times)]

    def run(messages: Sequence[Any]) -> None:
        for message in messages:
            core.set_transform(message, "bench")

    return Loop(items, run, at_once=INSERTS_AT_ONCE)


insert_columns = insert


def memory(samples: int) -> Any:
    """`samples` in total, over 100 edges."""
    return _chain(100, samples // 100)


def _lookups(edges: int, stamps: Any) -> Loop:
    core = _chain(edges)
    target, source = frame(0), frame(edges)

    def run(times: Sequence[Any]) -> None:
        for time in times:
            core.lookup_transform_core(target, source, time)

    return Loop(lambda count: [_time(stamp) for stamp in stamps(count)], run)


def _chain(edges: int, samples: int = SAMPLES) -> Any:
    core = tf2_py.BufferCore(rospy.Duration(max(10, samples // 100)))
    for row in rows(edges, range(samples)):
        core.set_transform(_message(*row), "bench")
    return core


def _message(sample: int, child: int) -> Any:
    message = TransformStamped()
    message.header.stamp = _time(stamp_ns(sample))
    message.header.frame_id, message.child_frame_id = frame(child - 1), frame(child)
    xyz, quaternion = message.transform.translation, message.transform.rotation
    xyz.x, xyz.y, xyz.z, quaternion.x, quaternion.y, quaternion.z, quaternion.w = pose(
        child, sample
    )
    return message


def _time(stamp: int) -> Any:
    return rospy.Time(*divmod(stamp, 1_000_000_000))
