"""Processes that fork with a node open: the child has a clear error, the parent goes on."""

import os
import sys
from pathlib import Path

import pytest

from tests.buses import keep_sending
from tests.live_bus import Bus, Process

pytestmark = [pytest.mark.real, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]

_PROGRAM = Path(__file__).with_name("forking_node.py")


def forked(bus: Bus, *uses: str) -> Process:
    """The process, ended, whose children used the node so; the parent was unharmed."""
    keep_sending(bus.node("sim"), "map", "robot")
    process = bus.start_command([sys.executable, str(_PROGRAM), *uses])
    process.wait_for_line("parent closed")
    assert process.wait() == 0
    assert "parent runs: True" in process.out
    assert "parent hears robot" in process.out
    return process


def ends(process: Process) -> list[str]:
    """How its children ended."""
    return [line for line in process.out if line.startswith("child ended")]


def test_a_forked_child_that_uses_the_bus_gets_an_error_that_names_spawn(bus: Bus) -> None:
    """Each use of a parent's node, and a new one, raise BusError at once in the child."""
    process = forked(bus, "another node", "send", "spin", "timer", "listen")
    errors = [line for line in process.out if line.startswith("child: ")]
    assert len(errors) == 5
    assert all("set_start_method('spawn')" in error for error in errors)
    assert ends(process) == ["child ended: 0"] * 5


def test_a_forked_child_leaves_its_parents_node_alone(bus: Bus) -> None:
    """The child may close the node or simply end, and the parent does not notice."""
    assert ends(forked(bus, "close", "leave", "nothing")) == ["child ended: 0"] * 3


def test_a_signal_to_a_forked_child_ends_the_child_only(bus: Bus) -> None:
    """SIGTERM, as `Process.terminate` sends it, ends the child as it does without a node."""
    assert ends(forked(bus, "signal")) == ["child ended: -15"]
