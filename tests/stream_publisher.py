"""A publisher for tests between processes: frames at a rate, some static, until a signal.

python stream_publisher.py NAME [--moving CHILD]... [--static CHILD]... [--x X] [--from STAMP_S]
    [--priority N] [--remove CHILD]... [--correct CHILD]

Each frame hangs below `world`, X metres ahead. Stamps are the time, or begin at STAMP_S. At
SIGUSR1 it removes the frames to be removed, and sends the static frame to be corrected a metre
further ahead.
"""

import argparse
import signal
import threading
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
    parser.add_argument("--priority", type=int, default=0)
    parser.add_argument("--remove", action="append", default=[])
    parser.add_argument("--correct", action="append", default=[])
    asked = parser.parse_args()
    shift_ns = None if asked.first_s is not None else 0

    def frames(children: list[str], x: float) -> list[TransformStamped]:
        nonlocal shift_ns
        now_ns = time.time_ns()
        if shift_ns is None:
            shift_ns = round(asked.first_s * 1e9) - now_ns
        pose = Transform((x, 0.0, 0.0))
        return [TransformStamped(now_ns + shift_ns, "world", child, pose) for child in children]

    with Node(asked.name) as node:
        static = StaticTransformBroadcaster(node)
        if asked.static:
            static.send_transform(frames(asked.static, asked.x))
        broadcaster = TransformBroadcaster(node, priority=asked.priority)
        moving = list(asked.moving)
        told = threading.Event()
        signal.signal(signal.SIGUSR1, lambda number, frame: told.set())

        def change() -> None:
            moving[:] = [child for child in moving if child not in asked.remove]
            for child in asked.remove:
                (static if child in asked.static else broadcaster).remove(child)
            if asked.correct:
                static.send_transform(frames(asked.correct, asked.x + 1.0))

        def step() -> None:
            if told.is_set():
                told.clear()
                change()
            broadcaster.send_transform(frames(moving, asked.x))

        node.create_timer(PERIOD_S, step)
        node.spin()


if __name__ == "__main__":
    main()
