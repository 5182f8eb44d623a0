"""How a node ends: at any moment, within seconds, with exit code 0."""

import sys
from signal import SIGINT, SIGTERM

import pytest
from conftest import Bus

from tfbus import Node
from tfbus.presence import NodeWatch

WAITS_IN_A_CALLBACK = """
import tfbus
buffer = tfbus.Buffer()
with tfbus.Node("waits") as node:
    def look() -> None:
        print("looking", flush=True)
        buffer.lookup_transform("nowhere", "either", timeout_s=600.0)
    node.create_timer(0.01, look)
    node.spin()
"""

WAITS_AFTER_THE_SIGNAL = """
import os, signal, tfbus
from tfbus.messages import Spawn
with tfbus.Node("waits") as node:
    client = node.create_client(Spawn, "spawn")
    print("first", flush=True)
    node.wait(None)
    print("second", flush=True)
    client.wait_for_service()
"""

SIGNAL_WHILE_IT_IS_MADE = """
import signal, tfbus, tfbus.node
declare = tfbus.Node._declare_itself
def interrupted(self: tfbus.Node) -> None:
    signal.raise_signal(signal.SIGINT)
    declare(self)
tfbus.Node._declare_itself = interrupted
try:
    tfbus.Node("x")
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_callback_that_waits_does_not_hold_up_the_end(bus: Bus, number: int) -> None:
    """A node ends although one of its callbacks waits for a transform that never comes."""
    process = bus.start_command([sys.executable, "-c", WAITS_IN_A_CALLBACK])
    process.wait_for_line("looking")
    assert process.stop(number) == 0
    process.wait_for_line("Did not wait for a callback that goes on")


def test_another_signal_interrupts_what_waits_after_the_first(bus: Bus) -> None:
    """A program that goes on to wait after Ctrl-C is ended by the next one."""
    process = bus.start_command([sys.executable, "-c", WAITS_AFTER_THE_SIGNAL])
    process.wait_for_line("first")
    process.signal(SIGINT)
    process.wait_for_line("second")
    assert process.stop(SIGINT) == 0
    assert process.err == []


def test_a_signal_while_a_node_is_made_is_not_lost(bus: Bus) -> None:
    """Ctrl-C during `Node()` ends it, and is told as KeyboardInterrupt."""
    process = bus.start_command([sys.executable, "-c", SIGNAL_WHILE_IT_IS_MADE])
    assert process.wait() == 0
    assert process.out == ["interrupted"]
    assert process.err == []


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_node_ends_from_the_moment_it_is_there(bus: Bus, number: int) -> None:
    """A node that is told to end as soon as it is listed ends with 0 and without a traceback."""
    watcher: Node = bus.node("watcher")
    watch = NodeWatch(watcher.session)
    for at in range(4):
        process = bus.start("follow", "--name", f"follow{at}")
        assert watch.wait(f"/follow{at}", timeout_s=20.0)
        assert process.stop(number) == 0
        assert not any("Traceback" in line for line in process.err)
