"""Tests that need real processes, sockets, browsers or sleeps: the marker `real`.

All others run in one process, between two of which nothing but memory passes: a test that does
more without the marker fails, and names the call.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from tfbus.base import scheduler
from tfbus.testing.of_python import is_importing

MARKER = "real"

# Events that Python reports to audit hooks, and what a test does by them.
_REAL = {
    "os.fork": "forks",
    "os.forkpty": "forks",
    "os.posix_spawn": "starts a process",
    "os.system": "starts a process",
    "socket.bind": "opens a socket",
    "socket.connect": "opens a socket",
    "subprocess.Popen": "starts a process",
}


class RealThingError(AssertionError):
    """A test without the marker does what only real tests do."""


class _Guard:
    """Watches the test that runs, unless it is a real one."""

    def __init__(self) -> None:
        self.test = ""
        self.found = ""

    def on_event(self, event: str, args: tuple[Any, ...]) -> None:
        """As an audit hook."""
        # A module may, at its import: which test has the first one is left to chance.
        if self.test and event in _REAL and not is_importing():
            anywhere = _REAL[event] == "starts a process"
            self.find(f"{_REAL[event]} ({event} {args!r:.200})", anywhere=anywhere)

    def find(self, what: str, *, anywhere: bool = False) -> None:
        """Raise the error, also at the end of the test where this one is swallowed."""
        # That of the process pokes the main thread until it has handled a signal, in any test.
        if threading.current_thread().name == "signals":
            return
        # Threads of earlier tests sleep and close their sockets.
        is_ours = threading.current_thread() is threading.main_thread()
        if self.test and (is_ours or anywhere or scheduler.is_simulated):
            self.found = self.found or (
                f"{self.test} {what}: let it run on the simulated network (the fixtures bus and "
                f"network), or, if only that shows what it promises, mark it @pytest.mark.{MARKER}"
            )
            raise RealThingError(self.found)


guard = _Guard()
sys.addaudithook(guard.on_event)


def _guarded(function: Callable[..., Any], what: str) -> Callable[..., Any]:
    def guarded(*args: Any, **named: Any) -> Any:
        guard.find(what)
        return function(*args, **named)

    return guarded


# Python reports none of these.
time.sleep = _guarded(time.sleep, "sleeps in real time")
zenoh.open = _guarded(zenoh.open, "opens a session of Zenoh's own")
zenoh.scout = _guarded(zenoh.scout, "scouts by Zenoh's own")


@pytest.fixture(scope="session")
def real() -> None:
    """Makes the tests real that use it, and those of other fixtures that do."""


def pytest_configure(config: pytest.Config) -> None:
    """Say what the marker means."""
    text = f"{MARKER}: has processes, sockets, browsers or sleeps of its own; make quick leaves it"
    config.addinivalue_line("markers", text)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that use the fixture."""
    for item in items:
        if MARKER in getattr(item, "fixturenames", ()):
            item.add_marker(MARKER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Watch a test and its fixtures."""
    guard.found = ""
    guard.test = "" if item.get_closest_marker(MARKER) else item.nodeid
    try:
        return (yield)
    finally:
        guard.test = ""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """After the last test of a file end fixtures of the file, which may be those of real tests."""
    if nextitem is None or nextitem.path != item.path:
        guard.test = ""
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test that has swallowed the error."""
    result = yield
    if guard.found:
        pytest.fail(guard.found)
    return result
