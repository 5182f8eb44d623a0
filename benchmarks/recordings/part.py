"""The part about recordings, as tables."""

from collections.abc import Mapping, Sequence

from benchmarks.parts import Part, Table
from benchmarks.recordings import bus
from benchmarks.recordings.bus import Flood
from benchmarks.recordings.measure import TFBUS, Measured
from benchmarks.report import amount

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


def part(measured: Measured, place: str) -> Part:
    """The part of the pages about it."""
    return Part(
        place,
        {
            "files": _files(measured.cpu_s),
            "live": Table(["measure", "result", "goal", "reached"], _live(measured)),
            "floods": _floods(measured.floods),
        },
        measured.versions,
        {
            "hour": f"{measured.hour_bytes / 1e6:,.0f} MB",
            "robot_s": f"{bus.ROBOT_S:.0f}",
            "flood_s": f"{bus.FLOOD_S:.0f}",
            "play_s": str(bus.PLAY_S),
        },
    )


def _files(cpu_s: Mapping[str, Mapping[str, float | str]]) -> Table:
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
    return Table(["measure", "peer", "peer takes", "tfbus takes", "ratio"], cells, words=2)


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


def _floods(floods: Mapping[int, Sequence[Flood]]) -> Table:
    cells = [
        [str(rows), f"{flood.rate:,.0f}", f"{flood.sent:,}", f"{flood.lost:,}"]
        for rows, of_size in floods.items()
        for flood in of_size
    ]
    headings = ["transforms to a message", "transforms a second", "messages", "not recorded"]
    return Table(headings, cells, words=0)
