"""One thread that runs callbacks one at a time, so that they need no locks."""

import heapq
import itertools
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from functools import partial

from tfbus.runtime.clock import SimulatedClock
from tfbus.wording import counted

Callback = Callable[[], None]

# The end of a node waits at most this long for a callback; one in a lookup may take longer.
_LAST_CALLBACK_S = 2.0


class Timer:
    """A callback that runs every `period_s` seconds until it is cancelled.

    Ticks that another callback held up are not made up for: the next one comes a whole number of
    periods after the first. With `once` there is only the first.
    """

    def __init__(self, period_s: float, callback: Callback, *, once: bool = False):
        if not 0 < period_s < threading.TIMEOUT_MAX:
            raise ValueError(
                "a timer's period must be more than 0 s and less than "
                f"{threading.TIMEOUT_MAX:.0f} s, not {period_s}"
            )
        self.period_s = period_s
        self.period_ns = max(1, round(period_s * 1e9))
        self.callback = callback
        self.once = once
        self.cancelled = False

    def cancel(self) -> None:
        """End the timer; twice is fine."""
        self.cancelled = True


class Executor:
    """Runs callbacks in the order of their submission; a timer is submitted when it is due.

    The thread starts with the first callback. Exceptions of a callback are counted; the first,
    tenth, hundredth ... is logged with its traceback, and the thread continues.
    """

    def __init__(self, name: str, log: logging.Logger):
        self._name = name
        self._log = log
        self._changed = threading.Condition()
        self._waiting: deque[tuple[str, Callback]] = deque()
        self._due: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._running = ""
        self._failures: Counter[str] = Counter()

    def submit(self, what: str, callback: Callback, *, limit: int | None = None) -> bool:
        """Run `callback` after those submitted before; `what` names it in the log.

        False where `limit` callbacks of this name wait already: then it does not run.
        """
        with self._changed:
            if limit is not None and self._count_waiting(what) >= limit:
                return False
            if not self._closed:
                self._waiting.append((what, callback))
                self._wake()
            return True

    def every(self, period_s: float, callback: Callback) -> Timer:
        """Run `callback` every `period_s` seconds, the first time after one period."""
        return self._start(Timer(period_s, callback))

    def every_simulated(self, clock: SimulatedClock, period_s: float, callback: Callback) -> Timer:
        """Run `callback` every `period_s` seconds of a simulated clock, as `every` does."""
        timer = Timer(period_s, callback)
        self._set_alarm(clock, clock.elapsed_ns() + timer.period_ns, timer)
        return timer

    def after(self, delay_s: float, callback: Callback) -> Timer:
        """Run `callback` once, `delay_s` seconds from now."""
        return self._start(Timer(delay_s, callback, once=True))

    def close(self) -> None:
        """Run no further callbacks; the current one has 2 s to finish."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._changed.notify_all()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_LAST_CALLBACK_S)
            if thread.is_alive():
                self._log.warning("Closed while a callback still runs: %s", self._running)

    def _count_waiting(self, what: str) -> int:
        return sum(name == what for name, _ in self._waiting)

    def _start(self, timer: Timer) -> Timer:
        with self._changed:
            self._schedule(time.monotonic() + timer.period_s, timer)
            self._wake()
        return timer

    def _wake(self) -> None:
        if self._thread is None and not self._closed:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        self._changed.notify_all()

    def _schedule(self, when: float, timer: Timer) -> None:
        heapq.heappush(self._due, (when, next(self._order), timer))

    def _run(self) -> None:
        while (task := self._next()) is not None:
            self._call(*task)

    def _next(self) -> tuple[str, Callback] | None:
        """Wait for the next callback to run; None when closed."""
        with self._changed:
            while not self._closed:
                now = time.monotonic()
                self._queue_due_timers(now)
                if self._waiting:
                    return self._waiting.popleft()
                self._changed.wait(self._due[0][0] - now if self._due else None)
            return None

    def _queue_due_timers(self, now: float) -> None:
        # Behind what waits already: a timer slower than its period does not hold up the rest.
        while self._due and self._due[0][0] <= now:
            when, _, timer = heapq.heappop(self._due)
            self._waiting.append((_name(timer), partial(self._tick, when, timer)))

    def _set_alarm(self, clock: SimulatedClock, when_ns: int, timer: Timer) -> None:
        tick = partial(self._tick_simulated, clock, when_ns, timer)
        clock.call_at(when_ns, lambda: self.submit(_name(timer), tick))

    def _tick_simulated(self, clock: SimulatedClock, when_ns: int, timer: Timer) -> None:
        if not timer.cancelled:
            late_periods = (clock.elapsed_ns() - when_ns) // timer.period_ns
            self._set_alarm(clock, when_ns + (late_periods + 1) * timer.period_ns, timer)
            timer.callback()

    def _tick(self, when: float, timer: Timer) -> None:
        if timer.cancelled:
            return
        if timer.once:
            timer.cancel()
        else:
            late_periods = int((time.monotonic() - when) / timer.period_s)
            with self._changed:
                self._schedule(when + (late_periods + 1) * timer.period_s, timer)
        timer.callback()

    def _call(self, what: str, callback: Callback) -> None:
        self._running = what
        try:
            callback()
        except Exception:
            self._failures[what] += 1
            count = self._failures[what]
            if str(count).strip("0") == "1":  # a power of ten
                self._log.exception(
                    "A callback failed, %s so far (%s)", counted(count, "time"), what
                )


def _name(timer: Timer) -> str:
    callback = getattr(timer.callback, "__qualname__", repr(timer.callback))
    return f"timer of {timer.period_s:g} s, {callback}"
