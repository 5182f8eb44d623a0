"""Plays a recording by a clock: each item at its time, read ahead; knows no bus.

A `Player` runs on the thread that calls `run`, and hands its items to a `Stage`: the bus, a
viewer, a test. Any other thread may pause it, seek, and so on.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Protocol

from tfbus.base import scheduler
from tfbus.base.clock import SYSTEM_CLOCK, Clock
from tfbus.base.errors import InvalidArgumentException
from tfbus.recording.items import ALL, EventItem, Item, Selection, TransformItem
from tfbus.recording.playhead import AtEnd, Pace, Playhead, Progress, stepped_ns
from tfbus.recording.state import Playable, items_of_state

# Items that are later than this, as on a machine that is too slow for the rate, delay all that
# follow: they are not played in a burst.
_MOST_LATE_NS = 50_000_000


class Stage(Protocol):
    """The place that a recording is played to. All calls come from the thread of `Player.run`."""

    def begin(self, state: Sequence[Item], pace: Pace, *, is_back: bool) -> None:
        """Playing begins at a moment with this state; `is_back` if it is earlier than the messages
        played before.
        """

    def take(self, item: Item, pace: Pace) -> None:
        """An item, at its time."""

    def follow(self, progress: Progress) -> None:
        """It was paused, resumed, or has another rate, or has come to its end."""


class Player(Playhead):
    """Plays the `selection` of a recording from `start_ns` to `end_ns`, log times in ns.

    If it begins or is sought to, the last message so far on each of the topics `lasting` belongs
    to the state, as static transforms do: it holds until the next, as a simulated time does. The
    last dynamic transforms of `look_back_s` before that belong to it, too, with their log times.

    Its methods may be called from any thread, before and while it runs. Raises
    InvalidArgumentException for a rate that is not between 0.001 and 10,000, or if nothing lies
    between start and end.
    """

    def __init__(
        self,
        source: Playable,
        *,
        selection: Selection = ALL,
        start_ns: int | None = None,
        end_ns: int | None = None,
        rate: float = 1.0,
        paused: bool = False,
        at_end: AtEnd = "stop",
        lasting: Sequence[str] = (),
        look_back_s: float = 0.0,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        start_ns = source.start_ns if start_ns is None else max(start_ns, source.start_ns)
        end_ns = source.end_ns if end_ns is None else min(end_ns, source.end_ns)
        if end_ns < start_ns:
            raise InvalidArgumentException(
                "there is nothing to play between start and end: the recording lasts "
                f"{(source.end_ns - source.start_ns) / 1e9:.3f} s"
            )
        super().__init__(start_ns, end_ns, rate=rate, paused=paused, at_end=at_end, clock=clock)
        self._source = source
        self._selection = selection
        self._lasting = lasting
        self._look_back_ns = round(look_back_s * 1e9)
        self._reached_ns = start_ns
        # Where it goes next, and where it is going while that is read.
        self._seek_ns: int | None = None
        self._goes_to_ns: int | None = None
        # Of the last message that was played since it began, or was sought to.
        self._last_ns: int | None = None
        self._has_played = False
        self._is_stopped = False

    def stop(self) -> None:
        """Make `run` return; twice is fine."""
        with self.changed:
            self._is_stopped = True
            self.changed.notify_all()

    @property
    def is_seeking(self) -> bool:
        """Whether it has been told to go elsewhere, and has not set out yet."""
        with self.changed:
            return self._seek_ns is not None

    # Playing

    def run(self, stage: Stage) -> None:
        """Play to the end, or until `stop`. Raises as reading the recording does."""
        at_ns, is_back = self.start_ns, False
        while True:
            state = items_of_state(
                self._source, at_ns, self._selection, self._lasting, self._look_back_ns
            )
            items = self._source.items(at_ns, self.end_ns, self._selection)
            with ReadAhead(items, self.changed) as ahead:
                self._begin(stage, state, at_ns, is_back)
                goes_on = self._play(stage, ahead)
            if not goes_on:
                return
            at_ns, is_back = self._next_start()

    def _begin(self, stage: Stage, state: list[Item], at_ns: int, is_back: bool) -> None:
        with self.changed:
            self._reached_ns, self._last_ns, self._goes_to_ns = at_ns, None, None
            self._anchor(at_ns)
            pace = self._pace
        stage.begin(state, pace, is_back=is_back)
        with self.changed:
            # That may have taken a moment.
            self._anchor(at_ns)

    def _play(self, stage: Stage, ahead: "ReadAhead") -> bool:
        """Play until it goes on elsewhere; False to end."""
        while True:
            with self.changed:
                if self._is_stopped:
                    return False
                if self._seek_ns is not None or self._steps < 0:
                    return True
                is_news, self._pace_is_news = self._pace_is_news, False
                if not is_news and self._has_ended(ahead):
                    if self._at_end == "stop" or (self._at_end == "loop" and not self._has_played):
                        return False
                    is_news = not self._is_at_end
                    self._arrive(can_loop=True)
                    if self._seek_ns is not None:
                        return True
                    self._pace_is_news = False
                item = None if is_news else self._next(ahead)
                if item is None and not is_news:
                    self.changed.wait(self._left_s(ahead))
                    continue
                pace = self._pace
            if item is not None:
                stage.take(item, pace)
            else:
                stage.follow(self.progress)

    def _next_start(self) -> tuple[int, bool]:
        """The log time to go on at, and whether that is back: then its message is played again."""
        steps = min(self._steps, 0)
        back_ns = stepped_ns(self._source, self, steps, _is_message, self._selection)
        with self.changed:
            if self._seek_ns is None:
                here_ns = self._played_ns()
                # Resumed meanwhile, it goes on from here.
                later = self._steps - steps if self._is_paused else 0
                is_again = back_ns is not None or self._last_ns == here_ns
                self.seek(here_ns if back_ns is None else back_ns)
                self._steps = later + (is_again and self._is_paused)
            assert self._seek_ns is not None
            at_ns = self._goes_to_ns = self._seek_ns
            is_back = at_ns < self._played_ns() or self._is_at_end
            self._seek_ns, self._is_at_end = None, False
            return at_ns, is_back

    def _has_ended(self, ahead: "ReadAhead") -> bool:
        if not ahead.is_at_end:
            return False
        self._reached_ns = self.end_ns
        if self._is_paused:
            self._steps = 0  # there is nothing to step to
        return self._is_due(self.end_ns)

    def _next(self, ahead: "ReadAhead") -> Item | None:
        """The item to play now; None if it is not time yet."""
        first = ahead.first()
        if first is None:
            return None
        self._reached_ns = max(first.log_ns, self._pace.log_ns)
        is_message = _is_message(first)
        if self._is_paused:
            if not self._steps:
                return None
            self._steps -= is_message
            self._anchor(self._reached_ns)
        elif not self._is_due(first.log_ns):
            return None
        self._sent += is_message and not _is_static(first)
        self._has_played |= is_message
        self._last_ns = self._reached_ns if is_message else self._last_ns
        return ahead.pop()

    def _is_due(self, log_ns: int) -> bool:
        if self._is_paused:
            # The rest of the last step.
            return self._pace.log_ns >= log_ns
        late_ns = self.clock() - self._pace.real_at(log_ns)
        if late_ns > _MOST_LATE_NS:
            self._late_ns += late_ns
            self._anchor(max(log_ns, self._pace.log_ns))
        return late_ns >= 0

    def _left_s(self, ahead: "ReadAhead") -> float | None:
        """How long to wait for the next item, or the end; None until something changes."""
        first = ahead.first()
        if self._is_paused or (first is None and not ahead.is_at_end):
            return None
        due_ns = self.end_ns if first is None else first.log_ns
        left_s = max(self._pace.real_at(due_ns) - self.clock(), 0) / 1e9
        return min(left_s, scheduler.TIMEOUT_MAX)

    # With the lock held

    def _go_to(self, log_ns: int, *, since_ns: int | None = None) -> None:
        self._seek_ns = log_ns

    def _position_ns(self) -> int:
        for goes_to_ns in (self._seek_ns, self._goes_to_ns):
            if goes_to_ns is not None:
                return goes_to_ns
        return self._played_ns()


def _is_static(item: Item) -> bool:
    return isinstance(item, TransformItem) and item.static


def _is_message(item: Item) -> bool:
    return not isinstance(item, EventItem)


# At most this many items are kept ready, and about this much memory. Then reading waits until half
# of it is played.
_MOST_ITEMS = 2000
_MOST_BYTES = 64 * 2**20

# With this many ready, reading gives way to playing for this long each time it has read so much. To
# do so after each item would cost more than to read it.
_ENOUGH_ITEMS = 100
_GIVES_WAY_S = 0.0002
_AT_ONCE = 16
_BYTES_AT_ONCE = 2**20

# The bytes of Python's objects of an item, about, and of the columns of one transform.
_ITEM_BYTES = 1000
_ROW_BYTES = 8 + 8 + 56


class ReadAhead:
    """Keeps the next items of `items` ready; use it in a `with`, which ends its thread.

    `changed` is notified when an item comes if there was none, and at the end. Hold it around
    each call.
    """

    def __init__(self, items: Iterator[Item], changed: scheduler.Condition) -> None:
        self._items = items
        self._changed = changed
        self._has_room = scheduler.Condition(scheduler.Lock())
        self._ready: deque[Item] = deque()
        self._bytes = 0
        self._is_read = self._is_closed = self._waits_for_room = False
        self._error: Exception | None = None
        self._thread = scheduler.Thread(target=self._read, name="read ahead", daemon=True)

    def __enter__(self) -> "ReadAhead":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._has_room:
            self._is_closed = True
            self._has_room.notify()
        self._thread.join()

    @property
    def is_at_end(self) -> bool:
        """Whether all items were taken. Raises the error of reading them."""
        if self._ready or not self._is_read:
            return False
        if self._error is not None:
            raise self._error
        return True

    def first(self) -> Item | None:
        """The next item, which stays; None if none is ready."""
        return self._ready[0] if self._ready else None

    def pop(self) -> Item:
        """Remove and return the next item; `first` must have returned one."""
        item = self._ready.popleft()
        with self._has_room:
            self._bytes -= _size(item)
            if self._waits_for_room and (self._is_half_empty or not self._ready):
                self._has_room.notify()
        return item

    def _read(self) -> None:
        batch: list[Item] = []
        size = 0
        try:
            for item in self._items:
                batch.append(item)
                size += _size(item)
                is_enough = len(self._ready) > _ENOUGH_ITEMS
                if is_enough and len(batch) < _AT_ONCE and size < _BYTES_AT_ONCE:
                    continue
                if not self._add(batch, size):
                    return
                batch, size = [], 0
                if is_enough:
                    scheduler.sleep(_GIVES_WAY_S)
        except Exception as error:  # raised again where the items are taken
            self._error = error
        self._add(batch, size)
        with self._changed:
            self._is_read = True
            self._changed.notify_all()

    def _add(self, batch: list[Item], size: int) -> bool:
        """Add items once there is room; False if no further ones are wanted."""
        with self._has_room:
            if len(self._ready) >= _MOST_ITEMS or self._bytes + size > _MOST_BYTES:
                self._waits_for_room = True
                while self._ready and not self._is_closed and not self._is_half_empty:
                    self._has_room.wait()
                self._waits_for_room = False
            self._bytes += size
            if self._is_closed:
                return False
        with self._changed:
            was_empty = not self._ready
            self._ready.extend(batch)
            if was_empty:
                self._changed.notify_all()
        return True

    @property
    def _is_half_empty(self) -> bool:
        return len(self._ready) <= _MOST_ITEMS // 2 and self._bytes <= _MOST_BYTES // 2


def _size(item: Item) -> int:
    """About how many bytes an item takes."""
    if isinstance(item, TransformItem):
        return _ITEM_BYTES + _ROW_BYTES * item.rows.count
    if isinstance(item, EventItem):
        return _ITEM_BYTES
    # Long ones are images, or arrays of numbers.
    return _ITEM_BYTES + sum(
        len(value) for value in item.values.values() if isinstance(value, bytes | str | list)
    )
