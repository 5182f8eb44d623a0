"""The playhead of a recording: play, pause, seek, step, rate and loop, by a clock that pauses.

`tfbus bag play` and Foxglove's playback move it with a `Player`, which plays each item at its time;
the page of `tfbus view` asks with each picture how far it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from tfbus.base import scheduler
from tfbus.base.clock import SYSTEM_CLOCK, Clock
from tfbus.base.errors import InvalidArgumentException
from tfbus.recording.items import ALL, Item, Selection
from tfbus.recording.state import ItemsInOrder, last_item

SLOWEST, FASTEST = 1e-3, 1e4

# The behaviour at the end: return from `Player.run`, begin again, or wait for a seek.
AtEnd = Literal["stop", "loop", "wait"]

# Stamps of transforms and messages: moved to the time of now, or as they were recorded.
Stamps = Literal["now", "recorded"]


class PausableClock:
    """A monotonic clock that can be paused: a call returns nanoseconds from an arbitrary start.
    Calls are safe from any thread.
    """

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self._real_ns = clock.elapsed_ns
        self._paused_ns = 0
        self._stands_at_ns: int | None = None

    def __call__(self) -> int:
        stands_at_ns = self._stands_at_ns
        return self._real_ns() - self._paused_ns if stands_at_ns is None else stands_at_ns

    def pause(self, is_paused: bool) -> None:
        """Stand still from now on, or go on; twice is fine."""
        if is_paused and self._stands_at_ns is None:
            self._stands_at_ns = self()
        elif not is_paused and self._stands_at_ns is not None:
            self._paused_ns = self._real_ns() - self._stands_at_ns
            self._stands_at_ns = None


@dataclass(frozen=True)
class Pace:
    """How the time of the recording goes with the real one: at `log_ns` it was `real_ns` of the
    playhead's clock and `wall_ns` of the system's, and since then `rate` recorded seconds pass in a
    second.
    """

    log_ns: int
    real_ns: int
    wall_ns: int
    rate: float = 1.0

    def log_at(self, real_ns: int) -> int:
        """The time in the recording at a time of the playhead's clock, both in ns."""
        return self.log_ns + round((real_ns - self.real_ns) * self.rate)

    def real_at(self, log_ns: int) -> int:
        """The time of the playhead's clock at a time in the recording."""
        past_ns = log_ns - self.log_ns
        # Without rounding where there is nothing to round.
        return self.real_ns + (past_ns if self.rate == 1.0 else round(past_ns / self.rate))


@dataclass(frozen=True)
class Progress:
    """How far a recording is played. Times are log times in ns.

    It plays from `start_ns` to `end_ns` and is at `log_ns`. `sent` messages were played, without
    static transforms, which repeat. `loops` is which round of a loop it is, from 1; 0 if it does
    not loop. `late_ns` is by how much it is behind in all, if the machine is too slow for the rate.
    It `is_at_end` if it stands there.
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


class Playhead:
    """The moment of a recording that is played, from `start_ns` to `end_ns`, and at which rate;
    `at_ns` at first, in log times. Safe from any thread.

    It goes by what the `clock` has run, and stamps by the clock's time. `jumps` counts the changes
    that nobody can foresee from the progress before. Raises InvalidArgumentException for a rate
    that is not between 0.001 and 10,000.
    """

    def __init__(
        self,
        start_ns: int,
        end_ns: int,
        *,
        at_ns: int | None = None,
        rate: float = 1.0,
        paused: bool = False,
        at_end: AtEnd = "wait",
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.start_ns, self.end_ns = start_ns, end_ns
        # It stands while the recording is paused.
        self.clock = PausableClock(clock)
        self.clock.pause(paused)
        self._wall_ns = clock.now_ns
        self._unless_looped: AtEnd = "wait" if at_end == "loop" else at_end
        # Guards all that follows; notified at each change that a player waits for.
        self.changed = scheduler.Condition()
        self.jumps = 0
        self._at_end: AtEnd = at_end
        at_ns = start_ns if at_ns is None else self._within(at_ns)
        self._pace = Pace(at_ns, self.clock(), self._wall_ns(), _checked(rate))
        self._is_paused = paused
        self._pace_is_news = self._is_at_end = False
        self._steps = 0
        # It has come no further than here: the item that is next, or that was last.
        self._reached_ns = end_ns
        self._sent = self._late_ns = 0
        self._loops = 1 if at_end == "loop" else 0

    # The commands

    def pause(self) -> None:
        """Stand still; twice is fine."""
        with self.changed:
            self._set_paused(True)

    def resume(self) -> None:
        """Go on, at the end from the beginning; twice is fine."""
        with self.changed:
            if self._is_paused and self._at_end != "stop" and self._position_ns() >= self.end_ns:
                self.seek(self.start_ns)
            self._set_paused(False)

    def toggle_paused(self) -> None:
        """Stand still, or go on."""
        with self.changed:
            (self.resume if self._is_paused else self.pause)()

    def step(self, messages: int = 1) -> None:
        """Pause, and go this many messages further, or back if fewer than 0."""
        with self.changed:
            self._set_paused(True)
            self._steps += messages
            self._jump()

    def set_rate(self, rate: float) -> None:
        """Play this many recorded seconds in a second, from now on.

        Raises InvalidArgumentException if it is not between 0.001 and 10,000.
        """
        with self.changed:
            self._anchor(self._played_ns(), _checked(rate))
            self._pace_is_news = True
            self._jump()

    def seek(self, log_ns: int, *, paused: bool | None = None) -> None:
        """Go on from this moment of the recording; from start or end if it is not between. With
        `paused` stand there, or go on, else as before.
        """
        with self.changed:
            self._go_to(self._within(log_ns))
            if paused is not None:
                self._set_paused(paused)
            self._steps = 0
            self._jump()

    def seek_by(self, offset_s: float) -> None:
        """Go on this many seconds later, or earlier if it is negative."""
        with self.changed:
            self.seek(self._position_ns() + round(offset_s * 1e9))

    def loop(self, loops: bool) -> None:
        """Begin again at the end, or as if it had never been told to."""
        with self.changed:
            self._at_end = "loop" if loops else self._unless_looped
            self._loops = max(self._loops, 1) if loops else 0
            self._jump()

    @property
    def progress(self) -> Progress:
        """How far it is."""
        with self.changed:
            log_ns = self._position_ns()
            return Progress(
                self.start_ns,
                self.end_ns,
                log_ns,
                self._pace.rate,
                self._is_paused,
                self._is_paused and log_ns >= self.end_ns,
                self._sent,
                self._loops,
                self._late_ns,
            )

    # For a page that asks with each picture, and shows the recording there

    def take_steps(self) -> int:
        """How many messages to go further, or back, since this was last asked."""
        with self.changed:
            steps, self._steps = self._steps, 0
            return steps

    def advance(self) -> Progress:
        """Go where the commands and the clock say; the progress then."""
        with self.changed:
            if self._played_ns() >= self.end_ns:
                # Of an empty span there is only the one moment.
                self._arrive(can_loop=self.end_ns > self.start_ns)
            return self.progress

    # With the lock held

    def _within(self, log_ns: int) -> int:
        return min(max(log_ns, self.start_ns), self.end_ns)

    def _go_to(self, log_ns: int, *, since_ns: int | None = None) -> None:
        """Go there: it has been there since this time of the clock, or is from now on."""
        self._is_at_end = False
        self._anchor(log_ns)
        if since_ns is not None:
            self._pace = replace(self._pace, real_ns=since_ns)

    def _position_ns(self) -> int:
        """The log time at which it is, or is about to be."""
        return self._played_ns()

    def _played_ns(self) -> int:
        """How far it has played."""
        if self._is_paused:
            return self._pace.log_ns
        return max(min(self._pace.log_at(self.clock()), self._reached_ns), self._pace.log_ns)

    def _anchor(self, log_ns: int, rate: float | None = None) -> None:
        """From now on the time goes on from here."""
        rate = self._pace.rate if rate is None else rate
        self._pace = Pace(log_ns, self.clock(), self._wall_ns(), rate)

    def _set_paused(self, is_paused: bool) -> None:
        if is_paused is self._is_paused:
            return
        self._anchor(self._played_ns())
        self._is_paused = is_paused
        self.clock.pause(is_paused)
        self._steps = 0
        self._pace_is_news = True
        self._jump()

    def _arrive(self, *, can_loop: bool) -> None:
        """It has come to its end: begin again, or stand there."""
        self._is_at_end = True
        if self._is_paused:
            return
        if self._at_end == "loop" and can_loop:
            self._loops += 1
            # Whoever asks late does not delay it.
            self._go_to(self.start_ns, since_ns=self._pace.real_at(self.end_ns))
            self._jump()
        else:
            self._anchor(self.end_ns)
            self._set_paused(True)

    def _jump(self) -> None:
        self.jumps += 1
        self.changed.notify_all()


def stepped_ns(
    source: ItemsInOrder,
    playhead: Playhead,
    steps: int,
    is_message: Callable[[Item], bool],
    selection: Selection = ALL,
) -> int | None:
    """The log time of the message this many after the playhead, or before it if that is negative,
    and of the last there is if they are fewer; None if there is none.
    """
    at_ns, found_ns = playhead.progress.log_ns, None
    for _ in range(abs(steps)):
        item = (
            next(filter(is_message, source.items(at_ns + 1, playhead.end_ns, selection)), None)
            if steps > 0
            else last_item(source, playhead.start_ns, at_ns - 1, selection, is_message)
        )
        if item is None:
            break
        at_ns = found_ns = item.log_ns
    return found_ns


def nearest_rate(rate: float) -> float:
    """The rate from 0.001 to 10,000 that is nearest to this one."""
    return min(max(rate, SLOWEST), FASTEST)


def _checked(rate: float) -> float:
    if not SLOWEST <= rate <= FASTEST:
        raise InvalidArgumentException(
            f"the rate must be from {SLOWEST:g} to {FASTEST:,.0f}, not {rate:g}"
        )
    return rate
