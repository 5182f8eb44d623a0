"""The messages of one topic as they arrive, for a tool that prints each."""

import queue
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.cli.output import say, warn
from tfbus.cli.topic.source import SAY_AFTER_S, subscribe, why_silent
from tfbus.errors import BusError
from tfbus.wording import counted

if TYPE_CHECKING:
    from tfbus.node.node import Node

# The most messages that wait to be printed; beyond that the oldest are skipped.
_PENDING = 1000
# A signal just before the wait begins is seen after this time.
_LOOK_UP_S = 0.5


@dataclass(frozen=True, slots=True)
class Arrival:
    """The bytes of a message, and when they arrived, by the listening node's clock."""

    payload: bytes
    received_ns: int


class Inbox:
    """Iterates over the messages of a topic until the node is shut down; closed by `with`.

    Prints what it waits for if nothing comes for 2 s. Raises BusError if nothing comes for
    `timeout_s` (None: never).
    """

    def __init__(
        self,
        node: "Node",
        topic: str,
        type_name: str,
        *,
        timeout_s: float | None = None,
        retained: bool = False,
    ):
        self._node = node
        self._topic = topic
        self._timeout_s = timeout_s
        self._pending: queue.Queue[Arrival] = queue.Queue(_PENDING)
        self._skipped = 0
        self._subscription = subscribe(node, topic, type_name, self._take, retained=retained)

    def __enter__(self) -> "Inbox":
        return self

    def __exit__(self, *_: object) -> None:
        self._subscription.close()
        if self._skipped:
            skipped = counted(self._skipped, "message")
            warn(f"skipped {skipped}, which arrived faster than they can be printed")

    def __iter__(self) -> Iterator[Arrival]:
        if (first := self._first()) is not None:
            yield first
        while (arrival := self._next()) is not None:
            yield arrival

    def _first(self) -> Arrival | None:
        timeout_s = self._timeout_s
        started_s = time.monotonic()
        soon_s = SAY_AFTER_S if timeout_s is None else min(SAY_AFTER_S, timeout_s)
        first = self._next(started_s + soon_s)
        if first is None and self._node.ok:
            say(why_silent(self._node, self._topic))
            first = self._next(None if timeout_s is None else started_s + timeout_s)
        if first is None and self._node.ok:
            raise BusError(f"no message on {self._topic!r} after {timeout_s:g} s")
        return first

    def _next(self, until_s: float | None = None) -> Arrival | None:
        """The next message; None if none comes by then, or the node is shut down."""
        while self._node.ok:
            left_s = _LOOK_UP_S if until_s is None else until_s - time.monotonic()
            with suppress(queue.Empty):
                return self._pending.get(timeout=min(max(left_s, 0.001), _LOOK_UP_S))
            if left_s <= 0.0:
                break
        return None

    def _take(self, payload: bytes) -> None:
        arrival = Arrival(payload, self._node.now_ns())
        while True:
            try:
                self._pending.put_nowait(arrival)
                break
            except queue.Full:
                self._skipped += 1
                with suppress(queue.Empty):
                    self._pending.get_nowait()
