"""The tf2_ros listener under rospy, from Debian's packages: the CPU that it takes for a transform.

Runs under Debian's own Python, so this file and the processes need nothing but its packages.
"""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from benchmarks.bus.intake import SECONDS, Intake, during
from benchmarks.bus.place import Place, Process, free_port, place, say

PYTHON = "/usr/bin/python3"
PACKAGES = "python3-rospy python3-tf2-ros python3-rosmaster"
# What rospy can well bear, in messages a second.
_RATE = 200
_MASTER_WITHIN_S = 30.0


class NotInstalled(Exception):
    """rospy or tf2_ros is not there."""


def measure(rows: int, runs: int) -> Intake:
    """The cost of tf2_ros.TransformListener for messages with `rows` transforms; the run with
    the median CPU. Raises NotInstalled.
    """
    taken = []
    for _ in range(runs):
        with place() as at:
            taken.append(_once(at, rows))
    return sorted(taken, key=lambda intake: intake.cpu_ns)[len(taken) // 2]


def _is_installed() -> bool:
    if not shutil.which("rosmaster") or not os.path.exists(PYTHON):
        return False
    return not subprocess.run(
        [PYTHON, "-c", "import rospy, tf2_ros"], capture_output=True
    ).returncode


def _once(at: Place, rows: int) -> Intake:
    with master(at) as env:
        listener = Process(at, "ros:listen", env, python=PYTHON, seconds=SECONDS)
        with listener, Process(at, "ros:flood", env, python=PYTHON, rows=rows):
            return Intake(**listener.hear())


@contextmanager
def master(at: Place) -> Iterator[dict[str, str]]:
    """The environment of nodes beside a master of their own. Raises NotInstalled."""
    if not _is_installed():
        raise NotInstalled(f"apt-get install {PACKAGES}")
    port = free_port()
    env = {
        **at.env,
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(at.folder),
        "ROS_HOME": str(at.folder),
    }
    process = subprocess.Popen(
        ["rosmaster", "--core", "-p", str(port)],
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        _wait_for(process, port)
        yield env
    finally:
        process.terminate()
        process.wait()


def _wait_for(master: "subprocess.Popen[bytes]", port: int) -> None:
    """Wait until the master accepts connections: nodes that start earlier retry for long."""
    deadline = time.monotonic() + _MASTER_WITHIN_S
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
            return
        except OSError:
            if master.poll() is not None or time.monotonic() >= deadline:
                raise RuntimeError("rosmaster does not start; try it by hand") from None
            time.sleep(0.05)


def listen(seconds: float) -> None:
    """The process that listens with tf2_ros, and counts what its buffer takes."""
    import rospy
    import tf2_ros

    counts = [0, 0]

    class Counted(tf2_ros.Buffer):
        def set_transform(self, transform: object, authority: str) -> None:
            super().set_transform(transform, authority)
            counts[1] += 1

    rospy.init_node("listener", disable_signals=True)
    tf2_ros.TransformListener(Counted(rospy.Duration(1.0)))
    while not counts[1]:
        time.sleep(0.01)
    time.sleep(0.5)
    say(during(seconds, lambda: tuple(counts)))
    sys.stdin.readline()


def flood(rows: int) -> None:
    """The process that sends."""
    import threading

    import rospy
    from geometry_msgs.msg import TransformStamped
    from tf2_msgs.msg import TFMessage

    rospy.init_node("sender", disable_signals=True)
    publisher = rospy.Publisher("/tf", TFMessage, queue_size=10)
    transforms = []
    for row in range(rows):
        transform = TransformStamped()
        transform.header.frame_id = "base_link"
        transform.child_frame_id = f"frame_{row}"
        transform.transform.rotation.z = 0.6
        transform.transform.rotation.w = 0.8
        transforms.append(transform)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    while not ended.wait(1.0 / _RATE):
        now = rospy.Time.now()
        for transform in transforms:
            transform.header.stamp = now
        publisher.publish(TFMessage(transforms))
    os._exit(0)
