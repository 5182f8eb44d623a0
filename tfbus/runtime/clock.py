"""Clocks: the system's, and a simulated one that stands still between the ticks it is told.

A clock has two readings. `now_ns` is the time that stamps are made of; it may jump. `elapsed_ns`
is how long the clock has run, and never goes back: timers and timeouts count by it, so that they
have as much left after a jump back as before it.
"""

import threading
import time
from collections.abc import Callable

Wake = Callable[[], object]
Jumped = Callable[[int], None]

# Later than stamps can tell.
_NEVER_NS = 2**63


class Limit:
    """How long somebody waits, by one clock; it ends with its `with`.

    `left_s` is how many real seconds to sleep before looking at `passed` again, None where
    nothing but the `wake` of the limit tells; None for ever where there is no limit at all.
    """

    @property
    def passed(self) -> bool:
        """Whether the wait is over."""
        raise NotImplementedError

    @property
    def left_s(self) -> float | None:
        """Real seconds to sleep at most, or None: until woken."""
        raise NotImplementedError

    def __enter__(self) -> "Limit":
        return self

    def __exit__(self, *_: object) -> None:
        """Wake nobody any more."""


class Clock:
    """What time it is; called, it answers `now_ns()`."""

    is_simulated = False

    def __call__(self) -> int:
        return self.now_ns()

    def now_ns(self) -> int:
        """The time now, in nanoseconds since the Unix epoch."""
        raise NotImplementedError

    def elapsed_ns(self) -> int:
        """How long the clock has run, in nanoseconds from a start of its own; never goes back."""
        raise NotImplementedError

    @property
    def is_running(self) -> bool:
        """Whether it is known what time it is."""
        return True

    def close(self) -> None:
        """End all waiting by a simulated clock: every limit has passed. Twice is fine."""

    def call_when_running(self, wake: Wake) -> None:
        """Call `wake()` once, as soon as it is known what time it is."""
        wake()

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        """A limit `timeout_s` of this clock's seconds from now, None for no limit.

        Where the clock is simulated, `wake()` is called from the thread that ticks when it has
        passed; it returns at once. With the system's clock, sleep for `left_s`.
        """
        raise NotImplementedError

    def add_jump_callback(self, callback: Jumped) -> None:
        """Call `callback(now_ns)` after each jump back of a simulated clock, where it ticks."""

    def remove_jump_callback(self, callback: Jumped) -> None:
        """Call it no more; twice is fine."""


class SystemClock(Clock):
    """The system's time; the seconds of its limits are those of its monotonic clock."""

    def now_ns(self) -> int:
        return time.time_ns()

    def elapsed_ns(self) -> int:
        return time.monotonic_ns()

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        return _RealLimit(timeout_s)


class _RealLimit(Limit):
    def __init__(self, timeout_s: float | None) -> None:
        self._deadline_s = None if timeout_s is None else time.monotonic() + timeout_s

    @property
    def passed(self) -> bool:
        return self._deadline_s is not None and time.monotonic() >= self._deadline_s

    @property
    def left_s(self) -> float | None:
        if self._deadline_s is None:
            return None
        return min(max(0.0, self._deadline_s - time.monotonic()), threading.TIMEOUT_MAX)


SYSTEM_CLOCK = SystemClock()


class Alarm:
    """Somebody to be woken when a simulated clock has run so long."""

    __slots__ = ("due_ns", "wake")

    def __init__(self, due_ns: int, wake: Wake) -> None:
        self.due_ns = due_ns
        self.wake = wake


class SimulatedClock(Clock):
    """A clock that is told the time by `set`, and stands still until it is told again.

    Before the first time `now_ns()` is 0 and nothing that waits by this clock goes on. A jump
    forward is time that has passed. A jump back takes no time: who waits has as much left to
    wait as before. Safe from any thread.
    """

    is_simulated = True

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._now_ns = 0
        # One less than nothing before the first time, so that an alarm at 0 waits for that.
        self._elapsed_ns = -1
        self._alarms: set[Alarm] = set()
        self._next_due_ns: int | None = None
        self._closed = False
        self._jump_callbacks: list[Jumped] = []

    def now_ns(self) -> int:
        return self._now_ns

    def elapsed_ns(self) -> int:
        return self._elapsed_ns

    @property
    def is_running(self) -> bool:
        return self._elapsed_ns >= 0

    def set(self, now_ns: int) -> int:
        """It is `now_ns` now; by how many nanoseconds the clock jumped back, usually 0."""
        with self._lock:
            step_ns = now_ns - self._now_ns if self.is_running else 0
            self._elapsed_ns = max(0, self._elapsed_ns) + max(0, step_ns)
            self._now_ns = now_ns
            due = self._take_due()
            callbacks = self._jump_callbacks if step_ns < 0 else []
        # What lies in the future is forgotten before anybody looks for it.
        for callback in callbacks:
            callback(now_ns)
        for alarm in due:
            alarm.wake()
        return max(0, -step_ns)

    def close(self) -> None:
        with self._lock:
            self._closed = True
            alarms, self._alarms = self._alarms, set()
        for alarm in alarms:
            alarm.wake()

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        return _SimulatedLimit(self, timeout_s, wake)

    def call_when_running(self, wake: Wake) -> None:
        self.call_at(0, wake)

    def call_at(self, elapsed_ns: int, wake: Wake) -> Alarm:
        """Call `wake()` once, as soon as the clock has run so long; 0 is its first time."""
        alarm = Alarm(elapsed_ns, wake)
        with self._lock:
            is_due = self._has_come(elapsed_ns)
            if not is_due:
                self._alarms.add(alarm)
                if self._next_due_ns is None or elapsed_ns < self._next_due_ns:
                    self._next_due_ns = elapsed_ns
        if is_due:
            wake()
        return alarm

    def cancel(self, alarm: Alarm) -> None:
        """Do not wake it; one that is being woken at this moment still is."""
        with self._lock:
            self._alarms.discard(alarm)

    def add_jump_callback(self, callback: Jumped) -> None:
        with self._lock:
            self._jump_callbacks = [*self._jump_callbacks, callback]

    def remove_jump_callback(self, callback: Jumped) -> None:
        with self._lock:
            self._jump_callbacks = [other for other in self._jump_callbacks if other != callback]

    def _has_come(self, elapsed_ns: int) -> bool:
        return self._closed or self._elapsed_ns >= elapsed_ns

    def _take_due(self) -> list[Alarm]:
        """The alarms to wake, in the order of their time; held with the lock."""
        if self._next_due_ns is None or not self._has_come(self._next_due_ns):
            return []
        due = [alarm for alarm in self._alarms if self._has_come(alarm.due_ns)]
        self._alarms.difference_update(due)
        self._next_due_ns = min((alarm.due_ns for alarm in self._alarms), default=None)
        return sorted(due, key=lambda alarm: alarm.due_ns)


class _SimulatedLimit(Limit):
    def __init__(self, clock: SimulatedClock, timeout_s: float | None, wake: Wake) -> None:
        self._clock = clock
        self._alarm = clock.call_at(_due_ns(clock.elapsed_ns(), timeout_s), wake)

    @property
    def passed(self) -> bool:
        return self._clock._has_come(self._alarm.due_ns)

    @property
    def left_s(self) -> float | None:
        return None

    def __exit__(self, *_: object) -> None:
        self._clock.cancel(self._alarm)


def _due_ns(elapsed_ns: int, timeout_s: float | None) -> int:
    if timeout_s is None or timeout_s * 1e9 >= _NEVER_NS:
        return _NEVER_NS
    return elapsed_ns + round(timeout_s * 1e9)


def limit_by(clock: Callable[[], int], timeout_s: float | None, wake: Wake) -> Limit:
    """A limit by the clock, or in real seconds where it is any other function of the time."""
    return (clock if isinstance(clock, Clock) else SYSTEM_CLOCK).limit(timeout_s, wake)
