"""A running `tfbus view` and its page in a real headless Chromium, for tests."""

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from signal import SIGKILL
from typing import Any, TypeVar

import pytest

from tests import buses, needs
from tests.buses import DEADLINE_S
from tests.live_bus import Bus, Process, free_port
from tfbus import Node, StaticTransformBroadcaster, Transform, TransformBroadcaster
from tfbus import TransformStamped as Stamped
from tfbus.view.screenshot import CLOSE_NOTES, FLAGS, devtools_of

T = TypeVar("T")

# Chromium draws without a graphics card, on a machine with other work to do: a page that takes 5 s
# alone takes a minute beside four others.
PATIENCE_S = 2 * DEADLINE_S


# Pages in the background go on as those that somebody sees, and a picture may take as long as it
# takes: else Chromium ends its drawing process after 10 s, and gives no page a canvas after the
# third time. viser counts a browser as connected once its canvas has drawn.
_AWAKE = (
    "--disable-gpu-watchdog",
    "--disable-gpu-process-crash-limit",
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
)


@pytest.fixture(scope="session")
def chromium(real: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """One Chromium for all tests of this process, whose start takes longer than most of them: the
    address by which it is driven.
    """
    profile = tmp_path_factory.mktemp("chromium")
    started = subprocess.Popen(
        [
            *(needs.program("chromium"), *FLAGS, *_AWAKE, "--no-sandbox"),
            *("--remote-debugging-port=0", f"--user-data-dir={profile}", "about:blank"),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield f"http://{devtools_of(started)}"
    finally:
        os.killpg(started.pid, SIGKILL)
        started.communicate()


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest, real: None) -> Iterator[Any]:
    """The Chromium as the tests of a file drive it; each has pages of its own."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright: the extra dev"
    )
    # Not for longer: no test can run an event loop of its own in the meantime.
    with playwright.sync_playwright() as driver:
        address = request.getfixturevalue("chromium")
        yield driver.chromium.connect_over_cdp(address, timeout=PATIENCE_S * 1e3)


def eventually(condition: Callable[[], T]) -> T:
    """The first true value of the condition, which asks the browser and so is not for nothing."""
    return buses.eventually(condition, within_s=PATIENCE_S, every_s=0.1)


class View:
    """A page of a running `tfbus view`."""

    def __init__(self, page: Any, address: str) -> None:
        self.page = page
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto(address)
        self.headline("")

    def headline(self, part: str) -> str:
        """The line at the top, once it contains this part."""
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

    def button(self, name: str) -> None:
        """Click on a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def click_at(self, x: float, y: float) -> None:
        """Click on a place of the window, after closing viser's note on slow machines."""
        self.page.evaluate(CLOSE_NOTES)
        self.page.mouse.click(x, y)

    def shows(self, locator: Any, within_s: float) -> bool:
        """Whether something appears within that time."""
        from playwright.sync_api import TimeoutError as NotShownError

        try:
            locator.wait_for(timeout=within_s * 1e3)
        except NotShownError:
            return False
        return True

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
    """`tfbus view` as a process, and the address that it prints."""
    # At a low rate, because the processor draws here.
    process = bus.start("view", "--port", str(free_port()), "--rate", "5", *options)
    line = process.wait_for_line(r"View: http://", timeout_s=PATIENCE_S)
    return process, line.rpartition("View: ")[2]


# Without a graphics card the processor draws, and sixty pictures a second take all of it: five are
# as many as the page has news, and a sixteenth of the pixels shows them.
_DRAW_SELDOM = """
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""


@contextmanager
def window_of(browser: Any, **options: Any) -> Iterator[Any]:
    """A window of the browser, with pages and cookies of its own."""
    context = browser.new_context(
        viewport={"width": 720, "height": 330}, device_scale_factor=0.25, **options
    )
    context.set_default_timeout(PATIENCE_S * 1e3)
    context.add_init_script(_DRAW_SELDOM)
    with closing(context):
        yield context


@pytest.fixture
def pages(browser: Any) -> Iterator[Any]:
    """A window of the browser, closed after the test."""
    with window_of(browser) as window:
        yield window


class Arm:
    """map -> base -> tool at 20 Hz, the tool a metre a second away from base; and a static lamp."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._since_ns = node.now_ns()
        self._dynamic = TransformBroadcaster(node)
        static = StaticTransformBroadcaster(node)
        static.send_transform(Stamped(0, "map", "lamp", Transform((0.0, 2.0, 0.0))))
        node.create_timer(0.05, self._tick)

    def _tick(self) -> None:
        now_ns = self._node.now_ns()
        # By the time, not by the ticks, of which a busy machine leaves some out.
        tool = Transform(((now_ns - self._since_ns) / 1e9, 0.0, 0.0))
        self._dynamic.send_transform(
            [
                Stamped(now_ns, "map", "base", Transform((1.0, 0.0, 0.0))),
                Stamped(now_ns, "base", "tool", tool),
            ]
        )
