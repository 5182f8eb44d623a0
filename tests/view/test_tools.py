"""RViz's tools: the message of a drag or a click on the scene, and the place that it meets."""

import math
import re
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tests.view.cameras import Server, camera
from tfbus import Transform
from tfbus.messages import (
    PointStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    Vector3,
)
from tfbus.view.data.picked import PickedPoint
from tfbus.view.data.topics import TOOLS, ToolPublishers
from tfbus.view.panels.markup import Channel
from tfbus.view.panels.pointing import Pointing, heading_of, mark_size
from tfbus.view.panels.tools import ToolsPanel
from tfbus.view.scene.camera import Cameras, Ray, Viewport
from tfbus.view.scene.drawn import Drawn
from tfbus.view.settings import ViewSettings, ViewState

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


def test_a_goal_that_nobody_heard_is_told_as_such(bus: Bus) -> None:
    """Also once somebody subscribes: it is not sent again by itself."""
    robot, tools = bus.node("robot"), ToolPublishers(bus.node("view"))
    tools.keep(ViewSettings())
    gui: Any = Gui()
    goal = TOOLS["goal"]
    panel = ToolsPanel(gui, ViewState(ViewSettings()), Channel(), tools)

    def sends() -> str:
        panel.note(goal, "goal_pose: here", was_heard=tools.is_heard(goal))
        return shows()

    def shows() -> str:
        panel.refresh(0.0, lambda topic: 1)
        return str(gui.texts[-1].content)

    assert "nobody subscribed" in sends()
    robot.create_subscription(PoseStamped, "goal_pose", lambda message: None)
    eventually(lambda: tools.is_heard(goal))
    assert "nobody subscribed" in shows()
    assert "goal_pose: here; 1 subscription" in sends()


def test_a_subscriber_outside_of_the_namespace_hears_a_tool(bus: Bus) -> None:
    """A goal on an absolute topic has a subscriber there."""
    tools = ToolPublishers(bus.node("view", namespace="robot7"))
    tools.keep(ViewSettings(goal_topic="/goal_pose"))
    assert not tools.is_heard(TOOLS["goal"])
    bus.node("planner").create_subscription(PoseStamped, "goal_pose", lambda message: None)
    eventually(lambda: tools.is_heard(TOOLS["goal"]))


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
    """The ground, triangles from either side, and points within some pixels; else nothing. Of
    points that are as far away, the one that it passes closest.
    """
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
    behind = np.array([(0.05, 0.0, 1.01), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
    assert TOP.first_of(behind) == (1, 9.0)
    moved = TOP.seen_from(Transform.from_rpy(0.4, 0.2, 1.0, xyz=(7.0, -2.0, 1.0)))
    pose = Transform.from_rpy(0.4, 0.2, 1.0, xyz=(7.0, -2.0, 1.0)).inverse()
    assert moved.to_triangles(pose.apply(square), np.array([(0, 1, 2)])) == pytest.approx(8.0)


class Above:
    """A page whose browser looks straight down from 10 m, where a pixel is a centimetre."""

    def __init__(self) -> None:
        seen = camera((0.0, 0.0, 10.0), (0.0, 0.0, 0.0))
        seen.wxyz, seen.fov = (0.0, 1.0, 0.0, 0.0), 2.0 * math.atan(0.5)
        seen.image_width = seen.image_height = 1000
        server: Any = Server(seen)
        self.gui = server.gui = Gui()
        server.scene = server.clients[0].scene = MagicMock()
        self.told: list[str] = []
        server.clients[0].add_notification = lambda title, why, **options: self.told.append(title)
        self.drawn = Drawn(server.scene)
        self.channel = Channel()
        self.panel = ToolsPanel(server.gui, ViewState(ViewSettings()), self.channel, None)
        self._pointing = Pointing(server, Cameras(server), self.drawn, self.panel)

    def click(self, x: float, y: float, step: int, frame: str = "map", height_m: float = 0) -> str:
        """A click on a point of the ground, or on a plate above it; what is measured then."""
        part = [0.5 + x / (10.0 - height_m), 0.5 - y / (10.0 - height_m)]
        sent = {"do": "tool", "tool": "measure", "from": part, "to": part, "step": step}
        self.channel.receive(sent, 0)
        far = 10.0 - height_m if height_m else math.inf
        self._pointing.use(frame, 0.5, lambda ray: far / -ray.direction[2], lambda ray: None)
        return self.measured()

    def select(self, point: PickedPoint | None) -> str:
        """A click there, where this point is met; the panel's texts then."""
        at = [0.5, 0.5]
        self.channel.receive({"do": "tool", "tool": "select", "from": at, "to": at, "step": 1}, 0)
        self._pointing.use("map", 0.5, lambda ray: math.inf, lambda ray: point)
        self.panel.refresh(0.0, lambda topic: 0)
        return "".join(each.content for each in self.gui.texts)

    def measured(self) -> str:
        """The line of the panel."""
        self.panel.refresh(0.0, lambda topic: 0)
        found = re.search("<b>(.*?)</b>", "".join(each.content for each in self.gui.texts))
        return found[1] if found else ""


class Gui:
    """The texts of a panel."""

    def __init__(self) -> None:
        self.texts: list[Any] = []

    def add_html(self, content: str) -> Any:
        """As viser's."""
        self.texts.append(SimpleNamespace(content=content))
        return self.texts[-1]

    def add_text(self, label: str, value: str) -> Any:
        """As viser's."""
        return SimpleNamespace(value=value, on_update=lambda callback: None)


def test_two_clicks_measure_the_distance_and_its_parts_along_the_axes() -> None:
    """On the ground, or on what is drawn above it; all is marked in the scene, and removed."""
    above = Above()
    assert above.click(1.0, 1.0, 1) == ""
    assert above.click(-1.0, 3.0, 2, height_m=1.0) == ("3.000 m: x -2.000, y 2.000, z 1.000 in map")
    marks = {"measured", "measured from", "measured text"}
    assert marks <= above.drawn.shapes.keys()
    assert {each.frame for each in above.drawn.shapes.values()} == {"map"}
    above.channel.receive({"do": "unfind", "tool": "measure"}, 0)
    assert above.click(0.0, 0.0, 1) == ""
    assert "measured" not in above.drawn.shapes


def test_a_measure_begins_anew_with_its_first_click_and_another_fixed_frame() -> None:
    """A first click that was given up is not the start of the next one."""
    above = Above()
    above.click(4.0, 4.0, 1)
    above.click(1.0, 1.0, 1)
    assert above.click(1.0, 2.0, 2).startswith("1.000 m: x 0.000, y 1.000, z 0.000")
    above.click(1.0, 1.0, 1)
    assert above.click(3.0, 1.0, 2, "odom").startswith("1.000 m")
    assert above.click(4.0, 1.0, 2, "odom").startswith("1.000 m: x 1.000, y 0.000")


def test_a_click_selects_a_point_and_shows_its_row_until_it_is_removed() -> None:
    """Its places and columns, of which the names are text; a click elsewhere leaves it selected."""
    above = Above()
    places = {"lidar": (1.0, 2.0, -0.0001), "map": (3.0, 4.0, 5.0)}
    point = PickedPoint("points#2", 17, places, {"ring": "3", "<b>": "0"})
    assert "point 17" not in above.select(None)
    for met in (point, None):
        text = above.select(met)
        assert "<b>points#2: point 17</b>" in text
        assert re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", text) == [
            ("in lidar", "1.000, 2.000, 0.000"),
            ("in map", "3.000, 4.000, 5.000"),
            ("ring", "3"),
            ("&lt;b&gt;", "0"),
        ]
    assert {"selected", "selected text"} <= above.drawn.shapes.keys()
    above.channel.receive({"do": "unfind", "tool": "select"}, 0)
    assert "point 17" not in above.select(None)
    assert not above.drawn.shapes
    assert above.told == ["Nothing was selected"] * 3


def test_a_mark_is_seen_from_far_away_and_never_smaller_than_axes() -> None:
    """At least a twelfth of the way to it, as high in the picture from everywhere."""
    assert mark_size(0.5, 1.0) == 1.0
    for way_m in (100.0, 1000.0):
        assert mark_size(0.5, way_m) / way_m == pytest.approx(mark_size(0.5, 50.0) / 50.0)
        assert mark_size(0.5, way_m) > way_m / 15.0


def test_a_drag_gives_the_heading_along_the_ground_and_a_click_none() -> None:
    """Also one that ends above the horizon."""
    at = TOP.at(10.0)
    beside = Ray(TOP.origin, np.array((0.0, 0.6, -0.8)))
    level = Ray(TOP.origin, np.array((-1.0, 0.0, 0.0)))
    assert heading_of(TOP, beside, at) == pytest.approx(math.pi / 2)
    assert heading_of(TOP, level, at) == pytest.approx(math.pi)
    assert heading_of(TOP, TOP, at) == 0.0
