"""Ctrl-C and SIGTERM as the clean end of a process."""

import math
import os
import select
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from types import FrameType
from typing import Any

from tfbus.base import scheduler

# poll() takes 32 bits of milliseconds; longer waits are repeated.
_LONGEST_MS = 86_400_000


class StopSignals:
    """SIGINT and SIGTERM for one object of this process, from construction until `uninstall()`.

    SIGTERM and `stop` end all its waits for good. SIGINT (Ctrl-C) ends the wait that the main
    thread is in, and no later one. If the main thread is outside of `wait`, a signal raises
    KeyboardInterrupt there, so that a blocking call ends too. Several may be installed in one
    process: a signal is for all.

    In a script SIGINT also ends the waits of other threads for good, as the script is about to
    end. In an interactive session (a notebook, a prompt) the session goes on: there SIGINT only
    raises KeyboardInterrupt, from `wait` too.
    """

    def __init__(self) -> None:
        # `_ended` is for good; `_stop` is that or Ctrl-C in a script.
        stop = _SimulatedStop if scheduler.is_simulated else SignalledStop
        self._ended, self._stop = stop(), stop()
        self._is_held = False
        self._is_interrupted = False
        # Whether Ctrl-C has stopped it, and not the program before.
        self._has_signal = False
        if _in_main_thread():
            _handlers().install(self)

    @property
    def stopped(self) -> bool:
        """Whether SIGTERM has come or `stop` was called, or in a script SIGINT has come."""
        if self._has_signal and _in_main_thread():
            _handlers().is_answered = True
        return self._stop.called

    @property
    def readable(self) -> int:
        """The file that becomes readable when `stopped` becomes true, for an event loop."""
        return self._stop.readable

    def stop(self) -> None:
        """Stop as SIGTERM does; from any thread, twice is fine."""
        self._ended.call()
        self._stop.call()

    def wait(self, timeout_s: float | None = None, wakeup: "Wakeup | None" = None) -> bool:
        """Wait for the stop, at most `timeout_s` (None: for ever) or until the wakeup; whether
        a signal or `stop` has ended it.
        """
        if not _in_main_thread():
            return self._stop.wait(timeout_s, wakeup)
        with self.held():
            with _signal_wakeup() as signalled:
                self._ended.wait(timeout_s, wakeup, signalled, lambda: self._is_interrupted)
            return self.consume()

    def consume(self) -> bool:
        """Whether it was stopped, or SIGINT came while it was held; that counts once.

        In an interactive session SIGINT raises KeyboardInterrupt here.
        """
        was_interrupted, self._is_interrupted = self._is_interrupted, False
        if was_interrupted and _is_interactive():
            raise KeyboardInterrupt
        return was_interrupted or self._ended.called

    @contextmanager
    def held(self) -> Iterator[None]:
        """Until the end of its `with` a signal raises no KeyboardInterrupt: `consume` says so."""
        if not _in_main_thread():
            yield
            return
        was_held, self._is_held = self._is_held, True
        try:
            yield
        finally:
            self._is_held = was_held

    def receive(self, number: int) -> None:
        """Take note of a signal, in its handler."""
        if number != signal.SIGINT:
            self.stop()
            return
        if self._is_held:
            self._is_interrupted = True
            self._ended.interrupt()
        if not _is_interactive():
            self._has_signal |= not self._stop.called
            self._stop.call()

    def uninstall(self) -> None:
        """Restore the former signal handlers; from any thread, twice is fine."""
        handlers = _handlers()
        if self in handlers.installed:
            handlers.installed.remove(self)
            if not handlers.installed and _in_main_thread():
                handlers.restore()


@contextmanager
def held_signals() -> Iterator[StopSignals]:
    """Until the end of its `with` no signal raises KeyboardInterrupt, which would leave a library
    in disorder: ask `consume` of the result.
    """
    signals = StopSignals()
    try:
        with signals.held():
            yield signals
    finally:
        signals.uninstall()


class Wakeup:
    """Ends a wait from another thread, once, until the end of its `with`."""

    def __enter__(self) -> "Wakeup":
        self._lock = scheduler.Lock()
        self._is_open = not scheduler.is_simulated
        # Of a simulated process: the stop that it ends, and whether it has.
        self.stop: _SimulatedStop | None = None
        self.is_woken = False
        if self._is_open:
            self.readable, self._writable = os.pipe()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            if self._is_open:
                self._is_open = False
                os.close(self.readable)
                os.close(self._writable)

    def wake(self) -> None:
        """End the wait, also one that starts later; after the `with` it does nothing."""
        with self._lock:
            self.is_woken = True
            if self.stop is not None:
                self.stop.ring()
            if self._is_open:
                os.write(self._writable, b"!")


class _SimulatedStop:
    """A SignalledStop of a simulated process, whose signals come between two turns."""

    def __init__(self) -> None:
        self.called = False
        self.readable = -1  # no event loop waits for it
        self._event = scheduler.Event()
        self.ring = self.interrupt = self._event.set

    def call(self) -> None:
        self.called = True
        self.ring()

    def wait(
        self,
        timeout_s: float | None,
        wakeup: Wakeup | None = None,
        signalled: object = None,
        is_interrupted: Callable[[], bool] = lambda: False,
    ) -> bool:
        if not self.called:
            self._event.clear()
        if wakeup is not None:
            wakeup.stop = self
            if wakeup.is_woken:
                return self.called
        if not is_interrupted():
            self._event.wait(timeout_s)
        return self.called


class SignalledStop:
    """A flag that threads can wait for, and that a signal handler may set at any instant.

    threading.Event cannot do that: the code that the handler interrupts may hold its lock, and a
    signal just before a wait for the lock would not end the wait. A file that becomes readable has
    neither fault.
    """

    # None yet: a signal may end the construction, too.
    readable = _writable = -1

    def __init__(self) -> None:
        self.called = False
        self.readable, self._writable = os.pipe()
        _stops.add(self)

    # One that outlives this module, as Python ends, finds none of its names.
    def __del__(self, close: Callable[[int], None] = os.close) -> None:
        for file in (self.readable, self._writable):
            if file >= 0:
                close(file)

    def leave_to_parent(self) -> None:
        """In a forked child: it has come, and the parent's file is the parent's."""
        os.close(self.readable)
        os.close(self._writable)
        self.called = True
        self.readable, self._writable = os.pipe()

    def call(self) -> None:
        if not self.called:
            self.called = True
            os.write(self._writable, b"!")

    def interrupt(self) -> None:
        """The signal has ended the wait by itself."""

    def wait(
        self,
        timeout_s: float | None,
        wakeup: Wakeup | None = None,
        signalled: "_SignalWakeup | None" = None,
        is_interrupted: Callable[[], bool] = lambda: False,
    ) -> bool:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        poll = select.poll()
        poll.register(self.readable, select.POLLIN)
        for other in (wakeup, signalled):
            if other:
                poll.register(other.readable, select.POLLIN)
        while not self.called and not is_interrupted():
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
    """A file that becomes readable at every signal, until the end of its `with`."""

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
        """Wait for the next signal; Python has run the handlers of the last one."""
        os.read(self.readable, 4096)


def _signal_wakeup() -> "AbstractContextManager[_SignalWakeup | None]":
    return nullcontext() if scheduler.is_simulated else _SignalWakeup()


class _Poker:
    """Interrupts the main thread until it has handled a signal, wherever it waits.

    A wait for a lock ends only at a signal that comes in the midst of it, on its own thread: not at
    one that the system gives to another thread, nor at one in the instant before the wait, and then
    it lasts for ever. So a thread here learns of each signal by a file that the system writes to,
    and sends the main thread SIGURG, which does nothing else, until Python has run its handlers.
    """

    def __init__(self) -> None:
        # A number, since a handler may set it at any instant: see SignalledStop.
        self._is_handled = True
        self._readable = self._writable = -1

    def install(self) -> None:
        """Begin, in the main thread; not if another library reads that file or uses SIGURG."""
        if not hasattr(signal, "SIGURG") or signal.getsignal(signal.SIGURG) != signal.SIG_DFL:
            return
        if self._readable < 0:
            self._readable, self._writable = os.pipe()
            os.set_blocking(self._writable, False)
            threading.Thread(target=self._run, name="signals", daemon=True).start()
        others = signal.set_wakeup_fd(self._writable, warn_on_full_buffer=False)
        if others >= 0:
            signal.set_wakeup_fd(others)
            return
        _handlers().previous[signal.SIGURG] = signal.signal(signal.SIGURG, self.on_poke)

    def uninstall(self) -> None:
        """End, in the main thread; the thread waits for another install."""
        if _handlers().previous.get(signal.SIGURG) is not None:
            others = signal.set_wakeup_fd(-1)
            if others not in (-1, self._writable):
                signal.set_wakeup_fd(others)

    def leave_to_parent(self) -> None:
        """In a forked child, which has no other threads: the file is the parent's."""
        if self._readable >= 0:
            os.close(self._readable)
            os.close(self._writable)
            self._readable = self._writable = -1

    def on_poke(self, number: int, frame: FrameType | None) -> None:
        """Note that handlers have run, in that of SIGURG."""
        self._is_handled = True

    def _run(self) -> None:
        main = threading.main_thread().ident
        assert main is not None
        read = os.read  # as Python ends, it takes the names of this module away
        while numbers := read(self._readable, 4096):
            self._is_handled = not {signal.SIGINT, signal.SIGTERM} & set(numbers)
            while not self._is_handled:
                time.sleep(_POKE_EVERY_S)
                if signal.getsignal(signal.SIGURG) != self.on_poke:
                    break
                signal.pthread_kill(main, signal.SIGURG)


class SignalHandlers:
    """The signals of one process: for which objects they are, and which handlers it had before."""

    def __init__(self) -> None:
        self.installed: list[StopSignals] = []
        self.previous: dict[int, Any] = {}
        # Signals that have come within `postponed`; None outside of it.
        self.postponed: set[int] | None = None
        self._interrupted_s = -math.inf
        # Whether the program knows of the last signal that was swallowed: it has asked whether it
        # is stopped since then.
        self.is_answered = False
        # The hook of the last install, with the hook that it has replaced.
        self._hook: partial[None] | None = None

    def install(self, signals: StopSignals) -> None:
        """Signals are for this object too, in the main thread."""
        if not self.previous:
            for number in (signal.SIGINT, signal.SIGTERM):
                self.previous[number] = signal.signal(number, self.on_signal)
            if not scheduler.is_simulated:
                _poker.install()
                # A new one each time, with the former of its own: another library may have stacked
                # its hook on an older one of ours, and two that call each other never end.
                self._hook = partial(self.on_unraisable, sys.unraisablehook)
                sys.unraisablehook = self._hook
        self.installed.append(signals)

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """Tell all that are installed; raises KeyboardInterrupt if none of them holds it."""
        if self.postponed is not None:
            self.postponed.add(number)
            return
        if not self.installed:  # another thread uninstalled the last one, and cannot set handlers
            self.restore()
            signal.raise_signal(number)
            return
        for signals in self.installed:
            signals.receive(number)
        is_held = any(signals._is_held for signals in self.installed)
        now_s = scheduler.monotonic()
        if not is_held and now_s - self._interrupted_s > _SAME_SIGNAL_S:
            self._interrupted_s = now_s
            raise KeyboardInterrupt

    def on_unraisable(self, former_hook: Callable[[Any], object], unraisable: Any) -> None:
        """Raise KeyboardInterrupt again if the signal came in a finalizer, which swallows it."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt) and self.installed:
            interrupt_again()
        else:
            former_hook(unraisable)

    def forget_interrupt(self) -> None:
        """Raise KeyboardInterrupt at the next signal, however soon it comes."""
        self._interrupted_s = -math.inf

    def restore(self) -> None:
        """The handlers of before."""
        if not scheduler.is_simulated:
            _poker.uninstall()
            if self._hook is not None and sys.unraisablehook is self._hook:
                sys.unraisablehook, self._hook = self._hook.args[0], None
        for number, previous in self.previous.items():
            # Bound methods are made anew each time: equal, never the same.
            if signal.getsignal(number) in (self.on_signal, _poker.on_poke):
                signal.signal(number, previous)
        self.previous.clear()


# Handlers run at once, as a rule.
_POKE_EVERY_S = 0.05

# `timeout`, `make` and shells send a signal to a process and to its group: it comes twice within an
# instant, and the second one must not interrupt the shutdown that the first one started.
_SAME_SIGNAL_S = 1.0

_stops: weakref.WeakSet[SignalledStop] = weakref.WeakSet()
_poker = _Poker()


def _handlers() -> SignalHandlers:
    return scheduler.of_process(SignalHandlers)


def _in_main_thread() -> bool:
    return scheduler.current_thread() is scheduler.main_thread()


def interrupt_again() -> None:
    """Raise KeyboardInterrupt again soon: this one was raised in a callback that a library runs on
    the main thread, and the library swallows it. Not in a program that knows of the signal
    meanwhile: it would be interrupted in what it does at its end.
    """
    if scheduler.is_simulated:
        raise KeyboardInterrupt  # which nothing swallows there

    main = threading.main_thread().ident
    assert main is not None
    handlers = _handlers()
    handlers.is_answered = False

    def interrupt(main: int = main) -> None:
        time.sleep(_POKE_EVERY_S)
        if not handlers.is_answered:
            handlers.forget_interrupt()
            signal.pthread_kill(main, signal.SIGINT)

    threading.Thread(target=interrupt, name="signals again", daemon=True).start()


def forget_interrupt() -> None:
    """If a KeyboardInterrupt was a usual end, let Python exit with its own code.

    Importing a dataclass runs exec(). If the signal interrupted one, Python would end the
    process by SIGINT: another exec() makes it forget that.
    """
    exec("")


def _is_interactive() -> bool:
    """Whether a person types at a prompt of Python or IPython, or runs the cells of a notebook."""
    return hasattr(sys, "ps1")


@contextmanager
def postponed() -> Iterator[None]:
    """In the main thread handle signals at the end of the `with`, which then raises as they do.

    For imports: the start of a compiled module clears any exception of its calls, and with it the
    KeyboardInterrupt of a signal, so that Ctrl-C would do nothing.
    """
    handlers = _handlers()
    if handlers.postponed is not None or not _in_main_thread():
        yield
        return
    numbers = handlers.postponed = set()
    try:
        yield
    finally:
        handlers.postponed = None
        # SIGTERM before SIGINT, since the first may raise.
        for number in sorted(numbers, reverse=True):
            handlers.on_signal(number, None)


def _on_fork() -> None:
    """In a forked child signals act as without a node, and nothing wakes the parent."""
    handlers = _handlers()
    handlers.installed.clear()
    if handlers.previous:
        signal.set_wakeup_fd(-1)
        handlers.restore()
    _poker.leave_to_parent()
    for stop in list(_stops):
        stop.leave_to_parent()


if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(after_in_child=_on_fork)
