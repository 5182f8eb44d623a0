"""What `tfbus view` costs: python -m benchmarks.view, in an environment with tfbus[dev].

Frames move at 30 Hz, all of them, in a tree two deep. For each number of frames and of browsers it
measures the processor time of the view's process, and the bytes and messages a second that one
browser is sent. These browsers only count. With --pictures a Chromium draws the page too, and the
pictures a second that it draws are counted; without a graphics card that is slow. With --write the
pages about speed are written.
"""

import argparse
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import msgpack

from benchmarks import machine
from benchmarks.parts import Part, Table
from tfbus.buffer.buffer import COMPILED
from tfbus.runtime.installation import installed_version
from tfbus.view.screenshot import FLAGS

RATE_HZ = 30.0
SIZES = (3, 300, 3000)
BROWSERS = (0, 1, 3)

# How long a browser is given to get all that there is, before what follows is counted.
_SETTLE_S = 3.0

# What a page says first: where it looks from. Before that it is none of the page's browsers.
_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 10.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 800,
    "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}

_COUNT_PICTURES = """seconds => new Promise(done => {
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
    """One row: parts of a processor core; bytes and messages a second to each browser."""

    frames: int
    browsers: int
    server_cores: float
    bytes_s: float
    messages_s: float
    pictures_hz: float | None = None


def main() -> None:
    """Measure, and print each row as it comes."""
    parser = argparse.ArgumentParser(prog="benchmarks.view", description=__doc__)
    parser.add_argument("--frames", type=int, nargs="*", default=SIZES)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each row; 5")
    parser.add_argument("--pictures", action="store_true", help="draw the page in a Chromium")
    parser.add_argument("--write", action="store_true", help="write the pages about speed")
    parser.add_argument("--publish", type=int, metavar="N", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish:
        publish(arguments.publish)
        return
    place = machine.describe()
    costs = []
    for count in arguments.frames:
        with serving(count) as (address, server):
            for browsers in BROWSERS:
                cost = measure(count, browsers, address, server, arguments.seconds)
                if arguments.pictures and browsers == 1:
                    cost = replace(cost, pictures_hz=draw(address, arguments.seconds))
                costs.append(cost)
                print(cost, file=sys.stderr, flush=True)
    kind = "compiled" if COMPILED else "interpreted"
    drawn_by = "SwiftShader" if arguments.pictures else ""
    part = Part(
        place,
        {"costs": table(costs)},
        {"tfbus": f"{installed_version()}, {kind}"},
        {"pictures": drawn_by},
    )
    part.show()
    if arguments.write:
        part.keep("view")


def publish(count: int) -> None:
    """Send `count` frames, all of them moving, until killed: one message a tick."""
    import numpy as np

    import tfbus

    names = ("map", *(f"frame{at}" for at in range(count)))
    at = np.arange(count)
    parents = np.where(at % 10 == 0, 0, at - at % 10 + 1)
    edges = np.stack([parents, at + 1], axis=1).astype(np.uint32)
    poses = np.zeros((count, 7))
    poses[:, 0], poses[:, 1], poses[:, 6] = at % 50, at // 50, 1.0
    with tfbus.Node("crowd") as node:
        broadcaster = tfbus.TransformBroadcaster(node)
        while node.wait(1.0 / RATE_HZ):
            now_ns = node.now_ns()
            poses[:, 2] = math.sin(now_ns % 10_000_000_000 / 1e10 * 2.0 * math.pi)
            stamps_ns = np.full(count, now_ns)
            broadcaster.send_transform(tfbus.TransformBatch(names, edges, stamps_ns, poses.copy()))


@contextmanager
def serving(count: int) -> Iterator[tuple[str, int]]:
    """A view of `count` frames: its address, and the id of its process."""
    python = [sys.executable, "-m"]
    with ExitStack() as stack:
        log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "log"
        view = stack.enter_context(running([*python, "tfbus", "view"], log))
        address = wait_for_address(log)
        stack.enter_context(running([*python, "benchmarks.view", "--publish", str(count)]))
        yield address, view.pid


def measure(count: int, browsers: int, address: str, server: int, seconds: float) -> Cost:
    """What is used while this many browsers have the page open."""
    with ExitStack() as stack:
        counters = [stack.enter_context(Counter(address)) for _ in range(browsers)]
        time.sleep(_SETTLE_S)
        start_s, cpu_start_s = time.monotonic(), cpu_s(server)
        before = [(counter.bytes, counter.messages) for counter in counters]
        time.sleep(seconds)
        elapsed_s = time.monotonic() - start_s
        cores = (cpu_s(server) - cpu_start_s) / elapsed_s
        after = [(counter.bytes, counter.messages) for counter in counters]
        sent, messages = (
            sum(now[at] - then[at] for now, then in zip(after, before, strict=True))
            / max(browsers, 1)
            / elapsed_s
            for at in (0, 1)
        )
        return Cost(count, browsers, cores, sent, messages)


class Counter:
    """A browser that draws nothing, and counts what it is sent, on a thread of its own."""

    def __init__(self, address: str) -> None:
        import viser
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self.bytes = 0
        self.messages = 0
        self._socket = connect(
            address.replace("http", "ws", 1),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
        )
        self._socket.send(msgpack.packb(_CAMERA))
        self._thread = threading.Thread(target=self._count)

    def __enter__(self) -> "Counter":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._thread.join()

    def _count(self) -> None:
        # It ends where the connection is closed.
        for message in self._socket:
            self.bytes += len(message)
            self.messages += 1


def draw(address: str, seconds: float) -> float:
    """How many pictures a second a Chromium draws of the page."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=[*FLAGS[1:], "--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.get_by_role("treeitem").first.wait_for(timeout=120e3)
        pictures_hz: float = page.evaluate(_COUNT_PICTURES, seconds)
        browser.close()
        return pictures_hz


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
    """The address that the view has logged."""
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


def table(costs: Sequence[Cost]) -> Table:
    """A row for each."""
    cells = [
        [
            f"{cost.frames:,}",
            str(cost.browsers),
            f"{cost.server_cores:.2f}",
            f"{cost.bytes_s / 1e3:,.0f} kB" if cost.browsers else "",
            f"{cost.messages_s:.0f}" if cost.browsers else "",
            "" if cost.pictures_hz is None else f"{cost.pictures_hz:.1f}",
        ]
        for cost in costs
    ]
    headings = ["browsers", "server, cores", "bytes a second to each", "messages a second"]
    return Table(["frames", *headings, "pictures a second"], cells, words=0)


if __name__ == "__main__":
    main()
