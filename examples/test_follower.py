"""Tests that a follower finds its carrot over a link that loses packets and fails for a while.

    python examples/test_follower.py

The turtles of the tutorial run on two simulated hosts; a minute of them takes a second. `pytest
examples/test_follower.py --tfbus-seed random` tries another course of events each time.
"""

import sys
from math import hypot

import pytest

import tfbus
from tfbus.nodes import broadcaster, carrot, follow, simulator
from tfbus.testing import Network


class Turtles:
    """A robot with two turtles; a base, from which one of them is driven to a carrot."""

    def __init__(self, network: Network) -> None:
        self.network = network
        network.host("robot")
        network.host("base", offset_s=0.2)  # a clock that is 0.2 s ahead
        network.path("robot", "base", delay_s=0.02, jitter_s=0.01, loss=0.2)
        # Each as `tfbus simulator --headless` and so on.
        network.program("robot", simulator.main, "--headless")
        for turtle in ("turtle1", "turtle2"):
            words = f"--name of_{turtle} --param turtlename={turtle} --param drone=above_{turtle}"
            network.program("robot", broadcaster.main, *words.split(), name=turtle)
        network.program("base", carrot.main)
        network.program("base", follow.main, "--param", "target_frame=carrot1")
        with network.process("robot", "referee"):
            self.buffer = tfbus.Buffer()
            tfbus.TransformListener(self.buffer, tfbus.Node("referee"))

    def distance_m(self) -> float:
        """From the follower to its carrot."""
        try:
            carrot_of = self.buffer.lookup_transform("turtle2", "carrot1").transform
        except tfbus.TransformException:
            return float("inf")
        return hypot(carrot_of.x, carrot_of.y)


def test_it_finds_its_carrot(network: Network) -> None:
    """One packet in five is lost, and the follower gets there all the same."""
    turtles = Turtles(network)
    network.run(until=lambda: turtles.distance_m() < 0.1)


def test_it_finds_its_carrot_after_the_link_has_failed(network: Network) -> None:
    """The link fails on the way, for ten seconds; then the follower goes on."""
    turtles = Turtles(network)
    network.run(until=lambda: turtles.distance_m() < 2.0)
    network.partition("robot", "base")
    network.run(10.0)
    network.heal()
    network.run(until=lambda: turtles.distance_m() < 0.1)


def test_it_finds_its_carrot_after_it_was_restarted(network: Network) -> None:
    """The follower crashes on the way, and is started anew."""
    turtles = Turtles(network)
    network.run(until=lambda: turtles.distance_m() < 2.0)
    network.restart("base/follow")
    network.run(until=lambda: turtles.distance_m() < 0.1)


if __name__ == "__main__":
    sys.exit(pytest.main(["-q", __file__]))
