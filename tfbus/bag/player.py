"""Plays a recording by a clock: each item at its time, at any rate; knows no bus.

A `Player` runs on the thread that calls `run`, and hands what it plays to a `Stage`: the bus, a
viewer, a test. Any other thread may pause it, seek, and so on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from tfbus.bag.in_force import Source, in_force
from tfbus.bag.read_ahead import ReadAhead
from tfbus.errors import InvalidArgumentException
from tfbus.recording.items import EventItem, Item
from tfbus.recording.selection import ALL, Selection
from tfbus.runtime import scheduler

SLOWEST, FASTEST = 1e-3, 1e4

# What to do at the end: return from `run`, begin again, or wait for a seek.
AtEnd = Literal["stop", "loop", "wait"]

# Items that are later than this, as on a machine that is too slow for the rate, delay all that
# follow: they are not played in a burst.
_MOST_LATE_NS = 50_000_000


@dataclass(frozen=True)
class Pace:
    """How the time of the recording goes with the real one: at `log_ns` it was `real_ns` of the
    monotonic clock and `wall_ns` of the system's, and since then `rate` recorded seconds pass in a
    second.
    """

    log_ns: int
    real_ns: int
    wall_ns: int
    rate: float = 1.0

    def log_at(self, real_ns: int) -> int:
        """The time in the recording at a time of the monotonic clock, both in ns."""
        return self.log_ns + round((real_ns - self.real_ns) * self.rate)

    def real_at(self, log_ns: int) -> int:
        """The time of the monotonic clock at a time in the recording."""
        past_ns = log_ns - self.log_ns
        # Without rounding where there is nothing to round.
        return self.real_ns + (past_ns if self.rate == 1.0 else round(past_ns / self.rate))


@dataclass(frozen=True)
class Progress:
    """How far a recording is played. Times are log times in ns.

    It plays from `start_ns` to `end_ns` and is at `log_ns`. `sent` messages were played. `loops` is
    which round of a loop it is, from 1; 0 if it does not loop. `late_ns` is by how much it is
    behind in all, if the machine is too slow for the rate.
    """

    start_ns: int
    end_ns: int
    log_ns: int
    rate: float = 1.0
    is_paused: bool = False
    is_at_end: bool = False
    sent: int = 0
    loops: int = 0
    late_ns: int = 0

    @property
    def played_s(self) -> float:
        """The seconds of the recording before the present moment."""
        return (self.log_ns - self.start_ns) / 1e9

    @property
    def duration_s(self) -> float:
        """The seconds of the recording that are played in all."""
        return (self.end_ns - self.start_ns) / 1e9


class Stage(Protocol):
    """The place that a recording is played to. All calls come from the thread of `Player.run`."""

    def begin(self, state: Sequence[Item], pace: Pace, *, is_back: bool) -> None:
        """Playing begins at a moment with this state; `is_back` if it is earlier than what was
        played before.
        """

    def take(self, item: Item, pace: Pace) -> None:
        """An item, at its time."""

    def follow(self, progress: Progress) -> None:
        """It was paused, resumed, or has another rate, or has come to its end."""


class Player:
    """Plays what a recording has of `selection` from `start_ns` to `end_ns`, log times in ns.

    If it begins or is sought to, the last message so far on each of the topics `lasting` belongs
    to the state, as static transforms do: it holds until the next, as a simulated time does. The
    last dynamic transforms of `look_back_s` before that belong to it, too, with their log times.

    Its methods may be called from any thread, before and while it runs. Raises
    InvalidArgumentException for a rate that is not between 0.001 and 10,000, or if nothing lies
    between start and end.
    """

    def __init__(
        self,
        source: Source,
        *,
        selection: Selection = ALL,
        start_ns: int | None = None,
        end_ns: int | None = None,
        rate: float = 1.0,
        paused: bool = False,
        at_end: AtEnd = "stop",
        lasting: Sequence[str] = (),
        look_back_s: float = 0.0,
        real_ns: Callable[[], int] = lambda: scheduler.monotonic_ns(),
        wall_ns: Callable[[], int] = lambda: scheduler.time_ns(),
    ) -> None:
        self._source = source
        self._selection = selection
        self._start_ns = source.start_ns if start_ns is None else max(start_ns, source.start_ns)
        self._end_ns = source.end_ns if end_ns is None else min(end_ns, source.end_ns)
        if self._end_ns < self._start_ns:
            raise InvalidArgumentException(
                "there is nothing to play between start and end: the recording lasts "
                f"{(source.end_ns - source.start_ns) / 1e9:.3f} s"
            )
        self._at_end: AtEnd = at_end
        self._lasting = lasting
        self._look_back_ns = round(look_back_s * 1e9)
        self._real_ns, self._wall_ns = real_ns, wall_ns
        # Guards all that follows; notified at each change that `run` waits for.
        self._changed = scheduler.Condition()
        self._pace = Pace(self._start_ns, real_ns(), wall_ns(), _checked(rate))
        self._is_paused = paused
        self._pace_is_news = self._is_stopped = self._is_at_end = False
        self._seek_ns: int | None = None
        self._steps = 0
        # It has come no further than here: the item that is next, or that was last.
        self._reached_ns = self._start_ns
        self._sent = self._late_ns = 0
        self._loops = 1 if at_end == "loop" else 0

    # What others ask of it

    def pause(self) -> None:
        """Stand still; twice is fine."""
        with self._changed:
            self._set_paused(True)

    def resume(self) -> None:
        """Go on; twice is fine."""
        with self._changed:
            self._set_paused(False)

    def toggle_paused(self) -> None:
        """Stand still, or go on."""
        with self._changed:
            self._set_paused(not self._is_paused)

    def step(self, messages: int = 1) -> None:
        """Pause, and play this many messages more."""
        with self._changed:
            self._set_paused(True)
            self._steps += messages
            self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Play this many recorded seconds in a second, from now on.

        Raises InvalidArgumentException if it is not between 0.001 and 10,000.
        """
        with self._changed:
            self._anchor(self._played_ns(), _checked(rate))
            self._tell()

    def seek(self, log_ns: int) -> None:
        """Go on from this moment of the recording; from start or end if it is not between."""
        with self._changed:
            self._seek_ns = min(max(log_ns, self._start_ns), self._end_ns)
            self._steps = 0
            self._changed.notify_all()

    def seek_by(self, offset_s: float) -> None:
        """Go on this many seconds later, or earlier if it is negative."""
        with self._changed:
            self.seek(self._position_ns() + round(offset_s * 1e9))

    def stop(self) -> None:
        """Make `run` return; twice is fine."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    @property
    def progress(self) -> Progress:
        """How far it is."""
        with self._changed:
            return Progress(
                self._start_ns,
                self._end_ns,
                self._position_ns(),
                self._pace.rate,
                self._is_paused,
                self._is_at_end,
                self._sent,
                self._loops,
                self._late_ns,
            )

    # Playing

    def run(self, stage: Stage) -> None:
        """Play to the end, or until `stop`. Raises what reading the recording raises."""
        at_ns, is_back = self._start_ns, False
        while True:
            state = in_force(
                self._source, at_ns, self._selection, self._lasting, self._look_back_ns
            )
            items = self._source.items(at_ns, self._end_ns, self._selection)
            with ReadAhead(items, self._changed) as ahead:
                self._begin(stage, state, at_ns, is_back)
                jump = self._play(stage, ahead)
            if jump is None:
                return
            at_ns, is_back = jump

    def _begin(self, stage: Stage, state: list[Item], at_ns: int, is_back: bool) -> None:
        with self._changed:
            self._reached_ns = at_ns
            self._anchor(at_ns)
            pace = self._pace
        stage.begin(state, pace, is_back=is_back)
        with self._changed:
            # That may have taken a moment.
            self._anchor(at_ns)

    def _play(self, stage: Stage, ahead: ReadAhead) -> tuple[int, bool] | None:
        """Play to the end of `ahead`: where to go on, and whether that is back; None to end."""
        while True:
            with self._changed:
                if self._is_stopped:
                    return None
                if self._seek_ns is not None:
                    next_ns, self._seek_ns = self._seek_ns, None
                    is_back = next_ns < self._played_ns() or self._is_at_end
                    self._is_at_end = False
                    return next_ns, is_back
                is_news, self._pace_is_news = self._pace_is_news, False
                if not is_news and self._has_ended(ahead):
                    is_here, self._is_at_end = self._is_at_end, True
                    if self._at_end == "stop" or (self._at_end == "loop" and not self._sent):
                        return None
                    if self._at_end == "loop" and not self._is_paused:
                        self._loops += 1
                        self._is_at_end = False
                        return self._start_ns, True
                    is_news = not (is_here and self._is_paused)
                    if not self._is_paused:
                        self._anchor(self._end_ns)
                    self._is_paused = True
                item = None if is_news else self._next(ahead)
                if item is None and not is_news:
                    self._changed.wait(self._left_s(ahead))
                    continue
                pace = self._pace
            if item is not None:
                stage.take(item, pace)
            else:
                stage.follow(self.progress)

    def _has_ended(self, ahead: ReadAhead) -> bool:
        if not ahead.is_at_end:
            return False
        self._reached_ns = self._end_ns
        return self._is_due(self._end_ns)

    def _next(self, ahead: ReadAhead) -> Item | None:
        """The item to play now; None if it is not time yet."""
        first = ahead.first()
        if first is None:
            return None
        self._reached_ns = max(first.log_ns, self._pace.log_ns)
        is_message = not isinstance(first, EventItem)
        if self._is_paused:
            if not self._steps:
                return None
            self._steps -= is_message
            self._anchor(self._reached_ns)
        elif not self._is_due(first.log_ns):
            return None
        self._sent += is_message
        return ahead.take()

    def _is_due(self, log_ns: int) -> bool:
        if self._is_paused:
            # What is left of the last step.
            return self._pace.log_ns >= log_ns
        late_ns = self._real_ns() - self._pace.real_at(log_ns)
        if late_ns > _MOST_LATE_NS:
            self._late_ns += late_ns
            self._anchor(max(log_ns, self._pace.log_ns))
        return late_ns >= 0

    def _left_s(self, ahead: ReadAhead) -> float | None:
        """How long to wait for the next item, or the end; None until something changes."""
        first = ahead.first()
        if self._is_paused or (first is None and not ahead.is_at_end):
            return None
        due_ns = self._end_ns if first is None else first.log_ns
        left_s = max(self._pace.real_at(due_ns) - self._real_ns(), 0) / 1e9
        return min(left_s, scheduler.TIMEOUT_MAX)

    # With the lock held

    def _position_ns(self) -> int:
        return self._played_ns() if self._seek_ns is None else self._seek_ns

    def _played_ns(self) -> int:
        """How far it has played, whatever seek is to come."""
        if self._is_paused:
            return self._pace.log_ns
        return max(min(self._pace.log_at(self._real_ns()), self._reached_ns), self._pace.log_ns)

    def _anchor(self, log_ns: int, rate: float | None = None) -> None:
        """From now on the time goes on from here."""
        rate = self._pace.rate if rate is None else rate
        self._pace = Pace(log_ns, self._real_ns(), self._wall_ns(), rate)

    def _set_paused(self, is_paused: bool) -> None:
        if is_paused is self._is_paused:
            return
        self._anchor(self._played_ns())
        self._is_paused = is_paused
        self._steps = 0
        self._tell()

    def _tell(self) -> None:
        self._pace_is_news = True
        self._changed.notify_all()


def _checked(rate: float) -> float:
    if not SLOWEST <= rate <= FASTEST:
        raise InvalidArgumentException(
            f"the rate must be from {SLOWEST:g} to {FASTEST:,.0f}, not {rate:g}"
        )
    return rate
