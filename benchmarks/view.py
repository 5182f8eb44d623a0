"""What `tfbus view` costs: python -m benchmarks.view, in an environment with tfbus[dev].

Frames move at 30 Hz, all of them, in a tree two deep. For each number of frames and of browsers it
measures the processor time of the view's process and of the browsers, the bytes a second that one
browser is sent, and the frames a second that a page draws, by a Chromium without a graphics card.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import machine
from tfbus.nodes.viewer.screenshot import FLAGS

RATE_HZ = 30.0
SIZES = (3, 300, 3000)
BROWSERS = (0, 1, 3)

HEADER = """\
| frames | browsers | server, cores | browsers, cores | to one browser | pictures a second |
| ---: | ---: | ---: | ---: | ---: | ---: |"""

_COUNT_FRAMES = """seconds => new Promise(done => {
  const start = performance.now(); let count = 0;
  const draw = now => {
    count++;
    if (now - start < seconds * 1e3) requestAnimationFrame(draw);
    else done(count * 1e3 / (now - start));
  };
  requestAnimationFrame(draw);
})"""


@dataclass(frozen=True)
class Cost:
    """One row: parts of a processor core, bytes a second to one browser, pictures a second."""

    frames: int
    browsers: int
    server_cores: float
    browser_cores: float
    bytes_s: float
    pictures_hz: float


def main() -> None:
    """Measure, and print each row as it comes."""
    parser = argparse.ArgumentParser(prog="benchmarks.view", description=__doc__)
    parser.add_argument("--frames", type=int, nargs="*", default=SIZES)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each row; 5")
    parser.add_argument("--publish", type=int, metavar="N", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish:
        publish(arguments.publish)
        return
    print(machine.describe(), HEADER, sep="\n\n", flush=True)
    for count in arguments.frames:
        for cost in measure(count, arguments.seconds):
            print(row(cost), flush=True)


def publish(count: int) -> None:
    """Send `count` frames, all of them moving, until killed: one message a tick."""
    import math

    import tfbus

    with tfbus.Node("crowd") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        while node.wait(1.0 / RATE_HZ):
            now_ns = node.now_ns()
            turn = (now_ns % 10_000_000_000) / 1e10 * 2.0 * math.pi
            broadcaster.send_transform(
                [
                    tfbus.TransformStamped(
                        now_ns,
                        "map" if at % 10 == 0 else f"frame{at - at % 10}",
                        f"frame{at}",
                        tfbus.Transform.from_rpy(
                            0.0, 0.0, turn, (float(at % 50), at // 50 + math.sin(turn), 0.0)
                        ),
                    )
                    for at in range(count)
                ]
            )


def measure(count: int, seconds: float) -> Iterator[Cost]:
    """The rows of one number of frames."""
    from playwright.sync_api import sync_playwright

    python = [sys.executable, "-m"]
    with ExitStack() as stack:
        stack.enter_context(running([*python, "benchmarks.view", "--publish", str(count)]))
        log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "log"
        view = stack.enter_context(running([*python, "tfbus", "view"], log))
        address = wait_for_address(log)
        driver = stack.enter_context(sync_playwright())
        for browsers in BROWSERS:
            with ExitStack() as pages:
                browser = driver.chromium.launch(
                    executable_path=shutil.which("chromium"),
                    args=[*FLAGS[1:], "--no-sandbox"],
                )
                pages.callback(browser.close)
                opened = [open_page(browser, address) for _ in range(browsers)]
                time.sleep(2.0)
                yield cost_of(count, opened, view.pid, address, seconds)


def cost_of(count: int, pages: list[Any], server: int, address: str, seconds: float) -> Cost:
    """What is used while so many pages are open; nothing is sent where there is none."""
    start_s, server_s, browser_s = time.monotonic(), cpu_s(server), browsers_s()
    pictures_hz = pages[0].evaluate(_COUNT_FRAMES, seconds) if pages else 0.0
    if not pages:
        time.sleep(seconds)
    elapsed_s = time.monotonic() - start_s
    server_s, browser_s = cpu_s(server) - server_s, browsers_s() - browser_s
    return Cost(
        count,
        len(pages),
        server_s / elapsed_s,
        browser_s / elapsed_s,
        bytes_per_second(address, seconds) if pages else 0.0,
        pictures_hz,
    )


def bytes_per_second(address: str, seconds: float) -> float:
    """What the server sends to one more client that only counts, after its first second."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    received, start_s = 0, time.monotonic()
    url = address.replace("http", "ws", 1)
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with connect(url, subprotocols=[protocol], max_size=None) as socket:
        while (now_s := time.monotonic()) < start_s + 1.0 + seconds:
            message = socket.recv(10.0)
            received += len(message) if now_s > start_s + 1.0 else 0
    return received / seconds


def open_page(browser: Any, address: str) -> Any:
    """A page of its own window, with frames in it."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(address)
    page.get_by_role("treeitem").first.wait_for(timeout=120e3)
    return page


@contextmanager
def running(command: list[str], log: Path | None = None) -> Iterator["subprocess.Popen[bytes]"]:
    """A process for as long as the `with` lasts; what it prints goes to a file."""
    with open(log or os.devnull, "wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20.0)


def wait_for_address(log: Path) -> str:
    """The address that the view has told in its log."""
    deadline_s = time.monotonic() + 60.0
    while "View: " not in log.read_text():
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"the view did not start: {log.read_text()}")
        time.sleep(0.1)
    return log.read_text().partition("View: ")[2].split()[0]


def cpu_s(pid: int) -> float:
    """The processor time of a process so far, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def browsers_s() -> float:
    """The processor time of all processes of Chromium."""
    total_s = 0.0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (process / "comm").read_text().startswith("chrom"):
                total_s += cpu_s(int(process.name))
        except OSError:
            continue  # it has ended meanwhile
    return total_s


def row(cost: Cost) -> str:
    """A row of the table, in Markdown."""
    cells = [f"{cost.frames:,}", str(cost.browsers), f"{cost.server_cores:.2f}"]
    if cost.browsers:
        cells += [f"{cost.browser_cores:.2f}", f"{cost.bytes_s / 1e3:,.0f} kB/s"]
        cells.append(f"{cost.pictures_hz:.0f}")
    else:
        cells += ["", "", ""]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
