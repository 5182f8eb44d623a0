"""A running `tfbus view` and its page in a real headless Chromium, for tests."""

from collections.abc import Iterator
from typing import Any

import pytest

from tests import needs
from tests.buses import DEADLINE_S
from tests.live_bus import Bus, Process, free_port
from tfbus import Node, StaticTransformBroadcaster, Transform, TransformBroadcaster
from tfbus import TransformStamped as Stamped
from tfbus.view.screenshot import CLOSE_NOTES, FLAGS

# Chromium draws without a graphics card, on a machine with other work to do: a page that takes 5 s
# alone takes a minute beside four others.
PATIENCE_S = 2 * DEADLINE_S


@pytest.fixture(scope="module")
def browser(real: None) -> Iterator[Any]:
    """One Chromium for all tests of a file; each has pages of its own."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright: the extra dev"
    )
    chromium = needs.program("chromium")
    with playwright.sync_playwright() as driver:
        flags = [flag for flag in FLAGS if not flag.startswith("--headless")]
        browser = driver.chromium.launch(
            executable_path=chromium, args=[*flags, "--no-sandbox"], timeout=PATIENCE_S * 1e3
        )
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


@pytest.fixture
def pages(browser: Any) -> Iterator[Any]:
    """A window of the browser, closed after the test."""
    context = browser.new_context(viewport={"width": 720, "height": 330})
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
