"""What `tfbus view` costs: python -m benchmarks.view, in an environment with tfbus[dev].

Frames move at 30 Hz, all of them, in a tree two deep. For each number of frames and of browsers it
measures the processor time of the view's process, and the bytes and messages a second that one
browser is sent. These browsers only count. With --pictures a Chromium draws the page too, and the
pictures a second that it draws are counted; without a graphics card that is slow. With --write the
pages about speed are written.

With --data a robot also sends 300,000 points a second, in ten clouds, and images of 640 by 480 at
15 Hz: printed are the processor time with and without them, how old clouds are when a browser gets
them, and the pauses between two updates of its frames.
"""

import argparse
import math
import os
import shutil
import struct
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
from tfbus.base.installation import installed_version
from tfbus.buffer.buffer import COMPILED
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
    parser.add_argument("--data", action="store_true", help="measure clouds and images instead")
    parser.add_argument("--publish", type=int, metavar="N", help=argparse.SUPPRESS)
    parser.add_argument("--publish-data", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish_data:
        publish_data()
        return
    if arguments.data:
        for topics in ((), ("points", "camera")):
            print(measure_data(topics, arguments.seconds), flush=True)
        return
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


def publish_data() -> None:
    """Send clouds of 30,000 points at 10 Hz and images at 15 Hz until killed. The first point of a
    cloud has the time in milliseconds as its x.
    """
    import numpy as np

    import tfbus
    from tfbus.messages import Image, PointCloud

    rng = np.random.default_rng(1)
    xyz = rng.uniform(-10.0, 10.0, (30_000, 3)).astype(np.float32)
    pixels = rng.integers(0, 255, (60, 80, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    with tfbus.Node("sensors") as node:
        clouds = node.create_publisher(PointCloud, "points")
        images = node.create_publisher(Image, "camera")

        def cloud() -> None:
            now_ns = node.now_ns()
            xyz[0] = (now_ns // 1_000_000 % _AGAIN_MS, 0.0, 0.0)
            clouds.publish(PointCloud.from_xyz(now_ns, "frame0", xyz))

        def image() -> None:
            rolled = np.roll(pixels, 8, axis=1)
            images.publish(Image.from_pixels(node.now_ns(), "frame0", rolled))

        node.create_timer(0.1, cloud)
        node.create_timer(1.0 / 15.0, image)
        node.spin()


# Whole milliseconds that a float32 holds.
_AGAIN_MS = 16_000_000


@dataclass(frozen=True)
class DataCost:
    """Parts of a core; ages of clouds and pauses between updates of frames, in s: the median, 99 of
    100, and the longest.
    """

    topics: tuple[str, ...]
    load: float
    server_cores: float
    bytes_s: float
    clouds_hz: float
    cloud_age_s: tuple[float, ...]
    frames_hz: float
    frame_pause_s: tuple[float, ...]


def measure_data(topics: Sequence[str], seconds: float) -> DataCost:
    """The cost of a view with one browser that gets 30 frames and the data of these topics."""
    import numpy as np

    options = [part for topic in topics for part in ("--topic", topic)]
    python = [sys.executable, "-m", "benchmarks.view"]
    with ExitStack() as stack:
        address, server = stack.enter_context(serving(30, options))
        if topics:
            stack.enter_context(running([*python, "--publish-data"]))
        counter = stack.enter_context(Counter(address, looks=True))
        # The box of a topic is ticked once the topic has been found.
        time.sleep(_SETTLE_S + 4.0)
        start_s, cpu_start_s, before = time.monotonic(), cpu_s(server), counter.bytes
        counter.cloud_ages_s.clear()
        counter.frames_at_s.clear()
        time.sleep(seconds)
        elapsed_s = time.monotonic() - start_s
        cores, sent = (cpu_s(server) - cpu_start_s) / elapsed_s, counter.bytes - before
        ages, pauses = counter.cloud_ages_s.copy(), np.diff(counter.frames_at_s.copy())

    def shares(values: Sequence[float]) -> tuple[float, ...]:
        found = np.percentile(values, (50, 99, 100)) if len(values) else ()
        return tuple(round(float(each), 3) for each in found)

    return DataCost(
        tuple(topics),
        os.getloadavg()[0],
        round(cores, 3),
        round(sent / elapsed_s),
        round(len(ages) / elapsed_s, 1),
        shares(ages),
        round(len(pauses) / elapsed_s, 1),
        shares(pauses),
    )


@contextmanager
def serving(count: int, options: Sequence[str] = ()) -> Iterator[tuple[str, int]]:
    """A view of `count` frames: its address, and the id of its process."""
    python = [sys.executable, "-m"]
    with ExitStack() as stack:
        log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "log"
        view = stack.enter_context(running([*python, "tfbus", "view", *options], log))
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
    """A browser that draws nothing, and counts what it is sent, on a thread of its own.

    If it `looks`, it notes how old clouds are when they come, and when frames are moved.
    """

    def __init__(self, address: str, *, looks: bool = False) -> None:
        import viser
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self.bytes = 0
        self.messages = 0
        self.cloud_ages_s: list[float] = []
        self.frames_at_s: list[float] = []
        self._looks = looks
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
            if self._looks:
                self._look(bytes(message))

    def _look(self, sent: bytes) -> None:
        import zstandard

        now_s = time.time()
        size = int.from_bytes(sent[8:16], "little")
        inner = msgpack.unpackb(zstandard.ZstdDecompressor().decompress(sent[16 : 16 + size]))
        moves = False
        for message in inner["messages"]:
            name = str(message.get("name", ""))
            if message["type"] == "PointCloudMessage":
                # The buffers are behind, each at a multiple of 8; a cloud comes alone.
                first = (16 + size + 7) // 8 * 8
                (milliseconds,) = struct.unpack_from("<f", sent, first)
                self.cloud_ages_s.append((now_s * 1e3 - milliseconds) % _AGAIN_MS / 1e3)
            elif name.endswith("/frames/axes") and "Update" in message["type"]:
                moves = True
        if moves:
            self.frames_at_s.append(now_s)


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
