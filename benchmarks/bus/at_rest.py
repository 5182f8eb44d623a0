"""The processes of `benchmarks.resources`, at rest or with 50 frames at 50 Hz."""

import json
import os
import sys

from benchmarks.bus.place import say

FRAMES, RATE_HZ = 50, 50.0


def publish() -> None:
    """A node that sends all frames at the rate."""
    import tfbus

    with tfbus.Node("publisher") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        pose = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))

        def send() -> None:
            now_ns = node.now_ns()
            broadcaster.send_transform(
                [tfbus.TransformStamped(now_ns, "base", f"f{n}", pose) for n in range(FRAMES)]
            )

        node.create_timer(1.0 / RATE_HZ, send)
        _rest()


def bare_session() -> None:
    """Zenoh's session, and nothing else."""
    import zenoh

    with zenoh.open(_config()):
        _rest()


def bare_subscriber() -> None:
    """A session with a callback in Python for what the publisher sends."""
    import zenoh

    with zenoh.open(_config()) as session:
        handler = zenoh.handlers.Callback(lambda sample: None, None, indirect=False)
        session.declare_subscriber("tf/publisher", handler)
        _rest()


def node() -> None:
    """A node that does nothing."""
    import tfbus

    with tfbus.Node("idle"):
        _rest()


def listener() -> None:
    """A node with a buffer and a listener."""
    import tfbus

    buffer = tfbus.Buffer()
    with tfbus.Node("listener") as at, tfbus.TransformListener(buffer, at):
        buffer.lookup_transform("base", "f0", timeout_s=20.0)
        _rest()


def rospy_node() -> None:
    """A node of ROS 1 that does nothing."""
    import rospy

    rospy.init_node("idle", disable_signals=True)
    say("ready")
    sys.stdin.readline()
    os._exit(0)


def _config() -> object:
    import zenoh

    config = zenoh.Config.from_file(os.environ["TFBUS_CONFIG"])
    if endpoint := os.environ.get("TFBUS_CONNECT"):
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return config


def _rest() -> None:
    say("ready")
    sys.stdin.readline()
