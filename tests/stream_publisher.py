"""A publisher for tests between processes: frames at a rate, some static, until a signal.

python stream_publisher.py NAME [--moving CHILD]... [--static CHILD]... [--x X] [--from STAMP_S]

Each frame hangs below `world`, X metres ahead. Stamps are the time, or begin at STAMP_S.
"""

import argparse
import time

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
    parser.add_argument("--from", dest="first_s", type=float)
    asked = parser.parse_args()
    start_ns = time.time_ns()
    shift_ns = 0 if asked.first_s is None else round(asked.first_s * 1e9) - start_ns
    pose = Transform((asked.x, 0.0, 0.0))

    def frames(children: list[str]) -> list[TransformStamped]:
        stamp_ns = time.time_ns() + shift_ns
        return [TransformStamped(stamp_ns, "world", child, pose) for child in children]

    with Node(asked.name) as node:
        if asked.static:
            StaticTransformBroadcaster(node).send_transform(frames(asked.static))
        if asked.moving:
            broadcaster = TransformBroadcaster(node)
            node.create_timer(PERIOD_S, lambda: broadcaster.send_transform(frames(asked.moving)))
        node.spin()


if __name__ == "__main__":
    main()
