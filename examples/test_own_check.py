"""Checks of one's own on the frames of a robot, with no other names than those of tfbus.inspect.

    python examples/test_own_check.py

The robot runs in a simulated network. `Recorded(FILE)` in place of `Watch` checks a recording.
"""

import sys

import pytest

import tfbus
from tfbus.inspect import Watch
from tfbus.nodes import broadcaster, simulator
from tfbus.testing import Network


def test_the_frames_of_a_robot_are_well(network: Network) -> None:
    """Each comes often and soon enough, and nothing disputes it until its publisher is killed."""
    network.host("robot")
    network.program("robot", simulator.main, "--headless")
    network.program("robot", broadcaster.main, "--param", "turtlename=turtle1", name="turtle")
    with network.process("robot", "checker"), tfbus.Node("checker") as node, Watch(node) as bus:
        changes = bus.changes()
        assert any(each.name == "turtle1" for each in changes if each.kind == "frame appeared")
        network.run(10.0)
        turtle = bus.now().frames["turtle1"]
        assert turtle.state == "dynamic" and turtle.rate_hz and turtle.rate_hz > 50.0
        assert turtle.delay_s is not None and turtle.delay_s < 0.05
        assert bus.now().problems == ()
        network.kill("robot/turtle")
        gone = next(each for each in changes if each.kind == "problem begun")
        assert gone.problem and gone.problem.kind == "gone" and gone.problem.remedy


if __name__ == "__main__":
    sys.exit(pytest.main(["-q", __file__]))
