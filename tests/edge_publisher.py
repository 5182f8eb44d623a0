"""A publisher for tests between processes: edges at a rate, some static, until a signal.

python edge_publisher.py NAME [--moving PARENT:CHILD]... [--static PARENT:CHILD]... [--x X]
    [--namespace NAMESPACE] [--split]

Each child is X metres ahead of its parent.
"""

import argparse

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)

PERIOD_S = 0.02


def main() -> None:
    """Publish until a signal."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("--moving", action="append", default=[])
    parser.add_argument("--static", action="append", default=[])
    parser.add_argument("--x", type=float, default=0.0)
    parser.add_argument("--namespace", default="")
    parser.add_argument("--split", action="store_true")
    asked = parser.parse_args()

    with Node(asked.name, namespace=asked.namespace) as node:

        def edges(names: list[str]) -> list[TransformStamped]:
            pose = Transform((asked.x, 0.0, 0.0))
            stamp_ns = node.now_ns()
            pairs = [name.split(":") for name in names]
            return [TransformStamped(stamp_ns, parent, child, pose) for parent, child in pairs]

        if asked.static:
            StaticTransformBroadcaster(node).send_transform(edges(asked.static))
        if asked.moving:
            moving = TransformBroadcaster(node, split=asked.split)
            node.create_timer(PERIOD_S, lambda: moving.send_transform(edges(asked.moving)))
        node.spin()


if __name__ == "__main__":
    main()
