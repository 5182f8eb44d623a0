"""Takes the pictures of the documentation from the running programs: `make pictures`.

Each comes from processes on a bus of its own, so that nothing else is in it. Those of the view need
Chromium. Those of examples have the examples' names, and need what these need.
"""

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING, Any

import yaml
from PIL import Image

from tfbus import NodeSettings
from tfbus.base.signals import StopSignals
from tfbus.frames.command_listener import listening
from tfbus.top.app import TopApp
from tfbus.top.rows import TopSource
from tfbus.view.screenshot import CLOSE_NOTES, FLAGS, find_browser

if TYPE_CHECKING:
    from playwright.sync_api import Page

IMAGES = Path(__file__).parent / "images"
EXAMPLES = Path(__file__).parents[1] / "examples"
TFBUS = [sys.executable, "-m", "tfbus"]

# What an example needs beyond tfbus: the module, and the package that has it.
NEEDS = {
    "marker_in_world": ("cv2", "opencv-python-headless"),
    "mujoco_world": ("mujoco", "mujoco"),
    "mujoco_robot": ("mujoco", "mujoco"),
}

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
    # One that moves would leave the picture that it was in.
    joints = (
        "shoulder_pan=-0.5",
        "shoulder_lift=-0.9",
        "elbow=2",
        "wrist_pitch=0.6",
        "gripper=0.03",
    )
    arm = running(arm_at(*joints))
    with bus(), arm, view_of() as url, opened(url, (1280, 800)) as page:
        page.get_by_role("tab", name="Robot").click()
        page.get_by_role("button", name="All (H)").click()
        page.wait_for_timeout(4000)
        # The hint under the mouse.
        page.mouse.move(480, 780)
        page.wait_for_timeout(1000)
        page.screenshot(path=IMAGES / "robot.png")


def plot() -> None:
    """A plot of ten seconds of a turtle's way."""
    with bus(), turtles():
        tfbus("plot", "world", "turtle2", "--for", "10", "-o", str(IMAGES / "plot.svg"))


def top() -> None:
    """The screen of `tfbus top`, as an SVG of the terminal."""
    with bus(), turtles():
        asyncio.run(_photograph_top())


async def _photograph_top() -> None:
    signals = StopSignals()
    with listening(NodeSettings("_top"), None, goes_on=True) as heard:
        app = TopApp(TopSource(heard), signals)
        async with app.run_test(size=(104, 22)) as pilot:
            await pilot.pause(4.0)
            drawn = app.export_screenshot()
    signals.uninstall()
    # Without letters from elsewhere: the reader's own will do.
    (IMAGES / "top.svg").write_text(re.sub(r"\s*@font-face {.*?}", "", drawn, flags=re.S))


def hand_eye() -> None:
    """The hand of the arm, with the camera where the URDF has it and where it was found."""
    arm = arm_at("shoulder_lift=0.4", "elbow=1.2", "wrist_pitch=-0.2", "wrist_roll=3.1")
    chosen = {"link_axes": True, "only": "^camera(_found)?$"}
    with bus(), running(arm), example("hand_eye.py"):
        tfbus("echo", "base_link", "camera_found", "--once")
        with view_of(**chosen) as url:
            photograph("hand_eye", url, (0.74, -0.34, 0.76), (0.46, 0.0, 0.53))


def marker_in_world() -> None:
    """A camera, the tag that it sees, and the picture between them."""
    with example_page("marker_in_world.py") as url:
        photograph("marker_in_world", url, (-0.35, -0.87, 1.95), (0.65, 0.0, 0.98))


def undistort_scan() -> None:
    """A hall by the raw points of a lidar in red, and by the undistorted ones in blue."""
    with example_page("undistort_scan.py") as url:
        photograph("undistort_scan", url, (1.0, -2.6, 9.2), (1.0, 0.3, 0.5))


def two_robots() -> None:
    """Two robots on their circles."""
    robots = [f"robot{number}/base_link" for number in (1, 2)]
    chosen = {"trails": robots, "trail_s": 16.0, "scale": 1.3}
    with bus(), example("two_robots.py"), view_of("--fleet", "--shared", "map", **chosen) as url:
        tfbus("echo", *robots, "--fleet", "--shared", "map", "--once")
        time.sleep(chosen["trail_s"])
        photograph("two_robots", url, (0.0, -3.6, 4.6), (0.0, -0.4, 0.0))


def mujoco_world() -> None:
    """The double pendulum, with the way of its camera, before it comes to rest."""
    with TemporaryDirectory() as folder:
        bag = f"{folder}/pendulum.mcap"
        with bus(), running([["bag", "record", "-o", bag]]), example("mujoco_world.py"):
            tfbus("echo", "world", "camera", "--once")
            time.sleep(6.0)
        chosen = {"trails": ["camera"], "trail_s": 5.0, "scale": 1.5}
        with view_of("--bag", bag, "--at=-1", **chosen) as url:
            photograph("mujoco_world", url, (0.9, -1.7, 2.3), (0.0, 0.1, 1.6))


def mujoco_robot() -> None:
    """A robot in its room, with its scan, the points of its lidar and what its camera sees."""
    topics = [word for name in ("scan", "points", "camera/image") for word in ("--topic", name)]
    with bus(), example("mujoco_robot.py"):
        tfbus("echo", "world", "camera", "--once")
        time.sleep(4.0)
        with view_of(*topics, scale=0.8) as url:
            time.sleep(4.0)
            photograph("mujoco_robot", url, (-2.4, -3.6, 4.2), (0.6, 0.4, 0.0))


def drone_log() -> None:
    """The recording of the log, with the way of the drone."""
    chosen = {"trails": ["drone"], "trail_s": 12.0, "scale": 2.0}
    with TemporaryDirectory() as folder:
        with bus():
            program = [sys.executable, str(EXAMPLES / "drone_log.py")]
            subprocess.run(program, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        bag = ("--bag", f"{folder}/drone_example.mcap", "--at", "8")
        with view_of(*bag, **chosen) as url:
            photograph("drone_log", url, (20.0, -50.0, 40.0), (28.0, -4.0, 0.0))


def buffer_notebook() -> None:
    """The tree that the buffer is drawn as in a notebook, from the cell that makes it."""
    cells = json.loads((EXAMPLES / "buffer_notebook.ipynb").read_text())["cells"]
    names: dict[str, Any] = {}
    exec("".join(next(cell for cell in cells if cell["cell_type"] == "code")["source"]), names)
    drawn = names["buffer"]._repr_svg_()
    # Where no page gives its colour, as in a picture, text is black: on white in the dark, too.
    (IMAGES / "buffer_notebook.svg").write_text(
        drawn.replace("<svg ", '<svg style="background:#fff" ', 1) + "\n"
    )


TOOLS = (turtle, view, view_recording, robot, plot, top)
OF_EXAMPLES = (
    *(hand_eye, marker_in_world, undistort_scan, two_robots),
    *(mujoco_world, mujoco_robot, drone_log, buffer_notebook),
)
PICTURES = {each.__name__: each for each in (*TOOLS, *OF_EXAMPLES)}


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


def arm_at(*joints: str) -> list[list[str]]:
    """The commands of an arm whose joints stand still, at values such as `elbow=1.2`."""
    still = [word for joint in joints for word in ("--set", joint)]
    return [["launch", "robot", "view:=false", "joints:=none"], ["joints", *still]]


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
def example(name: str) -> Iterator[None]:
    """Run an example until the end."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    program = [sys.executable, str(EXAMPLES / name)]
    process = subprocess.Popen(program, start_new_session=True, **quiet)
    try:
        yield
    finally:
        _end(process)


def example_page(name: str) -> AbstractContextManager[str]:
    """The address of the page that an example shows with --view."""
    return served([sys.executable, str(EXAMPLES / name), "--view"])


@contextmanager
def view_of(*options: str, **settings: Any) -> Iterator[str]:
    """The address of `tfbus view` with these options and settings."""
    with TemporaryDirectory() as folder:
        chosen = Path(folder) / "view.yaml"
        chosen.write_text(yaml.safe_dump(settings))
        port = str(_free_port())
        command = [*TFBUS, "view", "--port", port, "--settings", str(chosen), *options]
        with served(command) as url:
            yield url


@contextmanager
def served(command: Sequence[str]) -> Iterator[str]:
    """Run a command that serves a view until the end; gives the address of the page."""
    process = subprocess.Popen(
        command,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        said = []
        for line in process.stdout:
            if found := re.search(r"View: (http\S+)", line):
                break
            said.append(line)
        else:
            raise SystemExit(f"{' '.join(command)} shows no page: {''.join(said)}")
        Thread(target=process.stdout.read, daemon=True).start()
        yield found[1]
    finally:
        _end(process)


@contextmanager
def opened(url: str, size: tuple[int, int]) -> Iterator["Page"]:
    """A page in a browser with a window of this size, once it is drawn."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        root = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=find_browser(), args=[*FLAGS, *root])
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        # Without a graphics card, and beside others, it may be slow.
        page.set_default_timeout(180_000)
        page.goto(url)
        page.get_by_role("status").first.wait_for()
        page.wait_for_timeout(3000)
        # The notice of a machine without a graphics card.
        page.evaluate(CLOSE_NOTES)
        yield page


_Point = tuple[float, float, float]


def photograph(name: str, url: str, position: _Point, look_at: _Point) -> None:
    """The scene of a page, without its panel, from a place in the fixed frame."""
    camera = {"Position": position, "LookAt": look_at}
    query = "&".join(f"initialCamera{each}={x},{y},{z}" for each, (x, y, z) in camera.items())
    with opened(f"{url}/?{query}", (1040, 520)) as page:
        pause = page.get_by_role("button", name="Pause", exact=True)
        if pause.count():  # that of a recording is held already
            pause.click()
        page.wait_for_timeout(3000)
        drawn = page.locator("canvas").first.screenshot()
    # A scene has few colours: a third of the size.
    picture = Image.open(BytesIO(drawn)).convert("RGB").quantize(128)
    picture.save(IMAGES / f"{name}.png", optimize=True)


def _end(process: "subprocess.Popen[Any]") -> None:
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
        module, package = NEEDS.get(name, ("tfbus", ""))
        if names and name not in names:
            continue
        if find_spec(module):
            print(f"{name}: {take.__doc__}", flush=True)
            take()
        else:
            print(f"{name}: left as it is; it needs {module}: pip install {package}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
