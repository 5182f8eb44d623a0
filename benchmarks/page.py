"""docs/reference/performance.md: whether tfbus is faster than another, by what factor, on what."""

import re
import textwrap
from collections.abc import Iterable, Sequence

from benchmarks.parts import Part, Table, kept
from benchmarks.processes import INTERPRETED

_PAGE = """\
# How fast tfbus is

`make bench` measures and writes this page; [how each number was
measured](performance-tables.md). A ratio is what the other takes over what tfbus takes: above one,
tfbus is faster, or smaller. Numbers differ on other machines, ratios less.

{peers}

{versions}

{others}

## The buffer

![The time of one lookup by depth, number of frames and number of samples](performance.svg)

transform-tree and pytransform3d answer with matrices; transform-tree has a fixed topology.

## The bus

Between processes on loopback. A message that comes alone costs most, to wake threads and to take
Python's lock, as with bare Zenoh; [more measures](performance-tables.md#the-bus).

![The CPU of a listener, by publishers and by frames](performance-bus.svg)

[Scaling](../guide/scaling.md) says what follows.

## Large messages

Clouds of points on one host: CPU of both ends over bare Zenoh's by TCP, median latency. Bare Zenoh
calls back with bytes; tfbus checks a message, on the node's thread. {large_place}

{large}

{bridge}Frames at 50 Hz beside a camera that fills the link, their age (p99):

{beside}

An hour of faults, `python -m benchmarks.soak`: every 5 s one of six publishers is killed and
restarted, every 120 s the router.

![Memory, open files and threads of three listeners over time](soak.svg)

## Recordings

A robot of 50 frames at 50 Hz: 3,000 messages in a minute, {hour} in an hour. When it writes, tfbus
makes the messages too, which mcap has in advance.

{files}

## Robots

Made-up robots: an arm of {arm}, a humanoid of {humanoid}; CPU. {robots_place}

{robots}

## The view

`tfbus view` with one browser, which only counts what it is sent; all frames move at 30 Hz.
{view_place}

{view}

## A small machine

A publisher sends {frames} frames at {rate} Hz, in messages of all, to those with frames.
{resources_place}

{resources}
"""

# The rows of the first table, and what a row of the measurement is called.
_PEERS = {
    "one lookup by names, 3 edges": "one lookup, 3 edges",
    "one lookup by names, 30 edges": "one lookup, 30 edges",
    "one lookup, 3 edges, up to 10 s back": "one lookup up to 10 s back, 3 edges",
    "the latest, 3 edges": "the latest, 3 edges",
    "insert one": "insert one",
    "insert columns of 50, each": "insert 50 in one call, each",
    "50,000 stamps in one call, sorted, each": "50,000 lookups in one call, each",
    "memory of a stored sample": "memory of a sample",
}
_COLUMNS = {
    "tf2": "tf2 from C++",
    "tf2_py": "tf2_py",
    "schiebung": "schiebung",
    "transform-tree": "transform-tree",
    "pytransform3d": "pytransform3d",
}

_FILES = (
    ("write a minute, compressed by zstd", "mcap"),
    ("write a minute, compressed by zstd", "rosbags"),
    ("read all of a minute into arrays", "mcap"),
    ("read all of a minute into arrays", "rosbags"),
    ("open an hour", "rosbags"),
    ("seek in an hour, read 0.1 s into arrays", "rosbags"),
    ("open an hour, one lookup in the middle", "all from the beginning into a buffer"),
)

_LIVE = (
    "CPU to record the robot, one publisher",
    "transforms recorded without loss, 50 to a message",
)

_ROBOTS = (
    ("an arm", "where all links are"),
    ("a humanoid", "read the URDF"),
    ("a humanoid", "where all links are"),
    ("a humanoid", "where all links are in 10,000 configurations"),
)


def made() -> str:
    """The whole page."""
    buffer, bus, files, robots = kept("buffer"), kept("bus"), kept("recordings"), kept("robots")
    view, resources, large = kept("view"), kept("resources"), kept("large")
    return _PAGE.format(
        versions=_versions(buffer),
        peers=_peers(buffer).as_markdown(),
        others=_others(bus).as_markdown(),
        large=_large(large).as_markdown(),
        large_place=_elsewhere(large, buffer),
        bridge=_bridge(large),
        beside=large.tables["beside"].as_markdown(),
        hour=files.facts["hour"],
        files=_files(files).as_markdown(),
        arm=robots.facts["arm"],
        humanoid=robots.facts["humanoid"],
        robots=_robots(robots).as_markdown(),
        robots_place=_elsewhere(robots, buffer),
        view=_view(view).as_markdown(),
        view_place=_elsewhere(view, buffer),
        frames=resources.facts["frames"],
        rate=resources.facts["rate"],
        resources=_only(
            resources.tables["processes"],
            [row[0] for row in resources.tables["processes"].rows],
            ("process", "CPU", "wake-ups", "memory", "threads", "start"),
        ).as_markdown(),
        resources_place=_elsewhere(resources, buffer),
    )


def _elsewhere(part: Part, first: Part) -> str:
    """The load of a part that was measured at another time."""
    load = re.search(r"load [\d.]+", part.place)
    is_apart = part.place != first.place and load is not None
    return f"Measured apart, at a {load[0]}." if is_apart and load else ""


def _versions(part: Part) -> str:
    """The versions of the peers in a sentence."""
    versions = [what for who, what in part.versions.items() if who != INTERPRETED]
    text = (
        '"tf2" is libtf2 called from C++, "tf2_py" its module for Python; tfbus and all others are '
        f"called from Python. {part.place} {', '.join(versions)}."
    )
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False)


def _short(ratio: str) -> str:
    """A ratio in two digits or so: 5.3 x, 36 x, 12,000 x."""
    number = float(ratio.removesuffix(" x").replace(",", ""))
    if number >= 1_000:
        return f"{float(f'{number:.2g}'):,.0f} x"
    return f"{number:.0f} x" if number >= 10 else f"{number:.1f} x"


def _peers(buffer: Part) -> Table:
    table, rows = buffer.tables["peers"], []
    for what, text in _PEERS.items():
        ours, ratios = "", []
        for peer in _COLUMNS.values():
            try:
                row = table.row(what, peer)
            except KeyError:
                ratios.append("-")
                continue
            ours = row["tfbus takes"]
            ratios.append(row["ratio"] if row["ratio"] == "-" else _short(row["ratio"]))
        rows.append([text, ours, *ratios])
    return Table(["", "tfbus", *_COLUMNS], rows)


def _others(bus: Part) -> Table:
    measures, rows = bus.tables["measures"], []
    received = measures.row("CPU of a transform, 50 to a message")
    if received["ratio"]:
        rows.append(_beside("receive a transform, CPU", received, received["ratio"]))
    for part in ("p50", "p99"):
        row = measures.row(f"latency of a transform, {part}")
        ratio = 1.0 / float(row["ratio"].removesuffix(" x"))
        rows.append(_beside(f"latency of a transform, {part}", row, f"{ratio:.2f} x"))
    return Table(["", "tfbus", "beside it", "ratio"], rows)


def _beside(what: str, row: dict[str, str], ratio: str) -> list[str]:
    return [what, row["tfbus"], row["beside it"], _fine(ratio)]


def _fine(ratio: str) -> str:
    """A ratio of which two digits count below ten."""
    number = float(ratio.removesuffix(" x"))
    return f"{number:.2f} x" if number < 2 else _short(ratio)


def _only(table: Table, names: Iterable[str], headings: Sequence[str]) -> Table:
    rows = [[table.row(name)[heading] for heading in headings] for name in names]
    return Table(headings, rows)


_LARGE_SIZES = ("1 kB", "1 MB", "16 MB")


def _large(large: Part) -> Table:
    """Who sends by size, from a row for each."""
    table, rows = large.tables["sizes"], []
    for who in dict.fromkeys(row[1] for row in table.rows):
        cells = []
        for size in _LARGE_SIZES:
            row = table.row(size, who)
            latency = "" if row["latency p50"] == "-" else f", {row['latency p50']}"
            cells.append(f"{row['both over bare Zenoh']}{latency}")
        rows.append([who, *cells])
    return Table(["", *_LARGE_SIZES], rows)


def _bridge(large: Part) -> str:
    table = large.tables.get("bridge")
    if table is None:
        return ""
    shares = [f"{row[1]} {row[0]}" for row in table.rows]
    return (
        "`tfbus ros2 --via dds`, 30 clouds of 1 MB a second, rclpy from wheels: "
        f"{', '.join(shares)}, of a core.\n\n"
    )


def _files(files: Part) -> Table:
    rows = []
    for what, peer in _FILES:
        row = files.tables["files"].row(what, peer)
        rows.append([what, row["tfbus takes"], f"{peer}: {row['peer takes']}", _fine(row["ratio"])])
    for what in _LIVE:
        rows.append([what, files.tables["live"].row(what)["result"], "", ""])
    return Table(["CPU", "tfbus", "beside it", "ratio"], rows)


def _view(view: Part) -> Table:
    table = view.tables["costs"]
    rows = [[row[0], *row[2:6]] for row in table.rows if row[1] == "1"]
    return Table([table.headings[0], *table.headings[2:6]], rows, words=0)


def _robots(robots: Part) -> Table:
    rows = []
    for robot, what in _ROBOTS:
        row = robots.tables["peers"].row(robot, what)
        ratios = [_fine(row[f"over {peer}"]) for peer in ("yourdfpy", "pytransform3d")]
        rows.append([f"{robot}: {what}", row["tfbus"], *ratios])
    return Table(["", "tfbus", "yourdfpy", "pytransform3d"], rows)
