"""The part of docs/reference/performance.md about recordings, written by the benchmark."""

import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from benchmarks.recordings import bus
from benchmarks.recordings.bus import Flood
from benchmarks.recordings.measure import TFBUS, Measured
from benchmarks.report import amount, markdown_table
from tfbus.core import kernel
from tfbus.runtime.version import installed_version

MARK = "<!-- the recordings -->"

_ROBOT_CORES = 0.01
_TRANSFORMS_PER_S = 100_000
_LATE_MS = 2.0
_OPEN_S = 1.0

_WHAT = {
    "write": "write a minute, compressed by zstd",
    "write, not compressed": "write a minute, not compressed",
    "read": "read all of a minute into arrays",
    "one frame": "open a minute, all of one frame into arrays",
    "open": "open an hour",
    "frames": "open an hour, list its frames",
    "seek": "seek in an hour, read 0.1 s into arrays",
    "first lookup": "open an hour, one lookup in the middle",
    "lookup anywhere": "a lookup anywhere in an hour",
    "lookup near": "a lookup within 2 s of the one before",
}

_PART = """\
{mark}

## Recordings

`make bench ARGS="--only recordings"` measured this part. {place}
Where that load is not far below one, other processes used the cores: then times by the clock (late,
a second) say little, CPU is higher too, and ratios say most.

{versions}

A robot of 50 frames at 50 Hz, one message a tick, all poses change: 3,000 messages in a minute,
180,000 in an hour, which is a file of {hour}. Numbers are CPU, which other processes lengthen less
than time, of a process that did the same, or a little of it, before; medians of runs that take
turns. The ratio is what the peer takes over what tfbus takes.

{files}

- **Write**: tfbus has columns as they come from the bus, and writes CDR; mcap has the bytes of CDR,
  made in advance, and only writes; rosbags has its own messages, made in advance, and serialises.
- **Read**: all read the same file, which tfbus wrote, and make one array of all stamps and one of
  all poses. rosbags, and mcap-ros2-support, by which mcap decodes, make objects in Python of each
  message.
- **Open** an hour: tfbus says its duration and streams, mcap reads the summary, rosbags says its
  duration and topics. No program reads all of the file.
- **A lookup** is from end to end of five edges, interpolated, at stamps in no order: each reads and
  keeps the 2 s around its stamp. No library for recordings has lookups; tf2's way is to play
  everything from the beginning into a buffer of 10 s, which is measured, once, with tfbus's own
  reader and buffer.

On the bus:

| measure | result | goal | reached |
| --- | ---: | ---: | ---: |
{live}

- **CPU to record** is that of `tfbus bag record`, of all its threads, over {robot_s:.0f} s of the
  robot: from one publisher, and from ten with five frames each, which are ten times the messages.
- **Without loss**: one publisher sends for {flood_s:.0f} s, twice as fast each time, until a
  message is missing in the file in each of three tries, or until it is too slow itself: it is one
  process in Python on the same cores, which drops what Zenoh does not take at once. The table below
  has each rate that it reached.
- **Late** is a message of `tfbus bag play`, 1,000 a second for {play_s} s: from the time at which
  it is due until Zenoh hands it over in another process. Beside it a loop in Python that sleeps
  until the next message is due, and puts it on bare Zenoh: what the machine allowed.

{floods}
"""


def part(measured: Measured, place: str) -> str:
    """The part of the page."""
    return _PART.format(
        mark=MARK,
        place=place,
        versions=_versions(),
        hour=f"{measured.hour_bytes / 1e6:,.0f} MB",
        files=_files(measured.cpu_s),
        live="\n".join(f"| {' | '.join(row)} |" for row in _live(measured)),
        floods=_floods(measured.floods),
        robot_s=bus.ROBOT_S,
        flood_s=bus.FLOOD_S,
        play_s=bus.PLAY_S,
    )


def _versions() -> str:
    kind = "compiled" if kernel.__file__.endswith(".so") else "interpreted"
    lines = [f"- tfbus: {installed_version()}, {kind}, Python {platform.python_version()}"]
    for name in ("mcap", "mcap-ros2-support", "rosbags"):
        with suppress(PackageNotFoundError):
            lines.append(f"- {name}: {version(name)}")
    return "\n".join(lines)


def _files(cpu_s: Mapping[str, Mapping[str, float | str]]) -> str:
    cells = []
    for what, text in _WHAT.items():
        ours = cpu_s[what][TFBUS]
        peers = [who for who in cpu_s[what] if who != TFBUS]
        for who in peers or [""]:
            theirs = cpu_s[what].get(who)
            ratio = ""
            if isinstance(ours, float) and isinstance(theirs, float):
                ratio = f"{theirs / ours:.2f} x"
            cells.append(
                [
                    text,
                    who,
                    "" if theirs is None else _taken(theirs),
                    _taken(ours),
                    ratio,
                ]
            )
    return markdown_table(["measure", "peer", "peer takes", "tfbus takes", "ratio"], cells, words=2)


def _taken(cpu_s: float | str) -> str:
    return cpu_s if isinstance(cpu_s, str) else amount(1e9 * cpu_s)


def _live(measured: Measured) -> list[tuple[str, str, str, str]]:
    rows = []
    for publishers, cores in measured.robot_cores.items():
        sent_by = "one publisher" if publishers == 1 else f"{publishers} publishers"
        what = f"CPU to record the robot, {sent_by}"
        goal = f"at most {100.0 * _ROBOT_CORES:g} % of a core" if publishers == 1 else ""
        reached = _reached(cores <= _ROBOT_CORES) if goal else ""
        rows.append((what, f"{100.0 * cores:.1f} % of a core", goal, reached))
    for count, floods in measured.floods.items():
        rate = max((flood.rate for flood in floods if not flood.lost), default=0.0)
        what = f"transforms recorded without loss, {count} to a message"
        goal = f"{_TRANSFORMS_PER_S:,} a second" if count > 1 else ""
        reached = _reached(rate >= 0.99 * _TRANSFORMS_PER_S) if goal else ""
        rows.append((what, f"{rate:,.0f} a second", goal, reached))
    ours, bare = measured.timing[bus.REPLAYED], measured.timing[bus.BARE]
    both = f"{ours.p50_ms:.2f} ms ({bare.p50_ms:.2f} ms)"
    rows.append(("late at 1 kHz, p50 (bare Zenoh)", both, "", ""))
    both = f"{ours.p99_ms:.2f} ms ({bare.p99_ms:.2f} ms)"
    goal = f"at most {_LATE_MS:g} ms"
    rows.append(("the same, p99", both, goal, _reached(ours.p99_ms <= _LATE_MS)))
    opened = measured.cpu_s["open"][TFBUS]
    assert isinstance(opened, float)
    goal = f"at most {_OPEN_S:g} s"
    rows.append(("open an hour", amount(1e9 * opened), goal, _reached(opened <= _OPEN_S)))
    return rows


def _reached(is_reached: bool) -> str:
    return "yes" if is_reached else "NO"


def _floods(floods: Mapping[int, Sequence[Flood]]) -> str:
    cells = [
        [str(rows), f"{flood.rate:,.0f}", f"{flood.sent:,}", f"{flood.lost:,}"]
        for rows, of_size in floods.items()
        for flood in of_size
    ]
    return markdown_table(
        ["transforms to a message", "transforms a second", "messages", "not recorded"], cells
    )
