"""Ctrl-C and SIGTERM as the clean end of a process."""

import signal
import threading
from types import FrameType
from typing import Any


class StopSignals:
    """An event that SIGINT and SIGTERM set, from construction until `uninstall()`.

    Where the main thread is in the middle of something else than `wait`, a signal also raises
    KeyboardInterrupt there, so that a blocking call ends too.
    """

    def __init__(self) -> None:
        self._stopped = threading.Event()
        self._waiting = False
        self._previous: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._on_signal)

    @property
    def stopped(self) -> bool:
        """Whether it is time to end."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """Say that it is time to end; from any thread, twice is fine."""
        self._stopped.set()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether it is time to end, waited for at most `timeout_s` (None: for ever)."""
        self._waiting = True
        try:
            return self._stopped.wait(timeout_s)
        finally:
            self._waiting = False

    def uninstall(self) -> None:
        """Give the signals back to whom they belonged; from any thread, twice is fine."""
        if threading.current_thread() is threading.main_thread():
            for number, previous in self._previous.items():
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, previous)
            self._previous.clear()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        already = self.stopped
        self.stop()
        if not self._waiting and not already:
            raise KeyboardInterrupt
