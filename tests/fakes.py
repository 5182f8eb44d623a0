"""Stand-ins for a clock, a log, a second thread or a recording in tests."""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from tests.buses import DEADLINE_S
from tfbus.base.clock import SystemClock
from tfbus.recording.items import ALL, EventItem, Item, Selection, TransformItem


class Clock:
    """A clock that stands still until the test sets `now_ns`."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns

    def monotonic(self) -> float:
        """The time in seconds, where it stands in for the scheduler of a module."""
        return self.now_ns / 1e9


class StandingClock(SystemClock):
    """A clock that stands still until the test sets `at_ns`, by both of its readings."""

    def __init__(self, at_ns: int = 0) -> None:
        self.at_ns = at_ns

    def now_ns(self) -> int:
        return self.at_ns

    def elapsed_ns(self) -> int:
        return self.at_ns


class Lines(logging.Handler):
    """The messages of a log from now on, those of a level and above."""

    def __init__(self, log: logging.Logger, level: int = logging.NOTSET) -> None:
        super().__init__(level)
        self.lines: list[str] = []
        log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


class InAThread:
    """A call that may wait, on a thread of its own."""

    def __init__(self, call: Callable[[], object]) -> None:
        self._call = call
        self._answer: object = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._answer = self._call()
        except Exception as error:
            self._answer = error

    @property
    def is_waiting(self) -> bool:
        """Whether the call has neither returned nor raised."""
        return self._thread.is_alive()

    def result(self) -> Any:
        """What the call returned or raised; waits until it has."""
        self._thread.join(DEADLINE_S)
        assert not self.is_waiting
        return self._answer


class Tape:
    """A recording in memory: its items, in the order of their log times."""

    def __init__(self, items: Sequence[Item]) -> None:
        self._items = items
        self.start_ns = items[0].log_ns
        self.end_ns = items[-1].log_ns

    def items(
        self, from_ns: int | None = None, to_ns: int | None = None, selection: Selection = ALL
    ) -> Iterator[Item]:
        """The items of a span."""
        first = self.start_ns if from_ns is None else from_ns
        last = self.end_ns if to_ns is None else to_ns
        for item in self._items:
            if first <= item.log_ns <= last and (taken := selection.taken_of(item)) is not None:
                yield taken

    def state_at(self, log_ns: int, selection: Selection = ALL) -> "TapeState":
        """What is in force after the items of a log time."""
        return TapeState([*self.items(None, log_ns, selection)])


class TapeState:
    """What the items so far have put in force: all that is no dynamic transform and no topic."""

    def __init__(self, items: Sequence[Item]) -> None:
        self._items = items

    def items(self, log_ns: int) -> list[Item]:
        """The items that stand for it."""
        return [
            replace(item, log_ns=log_ns)
            for item in self._items
            if isinstance(item, EventItem) or (isinstance(item, TransformItem) and item.static)
        ]
