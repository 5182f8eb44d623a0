"""Many processes, each a node with one stream of static frames, until a signal.

python many_publishers.py PROCESSES STATICS

They are forks of one process, which has loaded tfbus and not begun to use it: loading it so often
would keep the machine busy for longer than the processes take to meet.
"""

import os
import sys

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformStamped


def stream(number: int) -> str:
    """The stream, and the node, of one process."""
    return f"s{number}"


def frame(stream: int, number: int) -> str:
    """One of the static frames of a stream."""
    return f"s{stream}_{number}"


def publish(number: int, statics: int) -> None:
    """Publish one stream until a signal."""
    with Node(stream(number)) as node:
        StaticTransformBroadcaster(node).send_transform(
            TransformStamped(node.now_ns(), "world", frame(number, i), Transform((number, i, 0.0)))
            for i in range(statics)
        )
        node.spin()


def main(processes: int, statics: int) -> None:
    """Publish until a signal."""
    for number in range(processes):
        if not os.fork():
            publish(number, statics)
            sys.exit()
    for _ in range(processes):
        os.wait()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
