"""A recording as the page shows it: as the bus was at the cursor, and what it plays towards."""

import logging
import threading
from collections.abc import Iterator, Sequence
from typing import Protocol

from tfbus.buffer.buffer import Buffer
from tfbus.listen.info import StreamInfo
from tfbus.recording.items import Item, TransformItem
from tfbus.runtime.clock import Clock
from tfbus.view.model.playhead import Cursor, Playhead
from tfbus.view.model.timeline import Timeline

# What was heard before the cursor, for rates and trails; and where it is more than this ahead of
# what was read, that much is read instead of all in between.
_BEFORE_S = 3.0

# A pause of the machine is no part of the recording.
_MOST_STEP_S = 0.25


class Recorded(Protocol):
    """A bus as it was, from the items that came."""

    @property
    def buffer(self) -> Buffer:
        """What a listener's buffer held."""

    def take(self, item: Item) -> object:
        """Take the next item."""

    def streams(self) -> Sequence[StreamInfo]:
        """The streams as a listener saw them."""


class Source(Protocol):
    """Where the items come from: a recording."""

    def bus_at(self, at_ns: int, before_s: float) -> tuple[Recorded, Iterator[Item]]:
        """The bus at a time, with what came in the `before_s` before; and the items after it."""

    def message_before(self, at_ns: int) -> int | None:
        """When the last message with transforms before a time came."""


class Replay:
    """The host, the publishers and the buffer of a page that shows a recording.

    `move` is for the page's thread; the playhead is for any.
    """

    def __init__(self, source: Source, timeline: Timeline, cursor: Cursor) -> None:
        self.log = logging.getLogger("tfbus.view")
        self.timeline = timeline
        self.playhead = Playhead(timeline.start_ns, timeline.end_ns, cursor)
        self._source = source
        self._ended = threading.Event()
        self._moved_s: float | None = None
        self._before_s = _BEFORE_S
        self._go(self.playhead.cursor.at_ns)

    @property
    def buffer(self) -> Buffer:
        """The transforms up to the cursor."""
        return self._bus.buffer

    def streams(self) -> Sequence[StreamInfo]:
        """The streams as they were at the cursor."""
        return self._bus.streams()

    def now_ns(self) -> int:
        """The time of the cursor, by which ages are judged."""
        return self._at_ns

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait, at most until `end`; whether the page goes on."""
        return not self._ended.wait(timeout_s)

    def end(self) -> None:
        """End the page."""
        self._ended.set()

    def move(self, now_s: float, *, is_watched: bool, before_s: float = 0.0) -> bool:
        """Bring buffer and streams to the cursor, which plays while a browser watches; `now_s` is
        the time of a steady clock. Whether it has jumped, or other browsers must follow it.

        At least `before_s` of what came before is there.
        """
        passed_s = 0.0 if self._moved_s is None or not is_watched else now_s - self._moved_s
        self._moved_s = now_s
        if steps := self.playhead.take_steps():
            self._step(steps)
        jumps = self.playhead.jumps
        at_ns = self.playhead.advance(min(passed_s, _MOST_STEP_S)).at_ns
        wants_more = before_s > self._before_s
        if wants_more:
            self._before_s = before_s
        if wants_more or not 0 <= at_ns - self._at_ns <= _BEFORE_S * 1e9:
            self._go(at_ns)
            return True
        self._read_to(at_ns)
        return self.playhead.jumps != jumps

    def _go(self, at_ns: int) -> None:
        self._bus, self._rest = self._source.bus_at(at_ns, self._before_s)
        self._next = next(self._rest, None)
        self._at_ns = at_ns

    def _read_to(self, at_ns: int) -> None:
        while self._next is not None and self._next.log_ns <= at_ns:
            self._bus.take(self._next)
            self._next = next(self._rest, None)
        self._at_ns = at_ns

    def _step(self, steps: int) -> None:
        """Go that many messages of transforms forward, or back."""
        for _ in range(steps):
            while self._next is not None and not _moves(self._next):
                self._bus.take(self._next)
                self._next = next(self._rest, None)
            if self._next is None:
                break
            self._read_to(self._next.log_ns)
        at_ns: int | None = self._at_ns
        for _ in range(-steps):
            at_ns = self._source.message_before(at_ns) if at_ns is not None else None
        self.playhead.seek(self.playhead.start_ns if at_ns is None else at_ns, plays=False)


def _moves(item: Item) -> bool:
    return isinstance(item, TransformItem) and not item.static
