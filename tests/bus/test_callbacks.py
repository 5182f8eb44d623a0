"""Zenoh's threads, whose Python state is kept: processes end, and may fork, in spite of them."""

import sys

import pytest

from tests.processes.publishers import launch
from tests.simulated_bus import Bus

# Ends while messages arrive, without closing anything.
NO_CLOSE = """
import tfbus
buffer = tfbus.Buffer()
node = tfbus.Node("listener")
listener = tfbus.TransformListener(buffer, node)
buffer.lookup_transform("map", "base", timeout_s=120.0)
print("ends", flush=True)
"""

# A child of a fork has no threads of Zenoh's, and must end without them.
FORK = """
import multiprocessing, os, sys, tfbus
buffer = tfbus.Buffer()
with tfbus.Node("listener") as node, tfbus.TransformListener(buffer, node):
    buffer.lookup_transform("map", "base", timeout_s=120.0)
    child = os.fork()
    if not child:
        os._exit(7)
    print("fork", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    worker = multiprocessing.get_context("fork").Process(target=print, args=("worker",))
    worker.start()
    worker.join()
    print("exit", worker.exitcode, flush=True)
    stamp = buffer.lookup_transform("map", "base").stamp_ns
    while buffer.lookup_transform("map", "base").stamp_ns == stamp:
        node.wait(0.01)
"""

# Zenoh tells of what is there already on the thread that asks, and swallows what is raised.
INTERRUPTED = """
import signal, threading, tfbus
from tfbus.bus.presence import watch_nodes

def on_node(name, alive):
    if threading.current_thread() is threading.main_thread():
        print("interrupted", flush=True)
        signal.raise_signal(signal.SIGINT)

with tfbus.Node("waiting") as node:
    try:
        watch_nodes(node.session, on_node)
        node.spin()
    except KeyboardInterrupt:
        pass
"""


@pytest.fixture
def busy(bus: Bus) -> Bus:
    """A bus with dynamic transforms all the time."""
    dynamic = [argument for child in "abcdefgh" for argument in ("--moving", f"base:{child}")]
    for name in ("one", "two"):
        edges = ("--moving", "map:base") if name == "one" else dynamic
        launch(bus, name, *edges)
    return bus


@pytest.mark.real
def test_a_process_ends_while_messages_arrive(busy: Bus) -> None:
    """A program that closes nothing ends with 0 and prints nothing."""
    for _ in range(3):
        process = busy.start_command([sys.executable, "-c", NO_CLOSE])
        process.wait_for_line("ends")
        assert process.wait() == 0
        assert process.err == []


@pytest.mark.real
def test_a_process_may_fork_while_messages_arrive(busy: Bus) -> None:
    """A child of a fork ends with its own exit code, and its parent goes on receiving."""
    process = busy.start_command([sys.executable, "-c", FORK])
    process.wait_for_line("exit")
    assert process.wait() == 0
    assert process.out == ["fork 7", "worker", "exit 0"]


@pytest.mark.real
def test_ctrl_c_in_a_callback_on_the_main_thread_ends_the_process(bus: Bus) -> None:
    """It ends what the main thread does, or waits for, next."""
    process = bus.start_command([sys.executable, "-c", INTERRUPTED])
    process.wait_for_line("interrupted")
    assert process.wait() == 0
