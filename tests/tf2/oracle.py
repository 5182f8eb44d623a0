"""The real tf2 as a process: Debian's C++ core, under Debian's own Python. Not a test itself.

    /usr/bin/python3 tests/tf2/oracle.py < cases > answers

One line in is one case in JSON: {"cache_time_s": 10.0, "epoch_ns": 0, "steps": [...]}, put to a
buffer of its own. One line out is the answers, one for each step:

    ["set", parent, child, stamp_ns, [x, y, z, qx, qy, qz, qw], static]
        -> ["accepted"], or ["rejected", tag, text] with the tag of tf2's warning
    ["lookup", target, source, stamp_ns or null]                            null is the latest
    ["full", target, target_stamp_ns, source, source_stamp_ns, fixed]
        -> ["transform", stamp_ns, [x, y, z, qx, qy, qz, qw]] or [exception, text]
    ["can", target, source, stamp_ns or null]          -> [true] or [false]
    ["latest", target, source]
        -> ["stamp", stamp_ns] or [exception, text]; all static is stamp 0, as tf2 has it
    ["frames"]                                         -> ["frames", [name, ...]]
    ["clear"]                                          -> ["cleared"]

tf2_py takes and gives times as seconds in a double, which is exact to the nanosecond for some forty
days only. So tf2 counts from `epoch_ns`, a whole second before all stamps of the case.

Nothing is imported that Debian's python3-tf2 does not bring; nothing of tfbus.
"""

import json
import os
import re
import sys
import tempfile
from contextlib import contextmanager

import rospy
import tf2_py
from geometry_msgs.msg import TransformStamped

NS_PER_S = 1_000_000_000


def main():
    """Answer line by line, until the input ends."""
    with stderr_in_a_file():
        for line in sys.stdin:
            case = json.loads(line)
            oracle = Oracle(case["cache_time_s"], case["epoch_ns"])
            print(json.dumps([oracle.answer(*step) for step in case["steps"]]), flush=True)


@contextmanager
def stderr_in_a_file():
    """tf2 says there why it rejects a transform, and nowhere else."""
    real = os.dup(sys.stderr.fileno())
    with tempfile.TemporaryFile() as warnings:
        os.dup2(warnings.fileno(), sys.stderr.fileno())
        try:
            yield
        finally:
            os.dup2(real, sys.stderr.fileno())


class Oracle:
    """One buffer of tf2, whose time zero is `epoch_ns`."""

    def __init__(self, cache_time_s, epoch_ns):
        self._core = tf2_py.BufferCore(rospy.Duration.from_sec(cache_time_s))
        self._epoch_ns = epoch_ns

    def answer(self, kind, *arguments):
        """What tf2 says to one step."""
        try:
            return getattr(self, kind)(*arguments)
        except tf2_py.TransformException as error:
            return [_kind(error), str(error)]

    def set(self, parent, child, stamp_ns, pose, static):
        """Store a transform; tf2 says what it thinks of it by a warning only."""
        message = TransformStamped()
        message.header.frame_id = parent
        message.header.stamp = self._time(stamp_ns)
        message.child_frame_id = child
        xyz, quaternion = message.transform.translation, message.transform.rotation
        xyz.x, xyz.y, xyz.z = pose[:3]
        quaternion.x, quaternion.y, quaternion.z, quaternion.w = pose[3:]
        start = _warnings_end()
        (self._core.set_transform_static if static else self._core.set_transform)(message, "oracle")
        length = _warnings_end() - start
        if not length:
            return ["accepted"]
        text = os.pread(sys.stderr.fileno(), length, start).decode(errors="replace")
        tag = re.search(r"TF_\w+", text)
        return ["rejected", tag.group() if tag else "", text]

    def lookup(self, target, source, stamp_ns):
        """The source seen from the target."""
        return self._transform(
            self._core.lookup_transform_core(target, source, self._time(stamp_ns))
        )

    def full(self, target, target_stamp_ns, source, source_stamp_ns, fixed):
        """The same through a fixed frame, at two times."""
        return self._transform(
            self._core.lookup_transform_full_core(
                target, self._time(target_stamp_ns), source, self._time(source_stamp_ns), fixed
            )
        )

    def can(self, target, source, stamp_ns):
        """Whether it can be looked up."""
        return [bool(self._core.can_transform_core(target, source, self._time(stamp_ns))[0])]

    def latest(self, target, source):
        """The latest common time."""
        return ["stamp", self._stamp_ns(self._core.get_latest_common_time(target, source))]

    def frames(self):
        """All names."""
        return ["frames", sorted(self._core._getFrameStrings())]

    def clear(self):
        """Forget what is dynamic."""
        self._core.clear()
        return ["cleared"]

    def _time(self, stamp_ns):
        # Stamp 0 is no time in tf2: the latest in a question, and for a static transform any.
        if not stamp_ns:
            return rospy.Time()
        return rospy.Time(*divmod(stamp_ns - self._epoch_ns, NS_PER_S))

    def _stamp_ns(self, time):
        return time.to_nsec() and time.to_nsec() + self._epoch_ns

    def _transform(self, message):
        xyz, quaternion = message.transform.translation, message.transform.rotation
        return [
            "transform",
            self._stamp_ns(message.header.stamp),
            [xyz.x, xyz.y, xyz.z, quaternion.x, quaternion.y, quaternion.z, quaternion.w],
        ]


def _warnings_end():
    return os.lseek(sys.stderr.fileno(), 0, os.SEEK_END)


def _kind(error):
    # The binding's get_latest_common_time raises the base class where frames are not connected.
    if type(error) is tf2_py.TransformException and "not part of the same tree" in str(error):
        return "ConnectivityException"
    return type(error).__name__


if __name__ == "__main__":
    main()
