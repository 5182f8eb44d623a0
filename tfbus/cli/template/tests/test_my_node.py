"""The node my_node."""

import math

from my_robot.my_node import pose_at, start

import tfbus


def test_the_robot_stays_on_its_circle() -> None:
    """At any time the robot is one radius away from the origin."""
    for time_s in (0.0, 1.0, 12.5):
        x, y, z = pose_at(time_s, 2.0).xyz
        assert math.isclose(math.hypot(x, y), 2.0)
        assert z == 0.0


def test_the_node_broadcasts_its_frame() -> None:
    """A listener learns where the robot is."""
    buffer = tfbus.Buffer()
    with tfbus.Node("test_my_node") as node, tfbus.TransformListener(buffer, node):
        start(node)
        found = buffer.lookup_transform("world", "my_robot", timeout_s=5.0)
    assert math.isclose(math.hypot(*found.transform.xyz), 1.0)
