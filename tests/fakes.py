"""What stands in for a clock, a log or a second thread in tests."""

import logging
import threading
from collections.abc import Callable
from typing import Any

from tests.live_bus import DEADLINE_S


class Clock:
    """A clock that stands still until the test sets `now_ns`."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        return self.now_ns


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
