"""A publisher for the test of faults: one dynamic frame and three static ones on it.

python fault_publisher.py NAME
"""

import sys

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)

STATICS = 3
PERIOD_S = 0.05


def dynamic_frame(name: str) -> str:
    """The dynamic frame of a publisher."""
    return f"{name}_base"


def static_frame(name: str, number: int) -> str:
    """One of a publisher's static frames, `number` metres ahead of its dynamic one."""
    return f"{name}_sensor{number}"


def main(name: str) -> None:
    """Publish until a signal."""
    with Node(name) as node:
        base = dynamic_frame(name)
        now_ns = node.now_ns()
        StaticTransformBroadcaster(node).send_transform(
            TransformStamped(now_ns, base, static_frame(name, i), Transform([float(i), 0.0, 0.0]))
            for i in range(STATICS)
        )
        broadcaster = TransformBroadcaster(node)

        def move() -> None:
            broadcaster.send_transform(
                TransformStamped(node.now_ns(), "world", base, Transform.identity())
            )

        node.create_timer(PERIOD_S, move)
        node.spin()


if __name__ == "__main__":
    main(sys.argv[1])
