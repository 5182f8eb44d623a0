"""The page of `tfbus view` in a real headless Chromium: the clicks of people, and their view."""

import re
from pathlib import Path
from typing import Any

import pytest

from tests.live_bus import Bus
from tests.view.pages import Arm, View, eventually, start_view
from tfbus import StaticTransformBroadcaster, Transform
from tfbus import TransformStamped as Stamped

pytestmark = pytest.mark.real


# The scroll bar of the panel, whose facts of a frame need more height than this window has.
PANEL_BAR = (
    ".mantine-ScrollArea-root:has(.tfbus-channel) "
    "> .mantine-ScrollArea-scrollbar[data-orientation=vertical]"
)


def ends(view: View, selector: str) -> tuple[float, float]:
    """The left and the right end of an element, in pixels."""
    box = view.page.locator(selector).bounding_box()
    return box["x"], box["x"] + box["width"]


def test_a_page_shows_frames_as_they_come_and_go(bus: Bus, pages: Any) -> None:
    """It waits, shows frames with their states from any fixed frame, beside the scroll bar of the
    panel, and says which are gone.
    """
    _, address = start_view(bus)
    view = View(pages.new_page(), address)
    view.headline("Waiting for transforms")
    eventually(lambda: re.match("tfbus · .*", view.page.title()))

    arm = bus.node("arm")
    Arm(arm)
    view.headline("4 frames, seen from map")
    view.wait_for_status("tool", "dynamic")
    view.wait_for_status("lamp", "static")
    view.wait_for_status("map", "root")

    view.choose("Fixed frame", "base")
    view.headline("4 frames, seen from base")
    view.select("lamp")
    view.page.locator("#tf-in-fixed").filter(has_text="xyz  [-1.000, 2.000, 0.000]").wait_for()
    assert view.block("tf-in-parent").startswith("xyz  [0.000, 2.000, 0.000]")
    pages.grant_permissions(["clipboard-read", "clipboard-write"])
    view.page.get_by_role("button", name="copy in its parent map").click()
    copied = "() => navigator.clipboard.readText()"
    eventually(lambda: view.page.evaluate(copied).startswith("xyz  [0.000, 2.000, 0.000]"))
    assert "arm" in view.page.get_by_text("Publisher").locator("xpath=..").inner_text()

    view.select("tool")
    assert ends(view, "[role=tree]")[1] <= ends(view, PANEL_BAR)[0] + 1.0
    view.page.get_by_label("show tool").uncheck()

    arm.close()
    view.wait_for_status("tool", "gone")
    view.headline("gone")
    assert view.page.locator("[data-row='tool'].tf-selected").is_visible()
    view.page.reload()
    view.wait_for_status("lamp", "gone")
    assert not view.page.get_by_label("show tool").is_checked()
    assert view.page.get_by_role("tab", name="Turtles").count() == 0
    assert view.errors == []


def test_time_can_be_held_and_moved_back(bus: Bus, pages: Any) -> None:
    """Pause stops the numbers; the slider shows past ones; Follow goes on."""
    _, address = start_view(bus)
    Arm(bus.node("arm"))
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "dynamic")
    view.select("tool")

    def x_m() -> float:
        return float(re.findall(r"xyz +\[(\S+),", view.block("tf-in-parent"))[0])

    eventually(lambda: x_m() > 1.5)
    view.page.get_by_role("button", name="Pause").click()
    view.headline("paused at")
    held_m = eventually(lambda: (now := x_m()) == x_m() and now)
    ago = view.field("Seconds ago")
    ago.fill("-1")
    ago.press("Enter")
    eventually(lambda: held_m - 1.5 < x_m() < held_m - 0.5)
    view.page.get_by_role("button", name="Follow", exact=True).click()
    eventually(lambda: x_m() > held_m)
    assert view.errors == []


def test_all_browsers_share_their_choices(bus: Bus, pages: Any) -> None:
    """Boxes, the fixed frame and the time; also after one of three browsers has left."""
    _, address = start_view(bus)
    Arm(bus.node("arm"))
    views = [View(pages.new_page(), address) for _ in range(3)]
    for view in views:
        view.wait_for_status("tool", "dynamic")
    views[0].page.get_by_role("button", name="none").click()
    for view in views:
        eventually(lambda view=view: not view.page.get_by_label("show tool").is_checked())
    views[1].choose("Fixed frame", "tool")
    views[2].button("Pause")
    for view in views:
        view.headline("4 frames, seen from tool · paused at")
    views[1].page.close()
    views[0].button("Follow")
    eventually(lambda: "paused" not in views[2].headline("4 frames"))
    assert [view.errors for view in views] == [[], [], []]


def test_a_click_on_axes_selects_their_frame(bus: Bus, pages: Any, tmp_path: Path) -> None:
    """In the scene as in the tree."""
    settings = tmp_path / "view.yaml"
    settings.write_text("scale: 10\nnames: false\n")
    _, address = start_view(bus, "--settings", str(settings))
    static = StaticTransformBroadcaster(bus.node("lamps"))
    # This puts the map in the middle of the picture, with its z upwards.
    static.send_transform(
        [
            Stamped(0, "map", "left", Transform((-1.0, 0.0, 0.0))),
            Stamped(0, "map", "right", Transform((1.0, 0.0, 0.0))),
        ]
    )
    view = View(pages.new_page(), address)
    view.wait_for_status("right", "static")
    canvas = view.page.locator("canvas[data-engine]")
    selected = view.page.locator(".tf-selected[data-row='map']")

    def clicked() -> bool:
        box = canvas.bounding_box()
        # A little above the middle: on the arm of z.
        middle_x, middle_y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        view.click_at(middle_x, middle_y - 25)
        return view.shows(selected, 3.0)

    eventually(clicked)
    assert view.errors == []
