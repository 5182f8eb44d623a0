"""Clocks: the system's, and a simulated one that stands still between calls of `set`; and timers.

A clock has two readings. `now_ns` is the time of stamps; it may jump. `elapsed_ns` is how long the
clock has run, and never goes back: timers and timeouts count by it, and have as much left after a
jump back as before it.
"""

from abc import abstractmethod
from collections.abc import Callable, Coroutine
from contextlib import suppress
from operator import attrgetter
from typing import Any

from tfbus.base import scheduler
from tfbus.base.arguments import check_plain
from tfbus.base.callbacks import OWN, CallbackGroup, ExecutorEnd, here

Wake = Callable[[], object]
Jumped = Callable[[int], None]

# Later than any stamp.
_NEVER_NS = 2**63


class Bell:
    """A bell that one thread sleeps on until another rings it: an Event whose `ring` may interrupt
    its own `wait`, as in a signal handler.
    """

    __slots__ = ("_silent",)

    def __init__(self) -> None:
        self._silent = scheduler.Lock()
        self._silent.acquire()

    def ring(self) -> None:
        """End the `wait` of now, or else the next one."""
        try:  # noqa: SIM105  # `suppress` would be a third of this
            self._silent.release()
        except RuntimeError:
            pass

    def wait(self, timeout_s: float | None) -> None:
        """Sleep until it is rung, at most this long; None: for as long as it takes."""
        if timeout_s is None or timeout_s > scheduler.TIMEOUT_MAX:
            timeout_s = scheduler.TIMEOUT_MAX
        self._silent.acquire(timeout=timeout_s if timeout_s > 0.0 else 0.0)


class LoopBell:
    """A bell that a coroutine sleeps on until any thread rings it; of the event loop that runs."""

    def __init__(self) -> None:
        import asyncio  # slow to import, and it runs already

        self._loop, self._rung = asyncio.get_running_loop(), asyncio.Event()
        self._timeout = asyncio.timeout

    def ring(self) -> None:
        """End the `wait` of now, or else the next one; if the loop is closed nothing waits."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._rung.set)

    async def wait(self, timeout_s: float | None) -> None:
        """Sleep until it is rung, at most this long; None: for as long as it takes."""
        with suppress(TimeoutError):
            async with self._timeout(timeout_s):
                await self._rung.wait()
        self._rung.clear()


class Limit:
    """The end of a wait by one clock; it is in force until the end of its `with`.

    `left_s` is how many real seconds to sleep before looking at `passed` again; None if only
    the `wake` of the limit ends the sleep, or nothing does.
    """

    @property
    @abstractmethod
    def passed(self) -> bool:
        """Whether the wait is over."""

    @property
    def cut_short(self) -> bool:
        """Whether it has passed only because the clock was closed."""
        return False

    @property
    @abstractmethod
    def left_s(self) -> float | None:
        """Real seconds to sleep at most; None: until woken."""

    def __enter__(self) -> "Limit":
        return self

    def __exit__(self, *_: object) -> None:
        """Take back the `wake`."""


class Clock:
    """A clock; a call of it returns `now_ns()`."""

    is_simulated = False

    def __call__(self) -> int:
        return self.now_ns()

    @abstractmethod
    def now_ns(self) -> int:
        """The time now, in nanoseconds since the Unix epoch."""

    @abstractmethod
    def elapsed_ns(self) -> int:
        """How long the clock has run, in nanoseconds from an arbitrary start; never goes back."""

    @property
    def is_running(self) -> bool:
        """Whether its time is known: False for a simulated clock that was never set."""
        return True

    def close(self) -> None:
        """End all waits by a simulated clock: every limit has passed. Twice is fine."""

    def call_when_running(self, wake: Wake) -> None:
        """Call `wake()` once, as soon as the clock runs."""
        wake()

    @abstractmethod
    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        """A limit `timeout_s` of this clock's seconds from now, None for no limit.

        A simulated clock calls `wake()` when it has passed, on the thread that sets the clock;
        `wake` returns at once. With the system's clock, sleep for `left_s`.
        """

    def add_jump_callback(self, callback: Jumped) -> None:
        """Call `callback(now_ns)` after each jump back of a simulated clock, on the thread that
        sets it.
        """
        check_plain("add_jump_callback(callback)", callback)

    def remove_jump_callback(self, callback: Jumped) -> None:
        """Take the callback back; twice is fine."""


class SystemClock(Clock):
    """The system's time; the seconds of its limits are by its monotonic clock."""

    def now_ns(self) -> int:
        return scheduler.time_ns()

    def elapsed_ns(self) -> int:
        return scheduler.monotonic_ns()

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        return _RealLimit(timeout_s)


class _RealLimit(Limit):
    def __init__(self, timeout_s: float | None) -> None:
        self._deadline_s = None if timeout_s is None else scheduler.monotonic() + timeout_s

    @property
    def passed(self) -> bool:
        return self._deadline_s is not None and scheduler.monotonic() >= self._deadline_s

    @property
    def left_s(self) -> float | None:
        if self._deadline_s is None:
            return None
        return min(max(0.0, self._deadline_s - scheduler.monotonic()), scheduler.TIMEOUT_MAX)


SYSTEM_CLOCK = SystemClock()


class Alarm:
    """Calls `wake` when a simulated clock has run for `due_ns`."""

    __slots__ = ("due_ns", "wake")

    def __init__(self, due_ns: int, wake: Wake) -> None:
        self.due_ns = due_ns
        self.wake = wake


class SimulatedClock(Clock):
    """A clock whose time is from the last `set`.

    Before the first `set`, `now_ns()` is 0 and waits by this clock do not end. A jump forward is
    time that has passed. A jump back takes no time: waits have as much left as before. Safe from
    any thread.
    """

    is_simulated = True

    def __init__(self) -> None:
        self._lock = scheduler.Lock()
        self._now_ns = 0
        # -1 before the first `set`, so that an alarm at 0 waits for that.
        self._elapsed_ns = -1
        self._alarms: dict[Alarm, None] = {}
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
        """Set the time, in ns since the Unix epoch; by how much it jumped back in ns, usually 0."""
        with self._lock:
            step_ns = now_ns - self._now_ns if self.is_running else 0
            self._elapsed_ns = max(0, self._elapsed_ns) + max(0, step_ns)
            self._now_ns = now_ns
            due = self._take_due()
            callbacks = self._jump_callbacks if step_ns < 0 else []
        # Callbacks forget samples that are in the future now, before waits can look them up.
        for callback in callbacks:
            callback(now_ns)
        for alarm in due:
            alarm.wake()
        return max(0, -step_ns)

    def close(self) -> None:
        with self._lock:
            self._closed = True
            alarms, self._alarms = self._alarms, {}
        for alarm in alarms:
            alarm.wake()

    def limit(self, timeout_s: float | None, wake: Wake) -> Limit:
        return _SimulatedLimit(self, timeout_s, wake)

    def call_when_running(self, wake: Wake) -> None:
        self.call_at(0, wake)

    def call_at(self, elapsed_ns: int, wake: Wake) -> Alarm:
        """Call `wake()` once the clock has run for `elapsed_ns`; 0 is the first `set`."""
        alarm = Alarm(elapsed_ns, wake)
        with self._lock:
            is_due = self._has_come(elapsed_ns)
            if not is_due:
                self._alarms[alarm] = None
                if self._next_due_ns is None or elapsed_ns < self._next_due_ns:
                    self._next_due_ns = elapsed_ns
        if is_due:
            wake()
        return alarm

    def cancel(self, alarm: Alarm) -> None:
        """Take the alarm back; one that is being woken at this moment still wakes."""
        with self._lock:
            self._alarms.pop(alarm, None)

    def add_jump_callback(self, callback: Jumped) -> None:
        super().add_jump_callback(callback)
        with self._lock:
            self._jump_callbacks = [*self._jump_callbacks, callback]

    def remove_jump_callback(self, callback: Jumped) -> None:
        with self._lock:
            self._jump_callbacks = [other for other in self._jump_callbacks if other != callback]

    def _has_come(self, elapsed_ns: int) -> bool:
        return self._closed or self._elapsed_ns >= elapsed_ns

    def _take_due(self) -> list[Alarm]:
        """The alarms to wake, in the order of their time; hold the lock."""
        if self._next_due_ns is None or not self._has_come(self._next_due_ns):
            return []
        due = [alarm for alarm in self._alarms if self._has_come(alarm.due_ns)]
        for alarm in due:
            del self._alarms[alarm]
        self._next_due_ns = min((alarm.due_ns for alarm in self._alarms), default=None)
        return sorted(due, key=attrgetter("due_ns"))


class _SimulatedLimit(Limit):
    def __init__(self, clock: SimulatedClock, timeout_s: float | None, wake: Wake) -> None:
        self._clock = clock
        self._alarm = clock.call_at(_due_ns(clock.elapsed_ns(), timeout_s), wake)

    @property
    def passed(self) -> bool:
        return self._clock._has_come(self._alarm.due_ns)

    @property
    def cut_short(self) -> bool:
        return self._clock._closed and self._clock.elapsed_ns() < self._alarm.due_ns

    @property
    def left_s(self) -> float | None:
        return None

    def __exit__(self, *_: object) -> None:
        self._clock.cancel(self._alarm)


def _due_ns(elapsed_ns: int, timeout_s: float | None) -> int:
    if timeout_s is None or timeout_s * 1e9 >= _NEVER_NS:
        return _NEVER_NS
    return elapsed_ns + round(timeout_s * 1e9)


class _LimitInCallback(Limit):
    """A limit that has also passed when the executor of the thread closes."""

    def __init__(self, limit: Limit, closing: ExecutorEnd, wake: Wake) -> None:
        self._limit = limit
        self._closing = closing
        self._closing.wakes(self, wake)

    @property
    def passed(self) -> bool:
        return self._closing.has_begun or self._limit.passed

    @property
    def cut_short(self) -> bool:
        return self._limit.cut_short or (self._closing.has_begun and not self._limit.passed)

    @property
    def left_s(self) -> float | None:
        return self._limit.left_s

    def __exit__(self, *error: object) -> None:
        self._closing.forget(self)
        self._limit.__exit__(*error)


def limit_by(clock: Callable[[], int], timeout_s: float | None, wake: Wake) -> Limit:
    """A limit by the clock; in real seconds if it is another function of the time. In a callback
    of a node it ends with the node.
    """
    limit = (clock if isinstance(clock, Clock) else SYSTEM_CLOCK).limit(timeout_s, wake)
    return limit if here.closing is None else _LimitInCallback(limit, here.closing, wake)


class Pace:
    """Says when others are due to be asked again: every `every_s` real seconds."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._asked_s = -float("inf")

    def hurry(self) -> None:
        """It is due at once."""
        self._asked_s = -float("inf")

    def is_due(self) -> bool:
        """Whether it is time to ask again, which is noted."""
        now_s = scheduler.monotonic()
        if now_s - self._asked_s < self._every_s:
            return False
        self._asked_s = now_s
        return True


class Timer:
    """A callback that runs every `period_s` seconds until it is cancelled.

    Ticks that another callback held up are not made up for: the next one comes a whole number of
    periods after the first.
    """

    def __init__(
        self,
        period_s: float,
        callback: Callable[..., Any],
        *given: Any,
        once: bool = False,
        group: CallbackGroup | None = None,
    ):
        if not 0 < period_s < scheduler.TIMEOUT_MAX:
            raise ValueError(
                "a timer's period must be more than 0 s and less than "
                f"{scheduler.TIMEOUT_MAX:.0f} s, not {period_s}"
            )
        self.period_s = period_s
        self.period_ns = max(1, round(period_s * 1e9))
        self.callback = callback
        self.given = given
        self.once = once
        self.group = group
        self.cancelled = False
        self.what = timer_name(period_s, callback)
        # While a coroutine that the callback returned has not ended.
        self.is_awaited = False

    def fire(self) -> Any:
        """Run the callback, unless the coroutine of a former tick has not ended; returns its value,
        of a coroutine one to await in its place.
        """
        if self.is_awaited:
            return None
        answer = self.callback(*self.given)
        if answer is not None and isinstance(answer, Coroutine):
            self.is_awaited = True
            return self._until_ended(answer)
        return answer

    async def _until_ended(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        try:
            await coroutine
        finally:
            self.is_awaited = False

    def cancel(self) -> None:
        """End the timer; twice is fine."""
        self.cancelled = True


def timer_name(period_s: float, callback: Callable[..., Any]) -> str:
    """The name of a timer in the log: `timer of 50 ms (broadcast)`; with `OWN` in front of one of
    tfbus's own.
    """
    period = f"{period_s:g} s" if period_s >= 1.0 else f"{period_s * 1e3:g} ms"
    own = OWN if (getattr(callback, "__module__", None) or "").startswith("tfbus.") else ""
    return f"{own}timer of {period} ({getattr(callback, '__qualname__', repr(callback))})"
