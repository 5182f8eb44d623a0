"""Fixtures, options and settings that all tests share."""

import gc
from collections.abc import Iterator
from contextlib import ExitStack

import hypothesis
import pytest

from tests import live_bus, needs, simulated_bus
from tfbus import Buffer, Node, TransformListener

Bus = live_bus.Bus | simulated_bus.Bus

# Options: how long to compare with the real tf2, and how often to injure the hosts; and a browser.
pytest_plugins = [
    "tests.real_tests",
    "tests.order",
    "tests.tf2.versus",
    "tests.hosts.fault_options",
    "tests.buffer.stress_options",
    "tests.view.pages",
]

# A machine that is busy with other tests takes its time over any example. They are the same each
# time, so that no draw decides whether a change lands; `--hypothesis-profile fresh` has others.
hypothesis.settings.register_profile("fresh", deadline=None)
hypothesis.settings.register_profile("pinned", deadline=None, derandomize=True)
# `make quick` draws the first tenth of them.
hypothesis.settings.register_profile("quick", deadline=None, derandomize=True, max_examples=10)
hypothesis.settings.load_profile("pinned")


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Spare the collector of garbage what lives to the end: modules, and the tests themselves."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Let it collect what the tests leave, at times: a simulation leaves thousands of objects."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line what was skipped for want of what."""
    skipped = terminalreporter.getreports("skipped")
    summary = needs.summary(report.longrepr[2] for report in skipped if report.longrepr)
    if summary:
        terminalreporter.write_line(summary)


@pytest.fixture
def bus(request: pytest.FixtureRequest) -> Iterator[Bus]:
    """A bus of the test's own: simulated, or of real processes where the test is marked `real`."""
    with ExitStack() as stack:
        if request.node.get_closest_marker("real"):
            made: Bus = live_bus.Bus(request.getfixturevalue("tmp_path"))
        else:
            stack.enter_context(simulated_bus.bare_host())
            made = simulated_bus.Bus(request.getfixturevalue("network"))
        stack.callback(made.close)
        yield made


@pytest.fixture
def sender(bus: Bus) -> Node:
    """The node of a test that sends."""
    return bus.node("sender")


@pytest.fixture
def receiver(bus: Bus) -> Node:
    """The node of a test that listens."""
    return bus.node("receiver")


@pytest.fixture
def listener(receiver: Node) -> Iterator[TransformListener]:
    """The receiver's listener."""
    with TransformListener(Buffer(), receiver) as listener:
        yield listener


@pytest.fixture
def buffer(listener: TransformListener) -> Buffer:
    """The buffer of the receiver's listener."""
    return listener.buffer
