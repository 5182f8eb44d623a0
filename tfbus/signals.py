"""Ctrl-C and SIGTERM as the clean end of a process."""

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any


class StopSignals:
    """While it is installed, SIGINT and SIGTERM call `stop()`.

    Where the main thread is in the middle of something else than waiting for the stop, it is
    interrupted by KeyboardInterrupt as well, so that a blocking call ends too.
    """

    def __init__(self, stop: Callable[[], None]):
        self._stop = stop
        self._previous: dict[int, Any] = {}
        self.main_thread_waits = False
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._on_signal)

    def uninstall(self) -> None:
        """Give the signals back to whom they belonged; from any thread, twice is fine."""
        if threading.current_thread() is threading.main_thread():
            for number, previous in self._previous.items():
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, previous)
            self._previous.clear()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._stop()
        if not self.main_thread_waits:
            raise KeyboardInterrupt
