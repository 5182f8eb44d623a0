"""Helpers for tests of a bus, on a simulated network and between real processes alike."""

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.base import scheduler
from tfbus.base.clock import Timer
from tfbus.wire.keys import stream_key

T = TypeVar("T")

# The safety net of all waits, in seconds of the network that the test runs on.
DEADLINE_S = 120.0


def eventually(
    condition: Callable[[], T],
    *,
    within_s: float = DEADLINE_S,
    every_s: float = 0.01,
    state: Callable[[], object] = lambda: "no state was given",
) -> T:
    """The first true value of the condition; an AssertionError with the state if none comes in
    time.
    """
    deadline = scheduler.monotonic() + within_s
    while not (value := condition()):
        assert scheduler.monotonic() < deadline, f"not within {within_s} s: {state()}"
        scheduler.sleep(every_s)
    return value


async def lookups_wait(buffer: Buffer, count: int = 1) -> None:
    """Run asyncio until `count` tasks wait in the buffer; TimeoutError if they never do."""
    async with asyncio.timeout(DEADLINE_S):
        while buffer.waiting < count:
            await asyncio.sleep(0)


def send_until(
    broadcast: Callable[[], None],
    condition: Callable[[], bool],
    *,
    state: Callable[[], object] = lambda: "no state was given",
) -> None:
    """Send again and again until the condition holds, as a broadcaster does; the error has the
    state if it does not in time.
    """

    def sent() -> bool:
        broadcast()
        return condition()

    eventually(sent, state=state)


def keep_sending(
    node: Node, parent: str, child: str, *, rate_hz: float = 20.0, late_ns: int = 0
) -> Timer:
    """Send a dynamic transform, with stamps `late_ns` in the past, until the timer is cancelled."""
    broadcaster = TransformBroadcaster(node)

    def send() -> None:
        stamp_ns = node.now_ns() - late_ns
        broadcaster.send_transform(TransformStamped(stamp_ns, parent, child, Transform.identity()))

    return node.create_timer(1 / rate_hz, send)


def send_static(node: Node, parent: str, child: str) -> None:
    """Publish one static transform."""
    StaticTransformBroadcaster(node).send_transform(
        TransformStamped(node.now_ns(), parent, child, Transform.identity())
    )


def tell_token(node: Node, *, alive: bool) -> None:
    """Half a link: this node alone is told that the token of "sim" is there, or has ended."""
    zenoh: Any = node.session.zenoh
    zenoh.tokens.report(zenoh.names.full(stream_key("sim")), alive=alive)
