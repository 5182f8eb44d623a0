"""Many publishers in one process, each with a set of static frames, until a signal.

python many_publishers.py FIRST COUNT STATICS
"""

import sys
from contextlib import ExitStack

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformStamped


def frame(publisher: int, number: int) -> str:
    """One of the static frames of a publisher."""
    return f"p{publisher}_{number}"


def main(first: int, count: int, statics: int) -> None:
    """Publish until a signal."""
    with ExitStack() as stack:
        for publisher in range(first, first + count):
            node = stack.enter_context(Node(f"p{publisher}"))
            StaticTransformBroadcaster(node).send_transform(
                TransformStamped(
                    node.now_ns(), "world", frame(publisher, i), Transform((publisher, i, 0.0))
                )
                for i in range(statics)
            )
        node.spin()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
