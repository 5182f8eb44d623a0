"""Says in the log that a simulated clock has not started yet, and when it has."""

import logging

from tfbus.runtime.clock import Clock
from tfbus.runtime.executor import Executor

# A clock that is there reaches a new node within this time, and the log need not mention it.
_CLOCK_WITHIN_S = 1.0


class ClockStart:
    """Logs once that a node waits for the first message on its clock topic."""

    def __init__(self, clock: Clock, topic: str, executor: Executor, log: logging.Logger) -> None:
        self._clock = clock
        self._topic = topic
        self._executor = executor
        self._log = log
        self._is_expected = False

    def expect(self) -> None:
        """Log it unless the clock starts within 1 s; only the first call does."""
        if not self._is_expected and not self._clock.is_running:
            self._is_expected = True
            self._executor.after(_CLOCK_WITHIN_S, self._report)

    def _report(self) -> None:
        if not self._clock.is_running:
            self._log.info("Waiting for the clock: no message on %r yet", self._topic)
            self._clock.call_when_running(self._greet)

    def _greet(self) -> None:
        if self._clock.is_running:  # and has not just been closed
            self._log.info("The clock is running")
