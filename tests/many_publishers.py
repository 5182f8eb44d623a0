"""Many streams in one process, each with a set of static frames, until a signal.

python many_publishers.py FIRST NODES STREAMS STATICS

Each node has so many streams, each stream so many frames.
"""

import sys
from contextlib import ExitStack

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformStamped


def frame(stream: int, number: int) -> str:
    """One of the static frames of a stream."""
    return f"s{stream}_{number}"


def main(first: int, nodes: int, streams: int, statics: int) -> None:
    """Publish until a signal."""
    with ExitStack() as stack:
        for number in range(first, first + nodes * streams, streams):
            node = stack.enter_context(Node(f"node{number}"))
            for stream in range(number, number + streams):
                StaticTransformBroadcaster(node, stream=f"s{stream}").send_transform(
                    TransformStamped(
                        node.now_ns(), "world", frame(stream, i), Transform((stream, i, 0.0))
                    )
                    for i in range(statics)
                )
        node.spin()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
