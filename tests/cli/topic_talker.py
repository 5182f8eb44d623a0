"""Shared by the tests of `tfbus topic`: a node that publishes and subscribes, and the tool."""

from dataclasses import dataclass

from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import Pose, Twist

POSE = Pose(1_000_000_005, 5.5, 2.0, 0.25, 1.0, 0.0)


@dataclass(frozen=True)
class Battery:
    """A message that tfbus does not supply."""

    stamp_ns: int
    cells: list[float]
    name: str
    key: bytes = b""


def run(bus: Bus, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `tfbus topic ARGUMENTS`."""
    done = bus.run("topic", *arguments)
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stdout, done.stderr


def sim(bus: Bus, namespace: str = "") -> Node:
    """A node with the topics of the simulator: it publishes a pose fifty times a second."""
    node = bus.node("sim", namespace=namespace)
    poses = node.create_publisher(Pose, "turtle1/pose")
    node.create_subscription(Twist, "turtle1/cmd_vel", lambda twist: None)
    node.create_timer(0.02, lambda: poses.publish(POSE))
    return node
