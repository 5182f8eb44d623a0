"""Ctrl-C and SIGTERM as the clean end of a process."""

import signal
import threading
from types import FrameType
from typing import Any


class StopSignals:
    """An event that SIGINT and SIGTERM set, from construction until `uninstall()`.

    Where the main thread is in the middle of something else than `wait`, a signal also raises
    KeyboardInterrupt there, so that a blocking call ends too. Several may be installed in one
    process, in any order: a signal stops them all.
    """

    def __init__(self) -> None:
        self._stopped = threading.Event()
        self._main_thread_waits = False
        if _in_main_thread():
            if not _previous:
                for number in (signal.SIGINT, signal.SIGTERM):
                    _previous[number] = signal.signal(number, _on_signal)
            _installed.append(self)

    @property
    def stopped(self) -> bool:
        """Whether it is time to end."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """Say that it is time to end; from any thread, twice is fine."""
        self._stopped.set()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether it is time to end, waited for at most `timeout_s` (None: for ever)."""
        if not _in_main_thread():
            return self._stopped.wait(timeout_s)
        self._main_thread_waits = True
        try:
            return self._stopped.wait(timeout_s)
        finally:
            self._main_thread_waits = False

    def uninstall(self) -> None:
        """Give the signals back to whom they belonged; from any thread, twice is fine."""
        if self in _installed:
            _installed.remove(self)
            if not _installed and _in_main_thread():
                _give_back()


_installed: list[StopSignals] = []
_previous: dict[int, Any] = {}


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _on_signal(number: int, frame: FrameType | None) -> None:
    if not _installed:  # the last one was uninstalled by a thread that may not give back
        _give_back()
        signal.raise_signal(number)
        return
    is_known = all(signals.stopped for signals in _installed)
    is_waited_for = any(signals._main_thread_waits for signals in _installed)
    for signals in _installed:
        signals.stop()
    if not is_known and not is_waited_for:
        raise KeyboardInterrupt


def _give_back() -> None:
    for number, previous in _previous.items():
        if signal.getsignal(number) is _on_signal:
            signal.signal(number, previous)
    _previous.clear()
