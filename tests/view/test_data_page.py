"""Messages on the page in a real Chromium."""

from typing import Any

import numpy as np
import pytest

from tests.live_bus import Bus
from tests.view.pages import Arm, View, start_view
from tfbus.discover.presence import describe_nodes
from tfbus.messages import Image, PointCloud

pytestmark = pytest.mark.real


def test_topics_have_boxes_and_only_ticked_ones_are_subscribed(bus: Bus, pages: Any) -> None:
    """A cloud and an image that are ticked are drawn; a cloud that cannot be says why."""
    _, address = start_view(bus, "--topic", "camera")
    robot = bus.node("robot")
    Arm(robot)
    clouds = robot.create_publisher(PointCloud, "points")
    images = robot.create_publisher(Image, "camera")
    robot.create_publisher(PointCloud, "others")

    def publish() -> None:
        now_ns = robot.now_ns()
        clouds.publish(PointCloud.from_xyz(now_ns, "base", np.eye(3)))
        images.publish(Image.from_pixels(now_ns, "tool", np.zeros((8, 8, 3), np.uint8)))

    robot.create_timer(0.1, publish)
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "dynamic")
    view.tab("Data")
    view.page.locator("img[src^='data:image/jpeg'], img[src^='blob:']").first.wait_for()
    view.field("points").check()
    view.page.get_by_text("points: PointCloud").wait_for()
    view.page.locator(".tf-dim").filter(has_text="drawn").nth(1).wait_for()
    [described] = describe_nodes(robot.session, "/view")
    assert {"points", "camera"} <= described.subscribes.keys()
    assert "others" not in described.subscribes
    assert view.errors == []
