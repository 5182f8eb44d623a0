"""The tab of robots, on a real server of viser without a browser, in each state of its robots."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from tests.builders import S, moved
from tests.live_bus import free_port
from tfbus import Buffer, Robot

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.local import ShownBuffer
from tfbus.view.page import Page, Serving
from tfbus.view.robots import GivenRobots, ShownRobot

pytestmark = pytest.mark.real


def urdf(name: str, limit: str = "lower='-1' upper='1'") -> str:
    """A robot of two links and a joint with this limit."""
    return (
        f"<robot name='{name}'><link name='base'/><link name='hand'/>"
        "<joint name='lift' type='prismatic'><parent link='base'/><child link='hand'/>"
        f"<axis xyz='0 0 1'/><limit {limit}/></joint></robot>"
    )


class Arm:
    """The joints of a robot that a process moves, or none."""

    def __init__(self) -> None:
        self.positions: Mapping[str, float] = {}
        self.is_heard = False
        self.sent: list[Mapping[str, float]] = []

    def send(self, targets: Mapping[str, float]) -> None:
        """Keep them."""
        self.sent.append(targets)


class Robots(GivenRobots):
    """Robots that come and go, as those of a bus do."""

    def __init__(self) -> None:
        super().__init__()
        self.arm = Arm()
        self.there: Sequence[ShownRobot] = ()

    def robots(self) -> Sequence[ShownRobot]:
        """The robots that are there now."""
        return self.there

    def joints(self, robot: ShownRobot) -> Arm | None:
        """The same of all."""
        return self.arm


@pytest.fixture
def robots() -> Robots:
    """No robot yet."""
    return Robots()


@pytest.fixture
def program() -> ShownBuffer:
    """A program with frame hand on base."""
    buffer = Buffer()
    buffer.set_transform(moved(1 * S, "base", "hand", 1.0))
    return ShownBuffer(buffer)


@pytest.fixture
def page(program: ShownBuffer, robots: Robots) -> Iterator[Page]:
    """A page with its frames."""
    page = Page(program, program, Serving(port=free_port(), rate_hz=60.0), robots)
    yield page
    page.close()


def step(page: Page) -> None:
    """Bring all of it up to date now."""
    page.step(at_once=True)


def sliders(page: Page) -> Any:
    """The sliders of the robot that is chosen."""
    assert page.panel.robots_panel is not None
    return page.panel.robots_panel.sliders


def described(text: str) -> ShownRobot:
    """A robot as a bus describes it."""
    return ShownRobot(Robot.from_text(text), is_described=True)


def test_buttons_and_sliders_are_open_while_a_process_moves_the_joints(
    page: Page, robots: Robots
) -> None:
    """Without one the sliders only follow, and again once it has left."""
    robots.there = [described(urdf("arm"))]
    for is_heard in (False, True, False):
        robots.arm.is_heard = is_heard
        robots.arm.positions = {"lift": 0.5}
        step(page)
        shown = sliders(page)
        assert shown.buttons.visible is is_heard
        [slider] = shown.sliders
        assert (slider.handle.disabled, slider.handle.value) == (not is_heard, 0.5)


def test_a_joint_does_not_undo_a_drag_that_nobody_was_told_of(page: Page, robots: Robots) -> None:
    """A slider has the new value a moment before the call that says so."""
    robots.there = [described(urdf("arm"))]
    robots.arm.is_heard = True
    robots.arm.positions = {"lift": 0.5}
    step(page)
    [slider] = sliders(page).sliders
    slider.handle._impl.value = 0.75  # as viser does when a browser says so
    step(page)
    assert slider.handle.value == 0.75


def test_a_slider_is_not_open_before_a_drag_reaches_a_process(
    page: Page, robots: Robots, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A browser that draws it at once finds it disabled: a drag in that moment would be lost."""
    import viser

    add, born = viser.GuiApi.add_slider, {}

    def added(gui: Any, label: str, *args: Any, **named: Any) -> Any:
        handle = add(gui, label, *args, **named)
        born[label] = handle.disabled
        return handle

    monkeypatch.setattr(viser.GuiApi, "add_slider", added)
    robots.there = [described(urdf("arm"))]
    step(page)
    assert born["lift"] is True


def test_robots_come_are_two_and_leave(page: Page, robots: Robots) -> None:
    """A robot of a file too, one without joints, and the same one described again."""
    arm, other = described(urdf("arm")), described(urdf("other"))
    block = described("<robot name='block'><link name='base'/></robot>")
    file = ShownRobot(Robot.from_text(urdf("file").replace("'hand'", "'tool'")))
    for there in ([file], [arm], [arm, other], [other], [block], [block, file], [], [arm]):
        robots.there = there
        step(page)
        assert list(page.robots.robots) == there


@pytest.mark.parametrize(
    "limit",
    [
        "lower='0' upper='0'",
        "lower='0.0001' upper='0.0003'",
        "lower='0.0004' upper='0.0006'",
        "lower='0.0006' upper='0.0014'",
        "lower='-1e300' upper='1e300'",
        "lower='1e6' upper='1000000.0001'",
        "lower='-inf' upper='inf'",
    ],
)
def test_a_slider_has_any_limits(page: Page, robots: Robots, limit: str) -> None:
    """Also if a robot comes to its ends, and goes beyond."""
    robots.there = [described(urdf("arm", limit))]
    for position in (0.0, -2e300, 2e300, 1e-4):
        robots.arm.positions = {"lift": position}
        robots.arm.is_heard = True
        step(page)
    assert len(sliders(page).sliders) == 1
    for button in ("Zero", "Random"):
        sliders(page).press(button)
    assert len(robots.arm.sent) == 2


def test_a_mistake_in_drawing_does_not_end_the_page(
    page: Page, program: ShownBuffer, caplog: pytest.LogCaptureFixture
) -> None:
    """It is logged once with its traceback, and the page goes on."""
    steps = iter(range(5))

    def step() -> None:
        if next(steps) == 4:
            program.end()
        raise ValueError("no such colour")

    page.step = step
    page.run()
    [record] = caplog.records
    assert "bring the page up" in record.message
    assert record.exc_info
