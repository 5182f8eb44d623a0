"""Delays: which callbacks of a node held up its timers and topics, and by how much."""

import logging
from collections import defaultdict, deque
from collections.abc import Iterable
from typing import Any, NamedTuple

from tfbus.runtime import scheduler
from tfbus.runtime.log import LogOnce
from tfbus.wording import duration

# A callback that took less holds up nothing that anyone would notice.
SLOW_S = 0.001

# So many of the last slow ones are remembered, and so many pairs are counted.
_MOST_REMEMBERED = 64
_MOST_PAIRS = 100

_REMEDY = (
    ". A callback that waits is to be in a callback group of its own (callback_group=...), or an "
    "async def that awaits"
)


class Ran(NamedTuple):
    """A callback that ran, or still runs: its name, and when, by scheduler.monotonic()."""

    what: str
    began_s: float
    ended_s: float


class Delays:
    """Notes slow callbacks, and finds which of them was the culprit if a timer was late or a
    topic had to drop a message.

    The first of each culprit is logged; all are counted. Safe from any thread.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log_once = LogOnce(log)
        self._lock = scheduler.Lock()
        self._slow: deque[Ran] = deque(maxlen=_MOST_REMEMBERED)
        # By culprit and the timer or topic: how much was lost, and how long the culprit took.
        self._pairs: dict[tuple[str, str], tuple[int, float]] = {}

    def ran(self, what: str, began_s: float, ended_s: float) -> None:
        """Remember a callback that took at least `SLOW_S`."""
        self._slow.append(Ran(what, began_s, ended_s))

    def late(self, what: str, since_s: float, ticks: int, running: Iterable[Ran] = ()) -> None:
        """Note that a timer left out so many ticks, since its tick was due at `since_s`."""
        late_s = scheduler.monotonic() - since_s
        found = self._culprit(since_s, running)
        # Where its callbacks did not take that time, the machine is busy with other programs.
        if found is None or sum(found[1]) < late_s / 2:
            return
        by, calls_s = found
        self._count(by, what, ticks, max(calls_s))
        self._log_once.warning(
            ("late", by),
            "%s was late by %s: %s%s",
            what[:1].upper() + what[1:],
            duration(late_s),
            _told(by, calls_s, own=by == what),
            _REMEDY,
        )

    def dropped(self, what: str, pending: int, running: Iterable[Ran] = ()) -> None:
        """Note that a topic dropped a message, as so many wait already."""
        now_s = scheduler.monotonic()
        found = self._culprit(now_s - 1.0, running)
        by, calls_s = found or (what, [0.0])
        self._count(by, what, 1, max(calls_s))
        why = "they come faster than its callback returns"
        self._log_once.warning(
            ("dropped", by),
            "%s dropped a message, as %d wait already: %s%s",
            what[:1].upper() + what[1:],
            pending,
            _told(by, calls_s, own=by == what) if found else why,
            _REMEDY if found else "",
        )

    def described(self, overdue: Iterable[tuple[str, int, Ran]] = ()) -> list[dict[str, Any]]:
        """The fields of a DelayDescription for each pair, the most lost first.

        `overdue` are timers with how many ticks they have left out so far, as a callback has not
        returned.
        """
        with self._lock:
            pairs = dict(self._pairs)
        for what, ticks, ran in overdue:
            lost, longest_s = pairs.get((ran.what, what), (0, 0.0))
            pairs[ran.what, what] = lost + ticks, max(longest_s, ran.ended_s - ran.began_s)
        return [
            {"what": what, "lost": lost, "by": by, "took_s": took_s}
            for (by, what), (lost, took_s) in sorted(pairs.items(), key=lambda pair: -pair[1][0])
        ]

    def _count(self, by: str, what: str, lost: int, took_s: float) -> None:
        with self._lock:
            before = self._pairs.get((by, what))
            if before is None and len(self._pairs) >= _MOST_PAIRS:
                return
            count, longest_s = before or (0, 0.0)
            self._pairs[by, what] = count + lost, max(longest_s, took_s)

    def _culprit(self, since_s: float, running: Iterable[Ran]) -> tuple[str, list[float]] | None:
        """Whose callbacks took the most time since then, and how long each of them took."""
        shares_s: defaultdict[str, float] = defaultdict(float)
        calls_s: defaultdict[str, list[float]] = defaultdict(list)
        for ran in (*self._slow.copy(), *running):
            within_s = ran.ended_s - max(ran.began_s, since_s)
            if within_s >= SLOW_S:
                shares_s[ran.what] += within_s
                calls_s[ran.what].append(ran.ended_s - ran.began_s)
        if not shares_s:
            return None
        by = max(shares_s, key=lambda what: shares_s[what])
        return by, calls_s[by]


def _told(by: str, calls_s: list[float], *, own: bool) -> str:
    callback = "its own callback" if own else f"the callback of {by}"
    calls = f" in {len(calls_s)} calls" if len(calls_s) > 1 else ""
    return f"{callback} took {duration(sum(calls_s))}{calls}"
