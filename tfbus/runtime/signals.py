"""Ctrl-C and SIGTERM as the clean end of a process."""

import math
import os
import select
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# The kernel's clock for this wait is 32 bits of milliseconds wide; a longer one is begun anew.
_LONGEST_MS = 86_400_000


class StopSignals:
    """A stop that SIGINT and SIGTERM call for, from construction until `uninstall()`.

    Where the main thread is in the middle of something else than `wait`, a signal also raises
    KeyboardInterrupt there, so that a blocking call ends too. Several may be installed in one
    process, in any order: a signal stops them all.
    """

    def __init__(self) -> None:
        self._stop = _Stop()
        self._interrupts_nothing = False
        if _in_main_thread():
            if not _previous:
                for number in (signal.SIGINT, signal.SIGTERM):
                    _previous[number] = signal.signal(number, _on_signal)
            _installed.append(self)

    @property
    def stopped(self) -> bool:
        """Whether it is time to end."""
        return self._stop.called

    def stop(self) -> None:
        """Say that it is time to end; from any thread, twice is fine."""
        self._stop.call()

    def wait(self, timeout_s: float | None = None, wakeup: "Wakeup | None" = None) -> bool:
        """Whether it is time to end, waited for at most `timeout_s` (None: for ever), and less
        where somebody wakes up who waits.
        """
        if not _in_main_thread():
            return self._stop.wait(timeout_s, wakeup)
        with self.held(), _SignalWakeup() as signalled:
            return self._stop.wait(timeout_s, wakeup, signalled)

    @contextmanager
    def held(self) -> Iterator[None]:
        """While it lasts a signal only calls for the stop, and interrupts nothing."""
        self._interrupts_nothing = _in_main_thread()
        try:
            yield
        finally:
            self._interrupts_nothing = False

    def uninstall(self) -> None:
        """Give the signals back to whom they belonged; from any thread, twice is fine."""
        if self in _installed:
            _installed.remove(self)
            if not _installed and _in_main_thread():
                _give_back()


class Wakeup:
    """Ends a wait from another thread, once, for as long as its `with` lasts."""

    def __enter__(self) -> "Wakeup":
        self._lock = threading.Lock()
        self.readable, self._writable = os.pipe()
        self._is_open = True
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._is_open = False
            os.close(self.readable)
            os.close(self._writable)

    def wake(self) -> None:
        """End the wait, also one that begins after this; after the `with` nothing happens."""
        with self._lock:
            if self._is_open:
                os.write(self._writable, b"!")


class _Stop:
    """A flag that threads can wait for, and that a signal handler may raise at any instant.

    threading.Event will not do: its lock may be held by the very code that the handler
    interrupts, and a signal that comes just before the lock is waited for would wake nobody.
    A file that becomes readable has neither fault.
    """

    def __init__(self) -> None:
        self.called = False
        self._readable, self._writable = os.pipe()

    def __del__(self) -> None:
        os.close(self._readable)
        os.close(self._writable)

    def call(self) -> None:
        if not self.called:
            self.called = True
            os.write(self._writable, b"!")

    def wait(
        self,
        timeout_s: float | None,
        wakeup: Wakeup | None = None,
        signalled: "_SignalWakeup | None" = None,
    ) -> bool:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        poll = select.poll()
        poll.register(self._readable, select.POLLIN)
        for other in (wakeup, signalled):
            if other:
                poll.register(other.readable, select.POLLIN)
        while not self.called:
            left_s = None if deadline is None else deadline - time.monotonic()
            if left_s is not None and left_s <= 0:
                break
            ready = poll.poll(_LONGEST_MS if left_s is None else min(left_s * 1e3, _LONGEST_MS))
            files = {file for file, _ in ready}
            if wakeup and wakeup.readable in files:
                break
            if signalled and signalled.readable in files:
                signalled.drain()
        return self.called


class _SignalWakeup:
    """A file that becomes readable at every signal, for as long as its `with` lasts."""

    def __enter__(self) -> "_SignalWakeup":
        self.readable, self._writable = os.pipe()
        os.set_blocking(self._writable, False)
        self._previous = signal.set_wakeup_fd(self._writable, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._previous)
        os.close(self.readable)
        os.close(self._writable)

    def drain(self) -> None:
        """Wait for the next signal from now on; Python has run the handlers of the last."""
        os.read(self.readable, 4096)


# `timeout`, `make` and shells send a signal to a process and to its group, so that it comes twice
# within an instant: the second one must not interrupt what the first one began.
_ONE_WISH_S = 1.0

_interrupted_s = -math.inf
_installed: list[StopSignals] = []
_previous: dict[int, Any] = {}


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _on_signal(number: int, frame: FrameType | None) -> None:
    if not _installed:  # the last one was uninstalled by a thread that may not give back
        _give_back()
        signal.raise_signal(number)
        return
    global _interrupted_s
    for signals in _installed:
        signals.stop()
    is_enough = any(signals._interrupts_nothing for signals in _installed)
    now_s = time.monotonic()
    if not is_enough and now_s - _interrupted_s > _ONE_WISH_S:
        _interrupted_s = now_s
        raise KeyboardInterrupt


def _give_back() -> None:
    for number, previous in _previous.items():
        if signal.getsignal(number) is _on_signal:
            signal.signal(number, previous)
    _previous.clear()
