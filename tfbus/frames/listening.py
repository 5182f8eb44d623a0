"""A listener for a command that looks at all frames: it has met everybody when it is handed out."""

import logging
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from tfbus.buffer.buffer import Buffer
from tfbus.bus.settings import NodeSettings
from tfbus.errors import TimeoutException
from tfbus.frames.snapshot import FrameTree, frame_tree
from tfbus.listen.listener import TransformListener
from tfbus.node.node import Node
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.fleet import Fleet

# So much of what publishers sent before tells their rates at once.
_HISTORY_S = 3.0

_CLOCK_WITHIN_S = 5.0

# Links open one after the other, and what streams tell follows.
_QUIET_S = 0.3


@dataclass(frozen=True)
class Listening:
    """A node of this command's own, and what it hears: of a whole fleet, or of its namespace."""

    node: Node
    buffer: Buffer
    listener: TransformListener
    fleet: Fleet | None

    def tree(self) -> FrameTree:
        """All that is known now."""
        return frame_tree(self.buffer, self.listener.streams(), self.node.now_ns())

    def hint(self, frame: str = "") -> str:
        """Where else a frame is known, or any frame at all; "" where it is nowhere."""
        return self.listener.where_to_look(frame)


@contextmanager
def listening(
    settings: NodeSettings,
    fleet: Fleet | None,
    *,
    within_s: float = 2.0,
    history_s: float = _HISTORY_S,
    cache_time_s: float = 10.0,
    goes_on: bool = False,
) -> Iterator[Listening]:
    """Listen to all transforms; handed out as soon as nothing new comes, at most `within_s` later.

    Each publisher is asked for the last `history_s` seconds that it has kept. A router that is not
    there is waited for by who `goes_on`, and says so; else BusError is raised. Ctrl-C and SIGTERM
    raise KeyboardInterrupt, where the `with` does not take them for its end (`node.wait`).
    """
    buffer = Buffer(cache_time_s)
    with (
        _join(settings, goes_on) as node,
        TransformListener(buffer, node, history_s=history_s, fleet=fleet) as listener,
    ):
        wait_for_clock(node)
        heard = Listening(node, buffer, listener, fleet)
        _meet_everybody(heard, within_s)
        if node.ok:
            yield heard
            return
    raise KeyboardInterrupt  # which the node's `with` has ended quietly


def _join(settings: NodeSettings, goes_on: bool) -> Node:
    if not goes_on:
        return Node(settings=replace(settings, log_level="error"), patience_s=0.0)
    node = Node(settings=replace(settings, log_level="warning"), patience_s=math.inf)
    node.log.setLevel(logging.ERROR)
    return node


def wait_for_clock(node: Node) -> None:
    """Wait until the node knows what time it is. Raises TimeoutException where nobody tells it."""
    if not node.wait_for_clock(_CLOCK_WITHIN_S) and node.ok:
        raise TimeoutException(
            f"nobody has told the time for {_CLOCK_WITHIN_S:g} s: start a clock (tfbus clock), or "
            "leave --sim-time away"
        )


def _meet_everybody(heard: Listening, within_s: float) -> None:
    deadline = time.monotonic() + within_s
    known, since = _known(heard), time.monotonic()
    while time.monotonic() < deadline and heard.node.wait(0.02, clock=SYSTEM_CLOCK):
        now = _known(heard)
        if now != known:
            known, since = now, time.monotonic()
        elif now[0] and now[1] >= now[0] and time.monotonic() - since > _QUIET_S:
            return


def _known(heard: Listening) -> tuple[int, int, int]:
    """How many frames streams tell of, how many have come, and how many streams there are."""
    streams = [stream for stream in heard.listener.streams() if stream.alive]
    told = {child for stream in streams for _, child, _ in stream.frames}
    return len(told), len(told.intersection(heard.buffer.frames())), len(streams)
