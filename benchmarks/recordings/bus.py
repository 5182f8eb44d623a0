"""What it takes to record a bus and to replay on it: processes, and the measures made with them."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.bus.intake import Template
from benchmarks.bus.place import Place, Process, place, say, wait_for_line
from tfbus.recording.items import RecordedStream, TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter

ROBOT_S = 15.0
FLOOD_S = 5.0
PLAY_S = 10
PLAY_HZ = 1_000
REPLAYED, BARE = "replayed", "bare Zenoh"
# From this rate on, each twice the one before, until messages are lost.
FIRST_RATE = 25_000
MOST_RATE = 3_200_000
_TRIES = 3
# Of the rate, where the publisher keeps up.
_KEPT_UP = 0.9
_STARTED_WITHIN_S = 60.0


@dataclass(frozen=True)
class Flood:
    """Transforms that were sent within a second, and how many messages of all were not recorded."""

    rate: float
    sent: int
    lost: int


@dataclass(frozen=True)
class Timing:
    """How late messages are that are replayed 1,000 times a second, in ms; and how many came."""

    p50_ms: float
    p99_ms: float
    count: int


def record_robot(publishers: int, runs: int) -> float:
    """The cores that `tfbus bag record` takes for a robot of 50 frames at 50 Hz: the median."""
    taken = []
    for _ in range(runs):
        with place() as at, _recorder(at) as (pid, _):
            arguments: dict[str, Any] = {
                "publishers": publishers,
                "rows": 50 // publishers,
                "rate": 50.0,
            }
            with Process(at, "recordings.bus:send", at.connecting(), **arguments) as sender:
                sender.hear()
                time.sleep(2.0)
                before_s, began_s = _cpu_s(pid), time.monotonic()
                time.sleep(ROBOT_S)
                taken.append((_cpu_s(pid) - before_s) / (time.monotonic() - began_s))
    return median(taken)


def without_loss(rows: int) -> list[Flood]:
    """Floods at larger and larger rates, until messages are lost or the publisher is too slow."""
    floods: list[Flood] = []
    rate = FIRST_RATE if rows > 1 else FIRST_RATE // 25
    while rate <= MOST_RATE:
        floods.append(_best(rows, rate))
        if floods[-1].lost or floods[-1].rate < _KEPT_UP * rate:
            break
        rate *= 2
    return floods


def _best(rows: int, rate: float) -> Flood:
    """The flood that loses least: another process may take the cores for a moment."""
    floods = [_flood(rows, rate)]
    while floods[-1].lost and len(floods) < _TRIES:
        floods.append(_flood(rows, rate))
    return min(floods, key=lambda flood: flood.lost)


def _flood(rows: int, rate: float) -> Flood:
    with place() as at:
        with _recorder(at) as (_, file):
            arguments: dict[str, Any] = {"rows": rows, "rate": rate / rows, "seconds": FLOOD_S}
            with Process(at, "recordings.bus:send", at.connecting(), **arguments) as sender:
                sender.hear()
                sent, elapsed_s = sender.hear()
                # Before the publisher is gone all of it has arrived.
                time.sleep(1.0)
        with RecordingReader(file) as reader:
            came = sum(stream.messages for stream in reader.streams)
        return Flood(sent * rows / elapsed_s, sent, sent - came)


@contextmanager
def _recorder(at: Place) -> Iterator[tuple[int, Path]]:
    """`tfbus bag record`, which has begun; its process and its file."""
    file = at.folder / "recorded.mcap"
    command = [sys.executable, "-m", "tfbus", "bag", "record", "-o", str(file)]
    with _command(at, command, at.listening()) as process:
        deadline_s = time.monotonic() + _STARTED_WITHIN_S
        while not file.exists() and process.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.05)
        if not file.exists():
            raise RuntimeError(f"tfbus bag record did not start: {_said(at)}")
        yield process.pid, file


@contextmanager
def _command(
    at: Place, command: list[str], env: dict[str, str]
) -> "Iterator[subprocess.Popen[bytes]]":
    """A command, ended as by Ctrl-C."""
    with open(at.folder / "said", "wb") as said:
        process = subprocess.Popen(
            command, cwd=at.folder, env=env, stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _said(at: Place) -> str:
    return (at.folder / "said").read_text()[-2_000:]


def _cpu_s(pid: int) -> float:
    """The CPU of a process so far, of all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def send(rows: int, rate: float, publishers: int = 1, seconds: float | None = None) -> None:
    """The process that sends messages of `rows` transforms at a rate, from each of its publishers;
    says how many were sent.
    """
    import numpy as np

    import tfbus

    ended = threading.Event()
    threading.Thread(target=lambda: (wait_for_line(), ended.set()), daemon=True).start()
    edges = np.array([(0, 1 + row) for row in range(rows)], np.uint32)
    poses = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (rows, 1))
    phases = np.arange(rows)
    with tfbus.Node("robot") as node:
        broadcasters, names = [], []
        for each in range(publishers):
            broadcasters.append(tfbus.TransformBroadcaster(node, stream=f"robot/{each}"))
            names.append(("base_link", *(f"joint_{each}_{row}" for row in range(rows))))
        for broadcaster, frames in zip(broadcasters, names, strict=True):
            stamps = np.full(rows, time.time_ns())
            broadcaster.send_transform(tfbus.TransformBatch(frames, edges, stamps, poses))
        # The recorder meets the streams.
        time.sleep(2.0)
        say("ready")
        sent, due_s = 0, time.monotonic()
        began_s, until_s = due_s, due_s + (seconds or 1e9)
        while not ended.is_set() and time.monotonic() < until_s:
            poses[:, 0] = np.cos(0.01 * sent + phases)
            for broadcaster, frames in zip(broadcasters, names, strict=True):
                stamps = np.full(rows, time.time_ns())
                broadcaster.send_transform(tfbus.TransformBatch(frames, edges, stamps, poses))
            sent += 1
            due_s += 1.0 / rate
            left_s = due_s - time.monotonic()
            if left_s > 0.0:
                ended.wait(left_s)
        # The first of each publisher came before.
        say([(sent + 1) * publishers, time.monotonic() - began_s])
        ended.wait()
        os._exit(0)


def play(runs: int) -> dict[str, Timing]:
    """How late messages arrive that `tfbus bag play` replays, and those that a process with bare
    Zenoh sends at the same pace: of each the run with the median p99. The two take turns.
    """
    timings: dict[str, list[Timing]] = {REPLAYED: [], BARE: []}
    for _ in range(runs):
        for kind, taken in timings.items():
            late_ms = _late_ms(kind)
            p50, p99 = (late_ms[round(share * (len(late_ms) - 1))] for share in (0.5, 0.99))
            taken.append(Timing(p50, p99, len(late_ms)))
    return {
        kind: sorted(taken, key=lambda timing: timing.p99_ms)[len(taken) // 2]
        for kind, taken in timings.items()
    }


def _late_ms(kind: str) -> list[float]:
    with place() as at, Process(at, "recordings.bus:hear_played", at.listening()) as listener:
        listener.hear()
        if kind == BARE:
            with Process(at, "recordings.bus:send_bare", at.connecting()) as sender:
                sender.hear()
        else:
            file = at.folder / "played.mcap"
            _make_played(file)
            command = [sys.executable, "-m", "tfbus", "bag", "play", str(file), "--quiet"]
            with _command(at, command, at.connecting()) as process:
                process.wait(PLAY_S + _STARTED_WITHIN_S)
        listener.tell()
        late_ms = sorted(listener.hear())
        if not late_ms:
            raise RuntimeError(f"nothing was replayed: {kind}")
        return late_ms


def _make_played(file: Path) -> None:
    """A file whose messages are received at the times of their stamps."""
    import numpy as np

    from tfbus.geometry.columns import Columns

    stream = RecordedStream("robot", "robot", epoch_ns=1)
    edges = np.array([(0, 1)], np.uint32).tobytes()
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]).tobytes()
    began_ns = 1_700_000_000_000_000_000
    with RecordingWriter(file) as writer:
        for message in range(PLAY_S * PLAY_HZ):
            at_ns = began_ns + message * 1_000_000_000 // PLAY_HZ
            stamps = np.array([at_ns]).tobytes()
            rows = Columns.of_bytes(("map", "base_link"), edges, stamps, pose)
            writer.write(TransformItem(at_ns, stream, rows, seq=message))


def send_bare() -> None:
    """The process that sends at the same pace without tfbus's player: in a loop that sleeps."""
    import zenoh

    from tfbus import NodeSettings
    from tfbus.bus.zenoh_config import zenoh_config
    from tfbus.wire.keys import transforms_key

    message = Template(1)
    with zenoh.open(zenoh_config(NodeSettings("sender"))) as session:
        publisher = session.declare_publisher(transforms_key("robot"))
        time.sleep(1.0)
        began_ns, ahead_ns = time.monotonic_ns(), time.time_ns() - time.monotonic_ns()
        for number in range(PLAY_S * PLAY_HZ):
            due_ns = began_ns + number * 1_000_000_000 // PLAY_HZ
            left_ns = due_ns - time.monotonic_ns()
            if left_ns > 0:
                time.sleep(left_ns / 1e9)
            publisher.put(message.next(due_ns + ahead_ns))
        time.sleep(0.5)
    say("done")


def hear_played() -> None:
    """The process that hears the transforms, whose stamps are those at which they are due."""
    import zenoh

    from tfbus import NodeSettings
    from tfbus.bus.zenoh_config import zenoh_config
    from tfbus.wire.keys import transforms_key
    from tfbus.wire.transforms import decode_transforms

    came: list[tuple[int, bytes]] = []

    def take(sample: zenoh.Sample) -> None:
        came.append((time.time_ns(), sample.payload.to_bytes()))

    with zenoh.open(zenoh_config(NodeSettings("listener"))) as session:
        handler = zenoh.handlers.Callback(take, None, indirect=False)
        session.declare_subscriber(transforms_key("robot"), handler)
        say("ready")
        wait_for_line()
        say(
            [
                (came_ns - int(decode_transforms(payload).rows.stamps_as_ints()[0])) / 1e6
                for came_ns, payload in came
            ]
        )
        wait_for_line()
