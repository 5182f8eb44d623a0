"""A limit of how many transforms of a frame cross in a second: the newest goes."""

import threading
from collections.abc import Callable

from tfbus.bridge.routes import chosen
from tfbus.geometry.columns import Columns
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.runtime.timer import Timer

# Frames come from the network: at most this many are remembered.
_MOST_FRAMES = 100_000


class RateLimit:
    """Passes rows on to `send(rows)`, of each child frame one in `1 / rate_hz` seconds at most.

    A transform that comes too soon goes at the end of that time, unless a newer one has come. Safe
    from any thread; `send` is called by that of `take` or the executor's.
    """

    def __init__(
        self,
        rate_hz: float,
        send: Callable[[Columns], object],
        executor: Executor,
        clock_s: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self._period_s = 1.0 / rate_hz
        self._send = send
        self._clock_s = clock_s
        self._lock = threading.Lock()
        self._free_s: dict[str, float] = {}
        self._waiting: dict[str, tuple[Columns, int]] = {}
        self._executor = executor
        # While something waits.
        self._timer: Timer | None = None
        self._is_closed = False

    def take(self, rows: Columns) -> None:
        """Pass on the rows that may go now."""
        now_s, frames = self._clock_s(), rows.frames
        with self._lock:
            if len(self._free_s) > _MOST_FRAMES:
                self._free_s.clear()
            ready: dict[str, int] = {}
            for at, (_, child) in enumerate(rows.pairs()):
                if now_s < self._free_s.get(frames[child], now_s):
                    self._waiting[frames[child]] = rows, at
                else:
                    ready[frames[child]] = at
            self._note(ready, now_s)
            if self._waiting and self._timer is None and not self._is_closed:
                # Often enough that one which waits goes soon after its time.
                self._timer = self._executor.every(self._period_s / 2, self.flush)
        if ready:
            self._send(chosen(rows, [*ready.values()]))

    def flush(self) -> None:
        """Pass on what has waited long enough."""
        now_s = self._clock_s()
        with self._lock:
            ready = {
                child: row
                for child, row in self._waiting.items()
                if now_s >= self._free_s.get(child, now_s)
            }
            self._note(ready, now_s)
            if not self._waiting:
                self._stop()
        of: dict[int, tuple[Columns, list[int]]] = {}
        for rows, at in ready.values():
            of.setdefault(id(rows), (rows, []))[1].append(at)
        for rows, which in of.values():
            self._send(chosen(rows, which))

    def close(self) -> None:
        """Pass on nothing more. Twice is fine."""
        with self._lock:
            self._is_closed = True
            self._waiting.clear()
            self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _note(
        self, children: "dict[str, int] | dict[str, tuple[Columns, int]]", now_s: float
    ) -> None:
        for child in children:
            self._free_s[child] = now_s + self._period_s
            self._waiting.pop(child, None)
