"""A page without a browser: the tab of a guest, there while it is, and a frame that is followed."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

from tests.builders import S, moved
from tests.live_bus import free_port
from tfbus import Buffer

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.frames import Placed
from tfbus.view.local import ShownBuffer
from tfbus.view.page import Page, Serving
from tfbus.view.panels.markup import Channel
from tfbus.view.scene.scene import Axes
from tfbus.view.settings import ViewSettings


class Lamps:
    """A guest that comes and goes."""

    title = "Lamps"
    style = script = ""
    frames = ()
    region = None
    is_present = False

    def __init__(self) -> None:
        self.calls: list[str] = []

    def join(self, scene: Any, is_watched: Callable[[], bool]) -> None:
        """Note it."""
        self.calls.append("join")

    def add_controls(self, gui: Any, channel: Channel) -> None:
        """Note it, and add one."""
        self.calls.append("add")
        gui.add_button("Light")

    def refresh(self) -> None:
        """Note it."""
        self.calls.append("refresh")

    def draw(self, placed: Placed, fixed_frame: str) -> None:
        """Draw nothing."""


@pytest.fixture
def lamps() -> Lamps:
    """A guest that is not there yet."""
    return Lamps()


@pytest.fixture
def read_only() -> bool:
    """Whether the page is; a test may say so."""
    return False


@pytest.fixture
def refresh(real: None, lamps: Lamps, read_only: bool) -> Iterator[Callable[[], tuple[str, ...]]]:
    """Bring a page with this guest up to date; the titles of its tabs."""
    buffer = Buffer()
    buffer.set_transform(moved(1 * S, "map", "base", 1.0))
    program = ShownBuffer(buffer)
    serving = Serving(port=free_port(), read_only=read_only)
    page = Page(program, program, serving, guests=(lamps,))

    def tabs() -> tuple[str, ...]:
        page.step(at_once=True)
        return tuple(page.panel.tabs._tab_labels)

    yield tabs
    page.close()


def test_a_guest_has_a_tab_while_it_is_present(
    lamps: Lamps, refresh: Callable[[], tuple[str, ...]]
) -> None:
    """Its controls are made each time that it comes, and left alone while it is away."""
    assert refresh() == ("Frames", "View", "Tools")
    lamps.is_present = True
    assert refresh() == refresh() == ("Frames", "View", "Tools", "Lamps")
    lamps.is_present = False
    assert refresh() == ("Frames", "View", "Tools")
    lamps.is_present = True
    assert refresh() == ("Frames", "View", "Tools", "Lamps")
    assert lamps.calls == ["join", "add", "refresh", "refresh", "add", "refresh"]


@pytest.mark.parametrize("read_only", [True])
def test_a_guest_has_no_tab_on_a_page_that_is_read_only(
    lamps: Lamps, refresh: Callable[[], tuple[str, ...]]
) -> None:
    """Its controls could do anything; its shapes are there."""
    lamps.is_present = True
    assert refresh() == ("Frames", "View", "Tools")
    assert lamps.calls == ["join"]


@pytest.mark.real
def test_the_axes_of_a_followed_frame_stay_where_they_are_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Browsers draw them one picture later than what is at a node that moves."""
    drawn: list[dict[str, float]] = []

    def draw(axes: Axes, names: Sequence[str], xyz: Any, *_: object) -> None:
        drawn.append(dict(zip(names, xyz[:, 0], strict=True)))

    monkeypatch.setattr(Axes, "draw", draw)
    buffer = Buffer()
    program = ShownBuffer(buffer)
    page = Page(program, program, Serving(port=free_port(), settings=ViewSettings(follow="base")))
    try:
        for second in (1, 2, 3):
            buffer.set_transform(moved(second * S, "map", "base", 7.0 * second))
            page.step(at_once=True)
    finally:
        page.close()
    assert [each["base"] for each in drawn] == [7.0, 7.0, 7.0]
    assert [each["map"] for each in drawn] == [0.0, -7.0, -14.0]
