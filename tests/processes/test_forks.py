"""Processes that fork with a node open: the child has a clear error, the parent goes on."""

import os
import sys
from pathlib import Path

import pytest

from tests.live_bus import Bus, Process, keep_sending

pytestmark = [pytest.mark.real, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]

_PROGRAM = Path(__file__).with_name("forking_node.py")


def forked(bus: Bus, use: str) -> Process:
    """The process, ended, whose child used the node so; the parent was unharmed."""
    keep_sending(bus.node("sim"), "map", "robot")
    process = bus.start_command([sys.executable, str(_PROGRAM), use])
    process.wait_for_line("parent closed")
    assert process.wait() == 0
    assert "parent runs: True" in process.out
    assert "parent hears robot" in process.out
    return process


@pytest.mark.parametrize("use", ["another node", "send", "spin", "timer", "listen"])
def test_a_forked_child_that_uses_the_bus_gets_an_error_that_names_spawn(
    bus: Bus, use: str
) -> None:
    """Each use of a parent's node, and a new one, raise BusError at once in the child."""
    process = forked(bus, use)
    assert "set_start_method('spawn')" in process.wait_for_line("^child: ")
    assert "child ended: 0" in process.out


@pytest.mark.parametrize("use", ["close", "leave", "nothing"])
def test_a_forked_child_leaves_its_parents_node_alone(bus: Bus, use: str) -> None:
    """The child may close the node or simply end, and the parent does not notice."""
    assert "child ended: 0" in forked(bus, use).out


def test_a_signal_to_a_forked_child_ends_the_child_only(bus: Bus) -> None:
    """SIGTERM, as `Process.terminate` sends it, ends the child as it does without a node."""
    assert "child ended: -15" in forked(bus, "signal").out
