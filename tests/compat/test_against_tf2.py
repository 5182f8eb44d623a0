"""The ported buffer against the real tf2: the same names, calls and exceptions, the same answers.

As tests/tf2/test_against_tf2.py does with tfbus's own buffer; deliberate differences
are left out there, and so here.
"""

from random import Random

import pytest

from tests.tf2.cases import random_case
from tests.tf2.steps import (
    Answer,
    CanTransform,
    Clear,
    Frames,
    Insert,
    LatestCommonTime,
    Lookup,
    LookupFull,
    Step,
)
from tests.tf2.versus import CACHE_TIME_S, TOLERANCE, Mismatch, Oracle, as_tf2_takes, is_meant
from tfbus.base.errors import LoopException
from tfbus.compat import tf2_ros
from tfbus.compat.geometry_msgs.msg import TransformStamped
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.time import Time

pytestmark = pytest.mark.real

LOOKUPS = 2_000
LOOKUPS_PER_CASE = 200


def time(stamp_ns: int | None) -> Time:
    """ROS's form of a stamp, where 0 is the latest."""
    return Time(nanoseconds=stamp_ns or 0)


def message(insert: Insert) -> TransformStamped:
    """A step's transform in ROS's layout."""
    made = TransformStamped(child_frame_id=insert.child)
    made.header.frame_id = insert.parent
    made.header.stamp = time(insert.stamp_ns).to_msg()
    p, q = made.transform.translation, made.transform.rotation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = insert.pose
    return made


def answer(found: TransformStamped) -> Answer:
    """A transform that was found."""
    p, q = found.transform.translation, found.transform.rotation
    stamp_ns = Time.from_msg(found.header.stamp).nanoseconds
    return Answer("transform", stamp_ns, (p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def said(buffer: tf2_ros.Buffer, step: Step) -> Answer:
    """What the ported buffer answers; of tf2's exceptions the class that a program catches."""
    try:
        return put(buffer, step)
    except LoopException:
        return Answer("LoopException")
    except tf2_ros.TransformException as error:
        for name in ("Lookup", "Connectivity", "Extrapolation", "InvalidArgument"):
            if isinstance(error, getattr(tf2_ros, f"{name}Exception")):
                return Answer(f"{name}Exception", text=str(error))
        raise


def put(buffer: tf2_ros.Buffer, step: Step) -> Answer:
    """Put one step to it, by the methods of tf2."""
    match step:
        case Insert():
            refused = buffer.tfbus_buffer.frame(step.child).refused if known(buffer, step) else 0
            store = buffer.set_transform_static if step.static else buffer.set_transform
            store(message(step), "test")
            is_old = known(buffer, step) and buffer.tfbus_buffer.frame(step.child).refused > refused
            return Answer("rejected" if is_old else "accepted")
        case Lookup():
            return answer(buffer.lookup_transform(step.target, step.source, time(step.stamp_ns)))
        case LookupFull():
            times = time(step.target_stamp_ns), time(step.source_stamp_ns)
            frames = step.target, times[0], step.source, times[1], step.fixed
            return answer(buffer.lookup_transform_full(*frames))
        case CanTransform():
            can = buffer.can_transform(step.target, step.source, time(step.stamp_ns))
            return Answer("yes" if can else "no")
        case LatestCommonTime():
            latest = buffer.get_latest_common_time(step.target, step.source)
            return Answer("stamp", latest.nanoseconds)
        case Frames():
            return Answer("frames", names=tuple(sorted(buffer._getFrameStrings())))
        case Clear():
            buffer.clear()
            return Answer("cleared")
    raise NotImplementedError(step)


def known(buffer: tf2_ros.Buffer, insert: Insert) -> bool:
    """Whether the buffer has the child of a step."""
    return buffer._frameExists(insert.child)


def test_random_trees_are_answered_as_tf2_answers_them(
    tf2: Oracle, pytestconfig: pytest.Config
) -> None:
    """By the methods of tf2, with the exceptions that a ported program catches."""
    seed = pytestconfig.getoption("seed")
    rng, left = Random(seed), LOOKUPS
    while left > 0:
        steps = random_case(rng, LOOKUPS_PER_CASE)
        left -= sum(not isinstance(step, Insert | Clear | Frames) for step in steps)
        buffer = tf2_ros.Buffer(cache_time=Duration(seconds=CACHE_TIME_S))
        ours = [said(buffer, step) for step in steps]
        for_tf2 = as_tf2_takes(steps, ours)
        theirs = tf2.ask(list(for_tf2.values()))
        for index, their_answer in zip(for_tf2, theirs, strict=True):
            if not ours[index].agrees(their_answer, TOLERANCE):
                before = [step for at, step in for_tf2.items() if at < index]
                mismatch = Mismatch(steps[: index + 1], ours[index], their_answer)
                assert is_meant(tf2, before, mismatch), f"--seed {seed}\n\n{mismatch}"
