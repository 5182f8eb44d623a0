"""The tabs of the page in a real Chromium."""

from pathlib import Path
from typing import Any

import pytest

from tests.live_bus import Bus
from tests.view.pages import View, start_view
from tfbus.messages import PointCloud

pytestmark = pytest.mark.real

URDF = """<robot name="box">
<link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
</robot>"""


def test_all_tabs_stand_in_one_row_of_the_panel(bus: Bus, pages: Any, tmp_path: Path) -> None:
    """In a window that is 1280 pixels wide, with all that has a tab; none is cut off."""
    (tmp_path / "box.urdf").write_text(URDF)
    bus.start("simulator", "--headless")
    bus.node("robot").create_publisher(PointCloud, "points")
    fleet = ("--fleet", "--expect", "robot[1-2]")
    _, address = start_view(bus, "--urdf", str(tmp_path / "box.urdf"), *fleet)
    view = View(pages.new_page(), address)
    view.page.set_viewport_size({"width": 1280, "height": 800})
    for name in ("Frames", "View", "Tools", "Fleet", "Data", "Robot", "Turtles"):
        view.page.get_by_role("tab", name=name, exact=True).wait_for()
    tabs = [each.bounding_box() for each in view.page.get_by_role("tab").all()]
    assert len({round(tab["y"]) for tab in tabs}) == 1
    ends = [tab["x"] + tab["width"] for tab in tabs]
    assert all(end <= tab["x"] + 1.0 for end, tab in zip(ends, tabs[1:], strict=False))
    assert ends[-1] <= 1280.0
    assert view.errors == []
