"""A robot on the page of a real `tfbus view`, with robot_state and joints beside it."""

from pathlib import Path
from typing import Any

import pytest

from tests.live_bus import Bus
from tests.view.pages import View, eventually, start_view
from tfbus.messages import JointState

pytestmark = pytest.mark.real

ARM = """<robot name="arm">
<link name="base"><visual><geometry><box size="0.2 0.2 0.4"/></geometry></visual></link>
<link name="hand"><visual><geometry><box size="0.1 0.1 0.4"/></geometry></visual></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="hand"/>
  <origin xyz="0 0 0.4"/><axis xyz="1 0 0"/>
  <limit lower="0.5" upper="1.5" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_robot_on_the_bus_has_sliders_that_move_it_and_follow_it(
    bus: Bus, pages: Any, tmp_path: Path
) -> None:
    """Its description comes over the bus; the page needs no file."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(ARM)
    states: list[JointState] = []
    watcher = bus.node("watcher")
    watcher.create_subscription(JointState, "joint_states", states.append)
    bus.start("robot_state", str(urdf))
    bus.start("joints", str(urdf))
    _, address = start_view(bus)
    view = View(pages.new_page(), address)
    view.wait_for_status("hand", "dynamic")
    view.tab("Robot")
    view.page.locator("[data-robot-row='arm']").get_by_text("2 links").wait_for()
    slider = view.field("lift")
    eventually(lambda: slider.input_value() == "1")
    slider.fill("1.25")
    eventually(lambda: states and states[-1].position == (1.25,))
    view.page.get_by_role("button", name="Zero", exact=True).click()
    eventually(lambda: slider.input_value() == "1")
    eventually(lambda: states[-1].position == (1.0,))
    view.page.get_by_role("checkbox", name="show robot arm").click()
    view.tab("Frames")
    assert view.errors == []


def test_a_robot_of_a_file_stands_on_the_page_without_any_frames(
    bus: Bus, pages: Any, tmp_path: Path
) -> None:
    """The headline says what publishes them."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(ARM)
    _, address = start_view(bus, "--urdf", str(urdf))
    view = View(pages.new_page(), address)
    view.headline("tfbus robot_state publishes the frames of arm")
    view.tab("Robot")
    view.page.locator("[data-robot-row='arm']").get_by_text("stands by itself").wait_for()
    assert view.field("lift").is_enabled()
