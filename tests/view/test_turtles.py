"""The turtles' tab of the page in a real Chromium: each button and key, and its effect."""

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from itertools import cycle
from typing import Any

import pytest

from tests import buses
from tests.live_bus import Bus
from tests.view.pages import PATIENCE_S, View, eventually, start_view, window_of
from tfbus import Node
from tfbus.messages import Empty, Field, Pose

pytestmark = pytest.mark.real


class Witness:
    """The turtles as seen on the bus."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._poses: dict[str, Pose] = {}
        self._field = node.create_client(Field, "field")
        self._reset = node.create_client(Empty, "reset")
        self.watch("turtle1")

    def watch(self, turtle: str) -> None:
        """Follow a turtle's pose."""
        self._node.create_subscription(
            Pose, f"{turtle}/pose", lambda pose: self._poses.update({turtle: pose})
        )

    def knows(self, turtle: str) -> bool:
        """Whether it has sent a pose."""
        return turtle in self._poses

    def pose(self, turtle: str = "turtle1") -> Pose:
        """Its last pose."""
        return self._poses[turtle]

    def field(self) -> Field.Response:
        """The simulator's field."""
        return self._field.call(Field.Request(), timeout_s=PATIENCE_S)

    def reset(self) -> None:
        """Let there be the one turtle in the middle, and wait until it is seen there."""
        self._reset.call(Empty.Request(), timeout_s=PATIENCE_S)
        eventually(lambda: is_at(self, "turtle1", 5.544, 5.544, 0.0))

    def has_ink(self) -> bool:
        """Whether something is drawn on the field."""
        return any(zlib.decompress(self.field().ink))


class Stage:
    """A simulator, a node that follows its turtles, and the turtles' tab of a page."""

    def __init__(self, bus: Bus, window: Any) -> None:
        self.bus = bus
        self.simulator = bus.start("simulator", "--headless")
        self.witness = Witness(bus.node("witness"))
        eventually(lambda: self.witness.knows("turtle1"))
        _, address = start_view(bus)
        self.view = View(window.new_page(), address)

    def begin(self) -> None:
        """As it was at first, for the next test."""
        if self.simulator.popen.poll() is not None:
            self.simulator = self.bus.start("simulator", "--headless")
        self.witness.reset()
        self.view.tab("Turtles")


@pytest.fixture(scope="module")
def stage_of_all(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    """The stage of all tests: to set it up takes longer than most of them."""
    with window_of(browser) as window, closing(Bus(tmp_path_factory.mktemp("bus"))) as bus:
        yield Stage(bus, window)


@pytest.fixture
def stage(stage_of_all: Stage) -> Stage:
    """The stage as it was at first."""
    stage_of_all.begin()
    return stage_of_all


@pytest.fixture
def witness(stage: Stage) -> Witness:
    """The turtles as seen on the bus."""
    return stage.witness


@pytest.fixture
def view(stage: Stage) -> View:
    """The turtles' tab of the page."""
    return stage.view


def reply(view: View, text: str) -> None:
    """Wait for this reply."""
    view.page.get_by_role("log").filter(has_text=text).wait_for()


def ask(view: View, button: str, text: str) -> None:
    """Click on a button until this is the reply.

    What a hurried hand typed just before reaches the view a moment after the click.
    """
    answered = view.page.get_by_role("log").filter(has_text=text)

    def replied() -> bool:
        view.button(button)
        return view.shows(answered, 3.0)

    eventually(replied)


def drive_forward(witness: Witness, view: View) -> None:
    """Click on the arrow until the turtle has driven.

    For a moment after a reset the page may still have chosen a turtle that is gone.
    """

    def has_driven() -> bool:
        view.page.get_by_label("drive forward").click()
        with suppress(AssertionError):
            buses.eventually(lambda: witness.pose().x > 5.6, within_s=3.0)
        return witness.pose().x > 5.6

    eventually(has_driven)


def is_at(witness: Witness, turtle: str, x: float, y: float, theta: float) -> bool:
    """Whether a turtle's last pose is this one."""
    if not witness.knows(turtle):
        return False
    pose = witness.pose(turtle)
    return (pose.x, pose.y, pose.theta) == pytest.approx((x, y, theta), abs=1e-3)


def fill(view: View, label: str, *values: str) -> None:
    """Write into the fields beside a label."""
    inputs = view.page.locator(
        f"xpath=//label[normalize-space()='{label}']/ancestor::div[.//input][1]//input"
    )
    for at, value in enumerate(values):
        inputs.nth(at).fill(value)
        inputs.nth(at).press("Tab")


def test_a_turtle_is_driven_by_arrows_and_by_keys(witness: Witness, view: View) -> None:
    """An arrow drives it, a key of the teleop turns it, F cancels that; the bus confirms it."""
    drive_forward(witness, view)
    view.page.get_by_label("rotate to 90°").click()
    reply(view, "rotation of turtle1 succeeded: turned by")
    eventually(lambda: witness.pose().theta == pytest.approx(math.pi / 2, abs=0.1))

    view.page.get_by_label("drive by keyboard").focus()
    start_m = witness.pose().y
    eventually(lambda: view.page.keyboard.press("ArrowUp") or witness.pose().y > start_m + 0.1)
    # Half a turn takes three seconds, and on a busy machine a key may take longer: then the next.
    half_turns = cycle([("v", -math.pi / 2), ("r", math.pi / 2)])
    report = view.page.get_by_role("log").filter(has_text="rotation of turtle1 canceled")

    def is_ended_by(cancel: Callable[[], object]) -> bool:
        view.page.get_by_label("drive by keyboard").focus()
        key, theta = next(half_turns)
        start = witness.pose().theta
        view.page.keyboard.press(key)
        eventually(lambda: witness.pose().theta != start)
        cancel()
        is_shown = view.shows(report, 3.0)
        eventually(lambda: witness.pose().angular_velocity == 0.0)
        return is_shown and abs(witness.pose().theta - theta) > 0.1

    for cancel in (
        lambda: view.page.keyboard.press("f"),
        lambda: view.page.get_by_label("cancel the rotation").click(),
    ):
        eventually(lambda cancel=cancel: is_ended_by(cancel))
    assert view.errors == []


def test_turtles_are_spawned_teleported_and_killed(witness: Witness, view: View) -> None:
    """Each has its reply, also a refusal, and its effect on the bus."""
    fill(view, "x, y, °", "2", "3", "90")
    ask(view, "Teleport", "teleported turtle1 to (2, 3), 90°")
    eventually(lambda: is_at(witness, "turtle1", 2.0, 3.0, math.pi / 2))

    fill(view, "New name", "leo")
    ask(view, "Spawn", "spawned leo")
    witness.watch("leo")
    eventually(lambda: is_at(witness, "leo", 2.0, 3.0, math.pi / 2))
    ask(view, "Spawn", "spawn: A turtle named [leo] already exists")

    eventually(lambda: view.choose("Turtle", "leo") is None)
    fill(view, "x, y, °", "8", "1", "-90")
    ask(view, "Teleport", "teleported leo to (8, 1), -90°")
    eventually(lambda: is_at(witness, "leo", 8.0, 1.0, -math.pi / 2))

    view.button("Kill")
    reply(view, "killed leo")
    assert "leo" not in witness.field().turtles
    assert view.errors == []


def test_the_field_is_cleared_and_reset(witness: Witness, view: View) -> None:
    """Clear removes the ink; a reset puts the turtle back into the middle."""
    drive_forward(witness, view)
    eventually(witness.has_ink)
    view.button("Clear")
    reply(view, "cleared the field")
    eventually(lambda: not witness.has_ink() or view.button("Clear"))

    view.button("Reset")
    reply(view, "reset the field")
    eventually(lambda: is_at(witness, "turtle1", 5.544, 5.544, 0.0))
    assert view.errors == []


def test_the_way_between_two_frames_is_printed_as_by_echo(stage: Stage, view: View) -> None:
    """The drone is behind its turtle and above."""
    stage.bus.start("broadcaster")
    view.tab("Tools")
    eventually(lambda: view.choose("Seen from", "turtle1") is None)
    view.choose("Frame", "drone")
    echo = view.page.locator("#tf-echo").filter(has_text="Translation: [-0.500, 0.000, 1.000]")
    echo.wait_for()
    view.page.get_by_text("1.118 m apart").wait_for()
    assert view.errors == []


def test_the_tab_ends_with_the_simulator(stage: Stage, view: View) -> None:
    """A page has it only while there are turtles."""
    stage.simulator.stop()
    view.page.get_by_role("tab", name="Turtles").wait_for(state="detached")
    assert view.errors == []
