"""Log lines that could repeat without end: the first of a kind is logged, the rest counted."""

import logging
import math
from collections import Counter
from collections.abc import Callable, Hashable

from tfbus.runtime import scheduler

# Kinds may hold names from the bus: where there are this many, the oldest makes room once its line
# is as old as this. Until then further kinds are neither logged nor counted.
_MOST_KINDS = 1000
_MAKES_ROOM_AFTER_S = 600.0
_FURTHER = ". Further ones are counted, not logged"


class LogOnce:
    """Logs the first event of each kind; `counts` has how many there were.

    With `again_s` an event of the same kind is logged again if the last line is that old, with
    the number of those in between. Of more than `most` kinds in that time, or in 10 minutes, the
    rest is left out, which one line says. Safe from any thread.
    """

    def __init__(
        self,
        log: logging.Logger,
        *,
        again_s: float = math.inf,
        most: int = _MOST_KINDS,
        clock: Callable[[], float] = lambda: scheduler.monotonic(),
    ) -> None:
        self.counts: Counter[Hashable] = Counter()
        self._log = log
        self._again_s = again_s
        self._makes_room_after_s = min(again_s, _MAKES_ROOM_AFTER_S)
        self._most = most
        self._clock = clock
        self._lock = scheduler.Lock()
        # When a line of each kind was logged, the oldest first, and the count of events then.
        self._logged: dict[Hashable, tuple[float, int]] = {}
        self._crowded_until_s = -math.inf

    def info(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text as `warning` does, as an information."""
        self._write(logging.INFO, kind, text, values)

    def warning(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text if it is the first of its kind, its values filled in by logging."""
        self._write(logging.WARNING, kind, text, values)

    def exception(self, kind: Hashable, text: str, *values: object) -> None:
        """Log the text as `warning` does, as an error and with the traceback of the exception that
        is being handled.
        """
        self._write(logging.ERROR, kind, text, values, exc_info=True)

    def _write(
        self,
        level: int,
        kind: Hashable,
        text: str,
        values: tuple[object, ...],
        *,
        exc_info: bool = False,
    ) -> None:
        with self._lock:
            since = self._count(kind)
            begins_to_crowd = since is None and self._is_crowded_since_now(kind)
        if since is not None:
            self._log.log(level, f"{text}{self._ending(since)}", *values, exc_info=exc_info)
        elif begins_to_crowd:
            self._log.warning(
                "More than %d lines like the last ones within %g s: the rest is left out",
                self._most,
                self._makes_room_after_s,
            )

    def _count(self, kind: Hashable) -> int | None:
        """Count an event: how many of its kind there were since the last line, None for no line."""
        now_s = self._clock()
        former = self._logged.get(kind)
        if former is None and not self._has_room(now_s):
            return None
        self.counts[kind] += 1
        if former is not None and now_s < former[0] + self._again_s:
            return None
        since = 0 if former is None else self.counts[kind] - former[1]
        self._logged.pop(kind, None)
        self._logged[kind] = now_s, self.counts[kind]
        return since

    def _has_room(self, now_s: float) -> bool:
        if len(self._logged) < self._most:
            return True
        oldest = next(iter(self._logged))
        if now_s < self._logged[oldest][0] + self._makes_room_after_s:
            return False
        del self._logged[oldest], self.counts[oldest]
        return True

    def _is_crowded_since_now(self, kind: Hashable) -> bool:
        now_s = self._clock()
        if kind in self._logged or now_s < self._crowded_until_s:
            return False
        self._crowded_until_s = now_s + self._makes_room_after_s
        return True

    def _ending(self, since: int) -> str:
        if self._again_s == math.inf:
            return _FURTHER
        return f" ({since} times since the last line)" if since > 1 else ""
