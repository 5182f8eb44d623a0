"""Ctrl-C and SIGTERM, in a script and in an interactive session."""

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.fakes import InAThread
from tfbus.base import scheduler
from tfbus.base.lazy_exports import exported
from tfbus.base.signals import SignalHandlers, SignalledStop, StopSignals, held_signals


@pytest.fixture
def signals(monkeypatch: pytest.MonkeyPatch) -> Iterator[StopSignals]:
    """Signals of the process of the test, which got none before; by default it is a script."""
    monkeypatch.setattr(scheduler.of_process(SignalHandlers), "_interrupted_s", -math.inf)
    installed = StopSignals()
    yield installed
    installed.uninstall()


@pytest.fixture
def at_a_prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process is an interactive session, as a notebook is."""
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)


@pytest.fixture(autouse=True)
def a_script(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests are no interactive session, even if pytest was started in one."""
    monkeypatch.delattr(sys, "ps1", raising=False)


def sent_while_waiting(number: int, signals: StopSignals) -> Callable[[], object]:
    """Send a signal as soon as the main thread is in `wait`; call what it returns to join."""

    def send() -> None:
        eventually(lambda: signals._is_held)
        os.kill(os.getpid(), number)

    sender = threading.Thread(target=send)
    sender.start()
    return sender.join


def test_ctrl_c_in_a_script_ends_the_wait_in_progress_only(signals: StopSignals) -> None:
    """The next wait of the main thread takes its time again, and ends at the next Ctrl-C."""
    for _ in range(2):
        join = sent_while_waiting(signal.SIGINT, signals)
        assert signals.wait(None)
        join()
        assert not signals.wait(0.0)
    assert signals.stopped


def test_sigterm_ends_this_wait_and_all_later_ones(signals: StopSignals) -> None:
    """After SIGTERM nothing waits any longer."""
    join = sent_while_waiting(signal.SIGTERM, signals)
    assert signals.wait(None)
    join()
    assert signals.wait(None)


def test_ctrl_c_in_a_script_ends_the_waits_of_other_threads_for_good(signals: StopSignals) -> None:
    """A thread of a script does not keep it alive after Ctrl-C."""
    other = InAThread(signals.wait)
    join = sent_while_waiting(signal.SIGINT, signals)
    signals.wait(None)
    join()
    assert other.result() is True
    assert InAThread(signals.wait).result() is True


def test_ctrl_c_at_a_prompt_raises_and_changes_nothing(
    signals: StopSignals, at_a_prompt: None
) -> None:
    """In a notebook the wait raises KeyboardInterrupt; what waits in other threads goes on."""
    other = InAThread(signals.wait)
    join = sent_while_waiting(signal.SIGINT, signals)
    with pytest.raises(KeyboardInterrupt):
        signals.wait(None)
    join()
    assert not signals.stopped
    assert not signals.wait(0.0)
    assert other.is_waiting
    signals.stop()
    assert other.result() is True


def test_a_signal_while_it_is_held_is_told_once(signals: StopSignals) -> None:
    """A signal that comes before a wait begins ends that wait, and no other."""
    with signals.held():
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.wait(None)
        assert not signals.wait(0.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_library_is_not_interrupted_where_signals_are_held(
    signals: StopSignals, number: int
) -> None:
    """Though another object of the process, such as a node, does not hold them."""
    with held_signals() as held:
        signal.raise_signal(number)
        assert held.consume()


def test_ctrl_c_counts_though_an_import_swallows_it(
    signals: StopSignals, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Modules that are compiled clear all exceptions at their start: it raises after the import."""
    lines = (
        "import signal",
        "try:",
        "    signal.raise_signal(signal.SIGINT)",
        "except BaseException:",
        "    pass",
        "name = 1",
    )
    (tmp_path / "swallowing.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        exported("tfbus", {"name": "swallowing"})[0]("name")
    assert sys.modules.pop("swallowing").name == 1
    assert signals.stopped


class _Ending:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_counts_though_a_finalizer_swallows_it(signals: StopSignals) -> None:
    """Python drops the errors of finalizers, such as that of a child process that has ended: it
    raises after that.
    """
    with pytest.raises(KeyboardInterrupt):
        _Ending()
        threading.Event().wait(DEADLINE_S)
    assert signals.stopped


@pytest.mark.parametrize("asks", ["after", "before", "another"])
def test_a_swallowed_ctrl_c_interrupts_no_program_that_knows_of_it(
    signals: StopSignals, monkeypatch: pytest.MonkeyPatch, asks: str
) -> None:
    """The work of a program at its end would be lost. It knows of the signal once it has asked,
    after the signal, an object that the signal has stopped.
    """
    before = threading.enumerate()
    other = StopSignals()
    other.stop()
    goes_on = threading.Event()
    sent: list[int] = []
    with monkeypatch.context() as patched:
        patched.setattr(time, "sleep", lambda seconds: goes_on.wait(DEADLINE_S))
        patched.setattr(signal, "pthread_kill", lambda thread, number: sent.append(number))
        _Asking(signals if asks == "before" else other)
        assert (signals if asks == "after" else other).stopped
        new = [each for each in threading.enumerate() if each not in before]
        [again] = [each for each in new if each.name == "signals again"]
        goes_on.set()
        again.join()
    assert (signal.SIGINT in sent) is (asks != "after")
    other.uninstall()


class _Asking:
    def __init__(self, asked: StopSignals) -> None:
        self._asked = asked

    def __del__(self) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            _ = self._asked.stopped


def test_a_hook_that_is_stacked_on_ours_is_called_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each error of a finalizer passes each hook once, though all nodes were closed and new ones
    made meanwhile; the last one leaves the hook of the other library in force.
    """
    seen: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", seen.append)
    first = StopSignals()
    ours = sys.unraisablehook

    def stacked(unraisable: "sys.UnraisableHookArgs") -> None:
        seen.append("stacked")
        assert seen.count("stacked") < 10
        ours(unraisable)

    monkeypatch.setattr(sys, "unraisablehook", stacked)
    first.uninstall()
    second = StopSignals()
    error = SimpleNamespace(exc_type=ValueError)
    sys.unraisablehook(error)
    second.uninstall()
    assert seen == ["stacked", error]
    assert sys.unraisablehook is stacked


def test_outside_of_a_wait_ctrl_c_raises_keyboard_interrupt(signals: StopSignals) -> None:
    """A blocking call ends; a later wait takes its time."""
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert signals.stopped
    assert not signals.wait(0.0)


def test_as_python_ends_nothing_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python takes the names of a module away before the last objects of its classes end."""
    unraisable: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    stop = SignalledStop()
    monkeypatch.setattr("tfbus.base.signals.os", None)
    del stop
    assert unraisable == []


def test_a_signal_may_end_the_construction(monkeypatch: pytest.MonkeyPatch) -> None:
    """A half-constructed flag is deleted without an error."""

    def interrupted() -> tuple[int, int]:
        raise KeyboardInterrupt

    unraisable: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    monkeypatch.setattr("tfbus.base.signals.os.pipe", interrupted)
    with pytest.raises(KeyboardInterrupt):
        SignalledStop()
    assert unraisable == []
