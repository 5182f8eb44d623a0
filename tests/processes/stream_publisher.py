"""A publisher for tests between processes: frames at a rate, some static, until a signal.

python stream_publisher.py NAME [--moving FRAME]... [--static FRAME]... [--x X] [--from STAMP_S]
    [--namespace NAMESPACE] [--split] [--priority N] [--history S] [--remove CHILD]...
    [--correct CHILD]...

A FRAME is PARENT:CHILD, or CHILD for one that hangs below `world`; each is X metres ahead of its
parent. Stamps are the time; or the first is STAMP_S, and time goes on. At SIGUSR1 it removes the
frames to be removed, and sends the static frames to be corrected a metre further ahead.
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


class Publisher:
    """The frames of one stream, as the command line wants them."""

    def __init__(self, node: Node, asked: argparse.Namespace) -> None:
        self._asked = asked
        self._shift_ns = 0 if asked.first_s is None else None
        self._moving = list(asked.moving)
        self._static = StaticTransformBroadcaster(node)
        if asked.static:
            self._static.send_transform(self._frames(asked.static, asked.x))
        self._broadcaster = TransformBroadcaster(
            node, priority=asked.priority, split=asked.split, history_s=asked.history_s
        )
        self._is_told = threading.Event()
        signal.signal(signal.SIGUSR1, lambda number, frame: self._is_told.set())
        node.create_timer(PERIOD_S, self._step)

    def _frames(self, names: list[str], x: float) -> list[TransformStamped]:
        now_ns = time.time_ns()
        if self._shift_ns is None:
            self._shift_ns = round(self._asked.first_s * 1e9) - now_ns
        stamp_ns = now_ns + self._shift_ns
        edges = [name.rpartition(":") for name in names]
        pose = Transform((x, 0.0, 0.0))
        return [
            TransformStamped(stamp_ns, parent or "world", child, pose) for parent, _, child in edges
        ]

    def _step(self) -> None:
        if self._is_told.is_set():
            self._is_told.clear()
            self._change()
        if self._moving:
            self._broadcaster.send_transform(self._frames(self._moving, self._asked.x))

    def _change(self) -> None:
        asked = self._asked
        self._moving = [name for name in self._moving if name not in asked.remove]
        for child in asked.remove:
            (self._static if child in asked.static else self._broadcaster).remove(child)
        if asked.correct:
            self._static.send_transform(self._frames(asked.correct, asked.x + 1.0))


def main() -> None:
    """Publish until a signal."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("--moving", action="append", default=[])
    parser.add_argument("--static", action="append", default=[])
    parser.add_argument("--x", type=float, default=0.0)
    parser.add_argument("--from", dest="first_s", type=float)
    parser.add_argument("--namespace", default="")
    parser.add_argument("--split", action="store_true")
    parser.add_argument("--priority", type=int, default=0)
    parser.add_argument("--history", dest="history_s", type=float, default=10.0)
    parser.add_argument("--remove", action="append", default=[])
    parser.add_argument("--correct", action="append", default=[])
    asked = parser.parse_args()
    with Node(asked.name, namespace=asked.namespace) as node:
        Publisher(node, asked)
        node.spin()


if __name__ == "__main__":
    main()
