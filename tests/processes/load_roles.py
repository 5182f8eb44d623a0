"""Processes for tests of loads: a publisher that sends as much as it is asked to; a listener that
tells the number of received messages; and one that takes two milliseconds for each message.

python load_roles.py publish|listen|dawdle
"""

import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBatch,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)

TRICKLE_S = 0.05


class Load:
    """Sends a number of messages, of equally many frames each, at a rate per second (0: as fast as
    possible); then a static frame, if any, `static_x` metres ahead.
    """

    @dataclass(frozen=True)
    class Request:
        """How many."""

        sends: int = 0
        frames: int = 1
        rate: float = 0.0
        static_x: float = 0.0

    @dataclass(frozen=True)
    class Response:
        """The number of the last send, which is the x of its frames; how long it took; and the
        memory of the process now, in bytes.
        """

        number: int
        seconds: float
        memory: int


class Report:
    """What the listener has received of the publisher."""

    @dataclass(frozen=True)
    class Request:
        """Nothing to say."""

    @dataclass(frozen=True)
    class Response:
        """Messages that came and that did not; the x of the newest and that of the static frame;
        and the memory of the process, in bytes, where another one tells.
        """

        messages: int
        missed: int
        x: float
        static_x: float
        memory: int = 0


def heard(listener: TransformListener) -> Report.Response:
    """What a listener has received of the publisher, at a moment at which nothing came: what is in
    the buffer has been counted, too.
    """
    while True:
        before = _heard(listener)
        time.sleep(0.01)
        if before == _heard(listener):
            return before


def _heard(listener: TransformListener) -> Report.Response:
    [stream] = [stream for stream in listener.streams() if stream.name == "publisher"] or [None]
    if stream is None:
        return Report.Response(0, 0, -1.0, -1.0)
    x, static_x = (x_of(listener.buffer, frame) for frame in ("frame_0", "static"))
    return Report.Response(stream.messages, stream.missed, x, static_x)


def x_of(buffer: Buffer, frame: str) -> float:
    """How far ahead a frame is; -1 where it is not known."""
    if not buffer.can_transform("world", frame):
        return -1.0
    return buffer.lookup_transform("world", frame).transform.x


def batch(number: int, frames: int) -> TransformBatch:
    """`frames` frames below `world`, as far ahead as the number says."""
    names = ("world", *(f"frame_{index}" for index in range(frames)))
    edges = np.array([(0, 1 + index) for index in range(frames)], dtype=np.uint32)
    poses = np.tile([float(number), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (frames, 1))
    return TransformBatch(names, edges, np.full(frames, time.time_ns()), poses)


def publish(node: Node) -> None:
    """Send one frame now and then, and as many as asked for in between."""
    dynamic = TransformBroadcaster(node, history_s=0.0)
    # In a stream of its own, so that the messages of the other are those of the sends.
    static = StaticTransformBroadcaster(node, stream="fixed")
    number = -1

    def send(frames: int = 1) -> None:
        nonlocal number
        number += 1
        dynamic.send_transform(batch(number, frames))

    def load(request: Load.Request) -> Load.Response:
        started = time.monotonic()
        for sent in range(request.sends):
            if request.rate:
                time.sleep(max(0.0, started + sent / request.rate - time.monotonic()))
            send(request.frames)
        if request.static_x:
            pose = Transform((request.static_x, 0.0, 0.0))
            static.send_transform(TransformStamped(time.time_ns(), "world", "static", pose))
        return Load.Response(number, time.monotonic() - started, memory())

    node.create_timer(TRICKLE_S, send)
    node.create_service(Load, "load", load)
    node.spin()


class SlowBuffer(Buffer):
    """Takes five hundred messages a second at most."""

    def set_transforms(self, batch: Any, **how: Any) -> int:
        """As a buffer does, but slowly."""
        time.sleep(0.002)
        return super().set_transforms(batch, **how)


def listen(node: Node, buffer: Buffer) -> None:
    """Listen, and tell who asks."""
    listener = TransformListener(buffer, node)
    node.create_service(Report, "report", lambda request: replace(heard(listener), memory=memory()))
    node.spin()


def memory(pid: int | str = "self") -> int:
    """The memory of a process that is not swapped out, in bytes."""
    with open(f"/proc/{pid}/status") as status:
        [line] = [line for line in status if line.startswith("VmRSS")]
    return int(line.split()[1]) * 1024


if __name__ == "__main__":
    role = sys.argv[1]
    with Node("publisher" if role == "publish" else "slow") as this_node:
        if role == "publish":
            publish(this_node)
        else:
            listen(this_node, Buffer() if role == "listen" else SlowBuffer(cache_time_s=0.5))
