"""The page of `tfbus view` in a real Chromium that nobody sees: what people do, and see."""

import re
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from signal import SIGKILL
from typing import Any

import pytest
from conftest import DEADLINE_S, Bus, Process, eventually, free_port

from tfbus import Node, StaticTransformBroadcaster, Transform, TransformBroadcaster
from tfbus import TransformStamped as Stamped
from tfbus.messages import Pose

pytest.importorskip("viser", reason="the extra view is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
if not (CHROMIUM := shutil.which("chromium")):
    pytest.skip("there is no chromium (apt-get install chromium)", allow_module_level=True)

from tfbus.nodes.viewer.screenshot import FLAGS  # noqa: E402  # needs none, but is for none

# Chromium draws without a graphics card, on a machine that others use too.
PATIENCE_S = 3 * DEADLINE_S


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One Chromium for all tests; each has pages of its own."""
    with playwright.sync_playwright() as driver:
        flags = [flag for flag in FLAGS if not flag.startswith("--headless")]
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=[*flags, "--no-sandbox"])
        yield browser
        browser.close()


class View:
    """A page of a running `tfbus view`."""

    def __init__(self, page: Any, address: str) -> None:
        self.page = page
        self.errors: list[str] = []
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto(address)
        self.headline("")

    def headline(self, part: str) -> str:
        """The line at the top, once it has this part in it."""
        line = self.page.get_by_role("status").filter(has_text=part)
        line.wait_for()
        return str(line.inner_text())

    def row(self, frame: str) -> Any:
        """A frame's row in the tree."""
        return self.page.locator(f"[data-row='{frame}']")

    def wait_for_status(self, frame: str, status: str) -> None:
        """Wait until a frame has this badge."""
        self.page.locator(f"[data-row='{frame}'][data-status='{status}']").wait_for()

    def select(self, frame: str) -> None:
        """Click on a frame's name in the tree."""
        self.row(frame).get_by_role("button").click()
        self.page.locator(f".tf-selected[data-row='{frame}']").wait_for()

    def tab(self, name: str) -> None:
        """Open a tab of the panel."""
        self.page.get_by_text(name, exact=True).click()

    def field(self, label: str) -> Any:
        """The input beside a label."""
        return self.page.locator(
            f"xpath=//label[normalize-space()='{label}']/ancestor::div[.//input][1]"
            "//input[not(@type='hidden')]"
        ).first

    def choose(self, label: str, option: str) -> None:
        """Choose an entry of the dropdown beside a label."""
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def block(self, element: str) -> str:
        """A block of numbers: tf-in-parent, tf-in-fixed, tf-echo."""
        return str(self.page.locator(f"#{element}").inner_text())


def start_view(bus: Bus, *options: str) -> tuple[Process, str]:
    """`tfbus view` as a process, and the address that it tells."""
    # Seldom, because it is the processor that draws here.
    process = bus.start("view", "--port", str(free_port()), "--rate", "5", *options)
    line = process.wait_for_line(r"View: http://", within_s=PATIENCE_S)
    return process, line.rpartition("View: ")[2]


@pytest.fixture
def pages(browser: Any) -> Iterator[Any]:
    """A window of the browser, closed after the test."""
    context = browser.new_context(viewport={"width": 900, "height": 500})
    yield context
    context.close()


class Arm:
    """map -> base -> tool at 20 Hz, the tool a metre a second away from base; and a static lamp."""

    def __init__(self, node: Node) -> None:
        self.ticks = 0
        self._node = node
        self._dynamic = TransformBroadcaster(node)
        static = StaticTransformBroadcaster(node)
        static.send_transform(Stamped(0, "map", "lamp", Transform((0.0, 2.0, 0.0))))
        node.create_timer(0.05, self._tick)

    def _tick(self) -> None:
        self.ticks += 1
        now_ns = self._node.now_ns()
        tool = Transform((self.ticks * 0.05, 0.0, 0.0))
        self._dynamic.send_transform(
            [
                Stamped(now_ns, "map", "base", Transform((1.0, 0.0, 0.0))),
                Stamped(now_ns, "base", "tool", tool),
            ]
        )


def test_a_page_shows_frames_as_they_come_and_go(bus: Bus, pages: Any) -> None:
    """It waits, shows them with their states, from where one likes, and says who is gone."""
    _, address = start_view(bus)
    view = View(pages.new_page(), address)
    view.headline("Waiting for transforms")

    arm = bus.node("arm")
    Arm(arm)
    view.headline("4 frames, seen from map")
    view.wait_for_status("tool", "fresh")
    view.wait_for_status("lamp", "static")
    view.wait_for_status("map", "root")

    view.choose("Fixed frame", "base")
    view.headline("4 frames, seen from base")
    view.select("lamp")
    view.page.locator("#tf-in-fixed").filter(has_text="xyz  [-1.000, 2.000, 0.000]").wait_for()
    assert view.block("tf-in-parent").startswith("xyz  [0.000, 2.000, 0.000]")
    assert "arm" in view.page.get_by_text("Publisher").locator("xpath=..").inner_text()

    other = View(pages.new_page(), address)
    view.page.get_by_label("show tool").uncheck()
    eventually(lambda: not other.page.get_by_label("show tool").is_checked(), within_s=PATIENCE_S)

    arm.close()
    view.wait_for_status("tool", "gone")
    view.headline("gone")
    view.page.reload()
    view.wait_for_status("lamp", "gone")
    assert not view.page.get_by_label("show tool").is_checked()
    assert view.errors == other.errors == []


def test_time_can_be_held_and_moved_back(bus: Bus, pages: Any) -> None:
    """Paused, numbers stand still; the slider shows what they were; Follow goes on."""
    _, address = start_view(bus)
    Arm(bus.node("arm"))
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "fresh")
    view.select("tool")

    def x_m() -> float:
        return float(re.findall(r"xyz +\[(\S+),", view.block("tf-in-parent"))[0])

    eventually(lambda: x_m() > 1.5, within_s=PATIENCE_S)
    view.page.get_by_role("button", name="Pause").click()
    view.headline("paused at")
    held_m = eventually(lambda: (now := x_m()) == x_m() and now, within_s=PATIENCE_S)
    ago = view.field("Seconds ago")
    ago.fill("-1")
    ago.press("Enter")
    # Ticks are 50 ms and 50 mm apart, more or less on a busy machine.
    eventually(lambda: held_m - 1.5 < x_m() < held_m - 0.2, within_s=PATIENCE_S)
    view.page.get_by_role("button", name="Follow").click()
    eventually(lambda: x_m() > held_m, within_s=PATIENCE_S)
    assert view.errors == []


def test_a_turtle_is_driven_from_the_page(bus: Bus, pages: Any) -> None:
    """By arrows and keys, each request with its reply; and the measure tab prints as echo does."""
    bus.start("simulator", "--headless")
    bus.start("broadcaster")
    _, address = start_view(bus)
    node = bus.node("witness")
    poses: dict[str, Pose] = {}
    for name in ("turtle1", "leo"):
        node.create_subscription(
            Pose, f"{name}/pose", lambda pose, name=name: poses.update({name: pose})
        )
    eventually(lambda: "turtle1" in poses)
    view = View(pages.new_page(), address)
    view.wait_for_status("drone", "fresh")
    view.tab("Turtles")
    reply = view.page.get_by_role("log")

    view.page.get_by_label("drive forward").click()
    eventually(lambda: poses["turtle1"].x > 5.6, within_s=PATIENCE_S)
    view.page.get_by_label("drive by keyboard").focus()
    view.page.keyboard.press("g")
    reply.filter(has_text="rotation of turtle1 succeeded").wait_for()
    start_m = poses["turtle1"].x
    eventually(
        lambda: view.page.keyboard.press("ArrowDown") or poses["turtle1"].x < start_m - 0.1,
        within_s=PATIENCE_S,
    )

    view.field("New name").fill("leo")
    view.page.get_by_role("button", name="Spawn").click()
    reply.filter(has_text="spawned leo").wait_for()
    eventually(lambda: "leo" in poses, within_s=PATIENCE_S)
    view.page.get_by_role("button", name="Spawn").click()
    reply.filter(has_text="spawn: A turtle named [leo] already exists").wait_for()

    view.tab("Measure")
    view.choose("Seen from", "turtle1")
    view.choose("Frame", "drone")
    echo = view.page.locator("#tf-echo").filter(has_text="Translation: [-0.500, 0.000, 1.000]")
    echo.wait_for()
    view.page.get_by_text("1.118 m apart").wait_for()
    assert view.errors == []


def test_settings_are_saved_and_a_bad_pattern_is_told(bus: Bus, pages: Any, tmp_path: Path) -> None:
    """The file opens the same view again; a filter that cannot be read changes nothing."""
    path = tmp_path / "view.yaml"
    Arm(bus.node("arm"))
    process, address = start_view(bus, "--settings", str(path))
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "fresh")
    view.tab("View")
    view.field("Only").fill("tool(")
    mistake = view.page.get_by_role("alert").filter(has_text="no regular expression")
    mistake.wait_for()
    view.field("Only").fill("^t")
    mistake.wait_for(state="detached")
    view.page.get_by_role("button", name="Save settings").click()
    eventually(lambda: path.exists() and "only: ^t" in path.read_text(), within_s=PATIENCE_S)
    process.signal(SIGKILL)
    process.wait()

    # On the same port, where the page that is open finds it by itself.
    again = bus.start("view", "--port", address.rpartition(":")[2], "--settings", str(path))
    again.wait_for_line(r"View: http://", within_s=PATIENCE_S)
    view.tab("Frames")
    view.page.get_by_text("3 left out by Only '^t'").wait_for()
    assert view.row("base").count() == 0


def test_a_picture_of_the_page_is_taken(bus: Bus, tmp_path: Path) -> None:
    """Of the size that was asked for, after which the process ends by itself."""
    Arm(bus.node("arm"))
    path = tmp_path / "out.png"
    done = bus.run(
        "view",
        *("--port", str(free_port())),
        *("--screenshot", str(path), "--after", "0", "--size", "640x480"),
    )
    assert done.returncode == 0, done.stderr
    picture = path.read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", picture[16:24]) == (640, 480)
