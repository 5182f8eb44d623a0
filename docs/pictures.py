"""Takes the pictures of the documentation from the running programs: `make pictures`.

Each comes from processes on a bus of its own, so that nothing else is in it. Those of the view need
Chromium.
"""

import asyncio
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from tfbus import NodeSettings
from tfbus.frames.command_listener import listening
from tfbus.top.app import TopApp
from tfbus.top.source import Source
from tfbus.view.screenshot import find_browser

IMAGES = Path(__file__).parent / "images"
EXAMPLES = Path(__file__).parents[1] / "examples"
TFBUS = [sys.executable, "-m", "tfbus"]

# Long enough for the second turtle to be where it follows.
_SETTLED_S = 8.0


def turtle() -> None:
    """Two turtles on the field, as the simulator draws them."""
    with bus():
        tfbus("launch", str(IMAGES / "picture.yaml"), "--for", "15")


def view() -> None:
    """The view of two turtles and their drones."""
    with bus(), turtles():
        tfbus("view", "--screenshot", str(IMAGES / "view.png"), "--after", "6")


def view_recording() -> None:
    """The view of a recording in which a static frame comes and goes."""
    with TemporaryDirectory() as folder:
        bag = str(Path(folder) / "turtles.mcap")
        with bus(), running([["bag", "record", "-o", bag]]), turtles():
            with running([["static", "world", "lamp", "--x", "3", "--y", "3", "--z", "1"]]):
                time.sleep(3.0)
            time.sleep(3.0)
        picture = str(IMAGES / "view_recording.png")
        tfbus("view", "--bag", bag, "--at=-2", "--screenshot", picture)


def robot() -> None:
    """The view of an arm, with its sliders."""
    with bus(), running([["launch", "robot"]]):
        photograph("robot.png", tab="Robot", width=1280, height=800)


def two_robots() -> None:
    """The view of examples/two_robots.py, and where they drove."""

    def are_apart() -> bool:
        return abs(math.remainder(0.4 * time.time(), math.tau)) > 2.7

    with bus(), example("two_robots.py"):
        seen = {"trails": ["robot1/base_link", "robot2/base_link"], "trail_s": 14.0}
        photograph(
            "two_robots.png",
            "--fleet",
            "--shared",
            "map",
            pause_when=are_apart,
            after_s=12.0,
            settings=seen,
        )


def mujoco_world() -> None:
    """The view of examples/mujoco_world.py, and where its camera swung."""
    with bus(), example("mujoco_world.py"):
        photograph("mujoco_world.png", after_s=6.0, settings={"trails": ["camera"], "trail_s": 3.0})


def drone_log() -> None:
    """The recording that examples/drone_log.py makes, in the view."""
    with TemporaryDirectory() as folder, bus():
        with example("drone_log.py", cwd=folder):
            time.sleep(_SETTLED_S)
        bag = str(Path(folder) / "drone_example.mcap")
        seen = {"trails": ["drone"], "trail_s": 10.0}
        photograph("drone_log.png", "--bag", bag, "--at=-4", settings=seen)


def marker_in_world() -> None:
    """What the camera of examples/marker_in_world.py sees, and the tag that it finds."""
    with example("marker_in_world.py", str(IMAGES / "marker_in_world.png")) as process:
        process.wait()


def photograph(
    name: str,
    *options: str,
    tab: str = "",
    width: int = 960,
    height: int = 600,
    after_s: float = 4.0,
    pause_when: Callable[[], bool] | None = None,
    settings: Mapping[str, object] | None = None,
) -> None:
    """A picture of the view, which is started with these options, once it shows all frames."""
    from playwright.sync_api import sync_playwright

    port = str(_free_port())
    with TemporaryDirectory() as folder, sync_playwright() as playwright, ExitStack() as ended:
        chosen = Path(folder) / "view.yaml"
        chosen.write_text(yaml.safe_dump(dict(settings or {})))
        view = ["view", "--port", port, "--settings", str(chosen), *options]
        ended.enter_context(running([view]))
        browser = playwright.chromium.launch(executable_path=find_browser(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": height})
        page.goto(f"http://127.0.0.1:{port}")
        if tab:
            page.get_by_role("tab", name=tab).click()
        page.wait_for_timeout(1000 * after_s)
        if pause_when:
            while not pause_when():
                page.wait_for_timeout(100)
            page.get_by_role("button", name="Pause").click()
        page.get_by_role("button", name="All (H)").click()
        page.wait_for_timeout(4000)
        # The notice of a machine without a graphics card, and the hint under the mouse.
        for notice in page.locator(".mantine-Notification-closeButton").all():
            notice.click()
        page.mouse.move(width * 3 / 8, height - 20)
        page.wait_for_timeout(1000)
        page.screenshot(path=IMAGES / name)


def plot() -> None:
    """A plot of ten seconds of a turtle's way."""
    with bus(), turtles():
        tfbus("plot", "world", "turtle2", "--for", "10", "-o", str(IMAGES / "plot.svg"))


def top() -> None:
    """The screen of `tfbus top`, as an SVG of the terminal."""
    with bus(), turtles():
        asyncio.run(_photograph_top())


async def _photograph_top() -> None:
    with listening(NodeSettings("_top"), None, goes_on=True) as heard:
        app = TopApp(Source(heard))
        async with app.run_test(size=(104, 22)) as pilot:
            await pilot.pause(4.0)
            drawn = app.export_screenshot()
    # Without letters from elsewhere: the reader's own will do.
    (IMAGES / "top.svg").write_text(re.sub(r"\s*@font-face {.*?}", "", drawn, flags=re.S))


PICTURES = {
    each.__name__: each
    for each in (
        turtle,
        view,
        view_recording,
        robot,
        plot,
        top,
        two_robots,
        mujoco_world,
        drone_log,
        marker_in_world,
    )
}
# What they need beside .venv; without it they stay as they are.
PACKAGES = {"mujoco_world": "mujoco", "marker_in_world": "cv2"}


@contextmanager
def bus() -> Iterator[None]:
    """A bus of its own, on a free port of this machine, for all that is started within."""
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with running([["router", "--listen", endpoint]]):
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        os.environ |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint, "PATH": path}
        yield


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def turtles() -> Iterator[None]:
    """Two turtles, the second of which follows the first."""
    with running([["launch", str(IMAGES / "picture.yaml")]]):
        tfbus("echo", "world", "turtle2", "--count", "1")
        time.sleep(_SETTLED_S)
        yield


@contextmanager
def running(commands: Sequence[Sequence[str]]) -> Iterator[None]:
    """Run these until the end, once they have settled."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with ExitStack() as ended:
        for command in commands:
            process = subprocess.Popen([*TFBUS, *command], start_new_session=True, **quiet)
            ended.callback(_end, process)
        time.sleep(2.0)
        yield


@contextmanager
def example(
    name: str, *arguments: str, cwd: str | None = None
) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a program of examples/ until the end, once it has settled."""
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    process = subprocess.Popen(command, cwd=cwd, start_new_session=True, stdout=subprocess.DEVNULL)
    try:
        time.sleep(4.0)
        yield process
    finally:
        _end(process)


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.send_signal(signal.SIGINT)
    process.wait(20.0)


def tfbus(*arguments: str) -> None:
    """Run a command to its end. Raises CalledProcessError where it fails."""
    subprocess.run([*TFBUS, *arguments], check=True)


def main(names: Sequence[str]) -> None:
    """Take these pictures, or all."""
    if unknown := set(names) - PICTURES.keys():
        raise SystemExit(f"there is no picture {', '.join(unknown)}: {', '.join(PICTURES)}")
    for name, take in PICTURES.items():
        if not names or name in names:
            if name in PACKAGES and find_spec(PACKAGES[name]) is None:
                print(f"{name}: stays as it is, {PACKAGES[name]} is not installed")
                continue
            print(f"{name}: {take.__doc__}", flush=True)
            take()


if __name__ == "__main__":
    main(sys.argv[1:])
