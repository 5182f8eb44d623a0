"""Messages on the page in a real Chromium."""

import math
import re
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from tests.live_bus import Bus
from tests.view.pages import Arm, View, eventually, start_view
from tfbus import BusError, Node
from tfbus.bus.presence import describe_nodes
from tfbus.messages import Image, PointCloud, PointStamped, PoseStamped
from tfbus.view.screenshot import CLOSE_NOTES, OPEN_TAB, PICTURES, SHOW_PICTURE
from tfbus.wire.descriptions import NodeDescription

pytestmark = pytest.mark.real


def answers(robot: Node) -> list[NodeDescription]:
    """The descriptions of the view; none if it does not answer in time, as on a busy machine."""
    with suppress(BusError):
        return describe_nodes(robot.session, "/view")
    return []


def test_topics_have_boxes_and_only_ticked_ones_are_subscribed(bus: Bus, pages: Any) -> None:
    """A cloud and an image that are ticked are drawn, and the cloud once more by a link."""
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
    view.page.locator(PICTURES).first.wait_for()
    view.page.get_by_role("checkbox", name="points").check()
    view.page.get_by_text("points: PointCloud").wait_for()
    view.page.locator(".tf-dim").filter(has_text="drawn").nth(1).wait_for()
    [described] = eventually(lambda: answers(robot))
    assert {"points", "camera"} <= described.subscribes.keys()
    assert "others" not in described.subscribes
    links = view.page.locator("button.tf-link")
    links.and_(view.page.locator("[data-topic=points]")).filter(has_text="once more").click()
    again = view.page.get_by_text("points#2: PointCloud")
    again.wait_for()
    links.filter(has_text="Remove").click()
    again.wait_for(state="detached")
    assert view.page.get_by_text("points: PointCloud").is_visible()
    assert view.errors == []


def test_the_tab_with_the_images_is_opened_for_a_picture(bus: Bus, pages: Any) -> None:
    """By its title, so that an image without a camera, which has no place in the scene, is seen."""
    _, address = start_view(bus, "--topic", "camera")
    robot = bus.node("robot")
    images = robot.create_publisher(Image, "camera")
    pixels = np.zeros((8, 8, 3), np.uint8)
    robot.create_timer(0.1, lambda: images.publish(Image.from_pixels(1, "optical", pixels)))
    view = View(pages.new_page(), address)
    view.page.get_by_role("tab", name="Data").wait_for()
    view.page.evaluate(OPEN_TAB.format('"Data"'))
    picture = view.page.locator(PICTURES).first
    picture.wait_for()
    seen = (
        "image => { const box = image.getBoundingClientRect(); return box.bottom < innerHeight; }"
    )
    # The controls above it come one after another, and move it.
    eventually(lambda: not picture.evaluate(seen))
    eventually(lambda: view.page.evaluate(SHOW_PICTURE) or picture.evaluate(seen))


def test_a_group_is_switched_by_its_box_and_settings_are_loaded_from_a_file(
    bus: Bus, pages: Any
) -> None:
    """A topic of a hidden group stays ticked, and is not subscribed; a file replaces that."""
    _, address = start_view(bus, "--topic", "points:group=lidars", "--topic", "camera")
    robot = bus.node("robot")
    Arm(robot)
    clouds = robot.create_publisher(PointCloud, "points")
    robot.create_timer(
        0.1, lambda: clouds.publish(PointCloud.from_xyz(robot.now_ns(), "base", np.eye(3)))
    )
    view = View(pages.new_page(), address)

    def is_subscribed() -> list[bool]:
        return ["points" in each.subscribes for each in answers(robot)]

    eventually(lambda: is_subscribed() == [True])
    view.tab("Data")
    group = view.page.get_by_role("checkbox", name="group lidars")
    group.uncheck()
    eventually(lambda: is_subscribed() == [False])
    assert view.page.get_by_role("checkbox", name="points", exact=True).is_checked()
    view.tab("View")
    chooser = view.page.locator("input[type=file]").first
    chooser.set_input_files(
        {
            "name": "mine.yaml",
            "mimeType": "text/yaml",
            "buffer": b"topics: [{topic: points, group: mine}]\nfixed_frame: base\n",
        }
    )
    view.headline("seen from base")
    eventually(lambda: is_subscribed() == [True])
    view.tab("Data")
    view.page.get_by_role("checkbox", name="group mine").wait_for()
    assert view.errors == []


# The use of tools in quick succession.
_USES = """
const at = [0.5, 0.8];
for (const tool of ['goal', 'point', 'goal', 'point', 'goal'])
  tfbus({do: 'tool', tool, from: at, to: at, step: 1});
"""


def test_no_use_of_a_tool_is_lost(bus: Bus, pages: Any) -> None:
    """By its key on any tab, through the notes of the page, and however quickly one follows
    another. Its button is pressed, also if its tab is opened later.
    """
    _, address = start_view(bus)
    view = View(pages.new_page(), address)
    note = view.page.locator(".mantine-Notification-root").first
    note.wait_for()
    view.page.keyboard.press("c")
    view.page.locator(".tf-aim").wait_for()
    covered = note.evaluate(
        "note => { const box = note.getBoundingClientRect(); return document.elementFromPoint("
        "box.x + box.width / 2, box.y + box.height / 2).className; }"
    )
    assert covered == "tf-aim"
    robot = bus.node("robot")
    Arm(robot)
    sent: list[str] = []
    for kind, topic in ((PoseStamped, "goal_pose"), (PointStamped, "clicked_point")):
        robot.create_subscription(kind, topic, lambda message, to=topic: sent.append(to))
    view.wait_for_status("tool", "dynamic")
    view.page.evaluate(_USES)
    uses = ["clicked_point"] * 2 + ["goal_pose"] * 3
    eventually(lambda: len(sent) >= len(uses))
    assert sorted(sent) == uses
    view.page.keyboard.press("g")
    view.tab("Tools")
    view.page.locator("[data-tool=goal][aria-pressed=true]").wait_for()
    view.page.keyboard.press("Escape")
    view.page.locator("[data-tool=goal][aria-pressed=false]").wait_for()
    assert view.errors == []


def test_a_drag_on_the_ground_sends_a_goal_and_marks_it(bus: Bus, pages: Any) -> None:
    """Along the drag; a page that is read-only only measures, by two clicks."""
    _, address = start_view(bus)
    robot = bus.node("robot")
    Arm(robot)
    goals: list[PoseStamped] = []
    robot.create_subscription(PoseStamped, "goal_pose", goals.append)
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "dynamic")
    view.tab("Tools")
    mouse = view.page.mouse

    def sends() -> bool:
        view.page.evaluate(CLOSE_NOTES)
        view.button("Goal (G)")
        view.page.locator("[data-tool=goal][aria-pressed=true]").wait_for()
        mouse.move(150, 250)
        mouse.down()
        mouse.move(250, 250)
        mouse.up()
        return view.shows(view.page.get_by_text("goal_pose: "), 5.0)

    eventually(sends)
    eventually(lambda: goals)
    [goal, *_] = goals
    assert goal.frame_id == "map"
    turn = goal.pose.orientation
    # The camera looks from behind, a little from the side: its right is there.
    assert math.degrees(2.0 * math.atan2(turn.z, turn.w)) == pytest.approx(-20.0, abs=10.0)
    assert view.errors == []
    _, other = start_view(bus, "--read-only", "--name", "other")
    public = View(pages.new_page(), other)
    public.wait_for_status("tool", "dynamic")
    public.tab("Tools")

    def measures() -> bool:
        public.button("Measure (M)")
        for x in (150, 250):
            public.click_at(x, 250)
        return public.shows(public.page.get_by_role("log", name="measured"), 5.0)

    eventually(measures)
    assert re.match(r"\d+\.\d{3} m: x ", public.page.get_by_label("measured").inner_text())
    assert public.page.locator("[data-tool]").count() == 2


def test_a_click_on_a_point_of_a_cloud_shows_its_row(bus: Bus, pages: Any) -> None:
    """Its columns are those of its index, and its place in both frames is that of this row."""
    _, address = start_view(bus, "--topic", "points", "--read-only")
    robot = bus.node("robot")
    Arm(robot)
    clouds = robot.create_publisher(PointCloud, "points")
    grid = np.stack(np.meshgrid(*[np.linspace(-10.0, 10.0, 201)] * 2, [0.0]), axis=-1)
    xyz = grid.reshape(-1, 3)
    number = np.arange(len(xyz), dtype=np.uint32)
    robot.create_timer(
        0.2,
        lambda: clouds.publish(PointCloud.from_xyz(robot.now_ns(), "base", xyz, number=number)),
    )
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "dynamic")
    view.tab("Tools")
    selected = view.page.get_by_role("log", name="selected")

    def selects() -> bool:
        view.button("Select (I)")
        view.click_at(200, 250)
        return view.shows(selected, 5.0)

    eventually(selects)
    text = selected.inner_text()
    index = int(re.search(r"points: point (\d+)", text)[1])
    x, y, _ = xyz[index]
    facts = dict(zip(*[iter(selected.locator("dt, dd").all_inner_texts())] * 2, strict=True))
    assert facts["number"] == str(index)
    places = {frame: [*map(float, facts[f"in {frame}"].split(","))] for frame in ("base", "map")}
    assert places["base"] == pytest.approx([x, y, 0.0], abs=1e-3)
    assert places["map"] == pytest.approx([x + 1.0, y, 0.0], abs=1e-3)
    view.page.get_by_role("button", name="remove").click()
    selected.wait_for(state="detached")
    assert view.errors == []
