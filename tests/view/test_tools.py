"""RViz's tools: what a drag or a click on the scene sends, and what it meets there."""

import math
from typing import Any

import numpy as np
import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Transform
from tfbus.messages import (
    PointStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    Vector3,
)
from tfbus.view.data.topics import TOOLS, ToolPublishers
from tfbus.view.scene.camera import Ray, Viewport
from tfbus.view.settings import ViewSettings

TOP = Ray(np.array((0.0, 0.0, 10.0)), np.array((0.0, 0.0, -1.0)))


def test_each_tool_sends_the_message_of_rviz_on_its_topic(bus: Bus) -> None:
    """A goal, an initial pose with RViz's covariance, and a point; stamped, in the fixed frame."""
    robot, view = bus.node("robot"), bus.node("view")
    tools = ToolPublishers(view)
    tools.keep(ViewSettings())
    got: dict[str, Any] = {}
    for kind, topic in (
        (PoseStamped, "goal_pose"),
        (PoseWithCovarianceStamped, "initialpose"),
        (PointStamped, "clicked_point"),
    ):
        robot.create_subscription(kind, topic, lambda message, at=topic: got.update({at: message}))

    def all_came() -> bool:
        for tool in TOOLS.values():
            assert tools.send(tool, "map", (1.0, 2.0, 0.0), math.pi / 2)
        return len(got) == 3

    eventually(all_came)
    half = math.sqrt(0.5)
    pose = got["goal_pose"].pose
    assert pose == got["initialpose"].pose.pose
    assert (pose.position, pose.orientation.x) == (Vector3(1.0, 2.0), 0.0)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((half, half))
    assert got["clicked_point"].point == Vector3(1.0, 2.0)
    covariance = np.reshape(got["initialpose"].pose.covariance, (6, 6))
    sides = np.sqrt(np.diag(covariance))
    assert sides.tolist() == pytest.approx([0.5, 0.5, 0, 0, 0, math.radians(15)])
    for message in got.values():
        assert message.frame_id == "map"
        assert abs(message.stamp_ns - view.now_ns()) < 5_000_000_000


def test_another_topic_replaces_the_publisher_and_a_wrong_one_is_named(bus: Bus) -> None:
    """The others stay."""
    tools = ToolPublishers(bus.node("view"))
    tools.keep(ViewSettings())
    tools.keep(ViewSettings(goal_topic="arm/goal", point_topic="not a name"))
    assert [tools.topic(tool) for tool in TOOLS.values()] == ["arm/goal", "initialpose", ""]
    assert "not a name" in tools.mistakes["point"]
    assert not tools.send(TOOLS["point"], "map", (0.0, 0.0, 0.0), 0.0)
    listed = eventually(lambda: bus.run("topic", "list").stdout or None)
    assert "arm/goal" in listed
    assert "goal_pose" not in listed


def test_the_ray_through_a_pixel_meets_the_point_that_is_drawn_there() -> None:
    """As `project` has it, from any camera."""
    turn = Transform.from_rpy(2.2, 0.3, -0.7, xyz=(3.0, -4.0, 5.0))
    window = Viewport(np.array(turn.xyz), turn.as_matrix()[:3, :3], 1.2, (800, 600))
    point = turn.apply((0.4, -0.7, 6.0))
    pixels, _ = window.project(point[None])
    ray = window.ray((pixels[0, 0] / 800, pixels[0, 1] / 600))
    np.testing.assert_allclose(ray.at(float(np.linalg.norm(point - turn.xyz))), point)


def test_a_ray_meets_the_nearest_of_what_is_there() -> None:
    """The ground, triangles from either side, and points within some pixels; else nothing."""
    assert TOP.to_ground() == 10.0
    assert Ray(TOP.origin, np.array((1.0, 0.0, 0.0))).to_ground() == math.inf
    assert Ray(TOP.origin, np.array((0.0, 0.0, 1.0))).to_ground() == math.inf
    square = np.array([(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)], float)
    both = np.concatenate((square, np.add(square, (0, 0, 3))))
    for order in ((0, 1, 2), (0, 2, 1)):
        faces = np.array([order, np.array(order) + 4])
        assert TOP.to_triangles(both, faces) == 5.0
    assert TOP.to_triangles(np.add(square, (5, 0, 0)), np.array([(0, 1, 2)])) == math.inf
    points = np.array([(0.0, 0.01, 1.0), (0.0, 0.0, -3.0), (2.0, 0.0, 5.0), (0.0, 0.0, 12.0)])
    assert TOP.to_points(points) == 9.0
    assert TOP.to_points(points[2:]) == math.inf
    moved = TOP.seen_from(Transform.from_rpy(0.4, 0.2, 1.0, xyz=(7.0, -2.0, 1.0)))
    pose = Transform.from_rpy(0.4, 0.2, 1.0, xyz=(7.0, -2.0, 1.0)).inverse()
    assert moved.to_triangles(pose.apply(square), np.array([(0, 1, 2)])) == pytest.approx(8.0)
