"""The part that is about the bus, as tables."""

from collections.abc import Sequence

from benchmarks.bus import interest, paced, robot, startup
from benchmarks.bus.growth import RATE, Size
from benchmarks.bus.latency import TURN
from benchmarks.bus.measure import Measured
from benchmarks.bus.startup import PHASES
from benchmarks.parts import Part, Table
from benchmarks.report import amount

_SINGLE_PER_S = 150_000
_CPU_NS = 1e9 / 3_000_000
_CPU_RATIO = 15.0
_LATENCY_RATIO = 1.2
_READING_SHARE = 0.02
_PACED_RATIO = 1.15
_STARTUP_S = 0.15
_MEMORY = 40e6

_MEASURES = ["measure", "tfbus", "beside it", "ratio", "goal", "reached"]


def part(measured: Measured, place: str) -> Part:
    """The part of the pages about it."""
    return Part(
        place,
        {
            "measures": Table(_MEASURES, _rows(measured)),
            "starts": _starts(measured.starts),
            "publishers": _sizes("publishers", measured.publishers),
            "frames": _sizes("frames", measured.frames),
        },
        facts={
            "turn": str(TURN),
            "count": f"{min(measured.ours.count, measured.bare.count):,}",
            "paced_rate": f"{paced.RATE:,}",
            "joints": str(robot.JOINTS),
            "rate": f"{RATE:,}",
            "tf2_ros": f" Not measured: {measured.theirs}."
            if isinstance(measured.theirs, str)
            else "",
        },
    )


def _rows(measured: Measured) -> list[list[str]]:
    single, fifty = measured.single, measured.fifty
    start, bare_start = measured.starts["at a given endpoint"], measured.starts[startup.BARE]
    rows = [
        _row(
            "single-transform messages into the buffer",
            f"{single.messages_per_s:,.0f} a second",
            goal=f"{_SINGLE_PER_S:,} a second",
            reached=single.messages_per_s >= _SINGLE_PER_S,
        ),
        _row("CPU of one of them", amount(single.cpu_ns)),
        _row(
            "transforms, 50 to a message, a core",
            f"{1e9 / fifty.cpu_ns:,.0f} a second",
            goal=f"{1e9 / _CPU_NS:,.0f} a second",
            reached=fifty.cpu_ns <= _CPU_NS,
        ),
        _row("the same by the clock", f"{fifty.transforms_per_s:,.0f} a second"),
    ]
    if isinstance(measured.theirs, str):
        rows.append(_row("CPU of a transform, 50 to a message", amount(fifty.cpu_ns)))
    else:
        ratio = measured.theirs.cpu_ns / fifty.cpu_ns
        rows.append(
            _row(
                "CPU of a transform, 50 to a message",
                amount(fifty.cpu_ns),
                f"tf2_ros: {amount(measured.theirs.cpu_ns)}",
                f"{ratio:.1f} x",
                f"{_CPU_RATIO:g} x",
                ratio >= _CPU_RATIO,
            )
        )
    ours, bare = measured.ours, measured.bare
    for name, one, other in (("p50", ours.p50_us, bare.p50_us), ("p99", ours.p99_us, bare.p99_us)):
        what = f"latency of a transform, {name}"
        rows.append(_beside_zenoh(what, one, other, _LATENCY_RATIO))
    for kind, publishers in ((interest.NEEDED, "one publisher"), (interest.NEEDED_OF_TWO, "two")):
        share = interest.share(measured.reading, kind)
        by_need, all_of_it = (
            measured.reading[one].cpu_percent for one in (kind, interest.EVERYTHING)
        )
        rows.append(
            _row(
                f"CPU to receive what a path over {publishers} needs",
                f"{by_need:.2f} %",
                f"to receive all: {all_of_it:.1f} %",
                f"{100.0 * share:.1f} %",
                f"at most {100.0 * _READING_SHARE:g} %",
                share <= _READING_SHARE,
            )
        )
    ours_us, bare_us = (1e6 * measured.paced_s[kind] for kind in ("ours", "bare"))
    rows.append(_beside_zenoh("CPU of a message that comes alone", ours_us, bare_us, _PACED_RATIO))
    rows.append(
        _row(
            "process start to first lookup",
            f"{start['all']:.2f} s",
            f"bare Zenoh: {bare_start['all']:.2f} s",
            goal=f"at most {_STARTUP_S:g} s",
            reached=start["all"] <= _STARTUP_S,
        )
    )
    rows.append(
        _row(
            "memory of a process then",
            f"{start['memory'] / 1e6:.0f} MB",
            f"bare Zenoh: {bare_start['memory'] / 1e6:.0f} MB",
            goal=f"at most {_MEMORY / 1e6:.0f} MB",
            reached=start["memory"] <= _MEMORY,
        )
    )
    return [*rows, *_robot_rows(measured)]


def _robot_rows(measured: Measured) -> list[list[str]]:
    ours, bare = measured.robot_state, measured.bare_relay
    what = f"joint states of {robot.JOINTS} joints until a lookup elsewhere answers"
    return [
        _row(
            f"{what}, p50",
            f"{ours.latency.p50_us:.0f} us",
            f"bare Zenoh: {bare.latency.p50_us:.0f} us",
        ),
        _row(
            f"{what}, p99",
            f"{ours.latency.p99_us:.0f} us",
            f"bare Zenoh: {bare.latency.p99_us:.0f} us",
        ),
        _row(
            "CPU of robot_state meanwhile",
            f"{ours.cpu_percent:.0f} %",
            f"bare Zenoh: {bare.cpu_percent:.0f} %",
        ),
        *(
            _row(
                f"CPU of a message of one transform {way} by the bridge",
                f"{each.ours_us:.0f} us",
                f"bare Zenoh: {each.bare_us:.0f} us",
            )
            for way, each in measured.bridged.items()
        ),
    ]


def _row(
    what: str,
    ours: str,
    beside: str = "",
    ratio: str = "",
    goal: str = "",
    reached: bool = False,
) -> list[str]:
    return [what, ours, beside, ratio, goal, ("yes" if reached else "NO") if goal else ""]


def _beside_zenoh(what: str, ours_us: float, bare_us: float, at_most: float) -> list[str]:
    return _row(
        what,
        f"{ours_us:.0f} us",
        f"bare Zenoh: {bare_us:.0f} us",
        f"{ours_us / bare_us:.2f} x",
        f"at most {at_most:g} x",
        ours_us <= at_most * bare_us,
    )


def _starts(starts: dict[str, dict[str, float]]) -> Table:
    cells = [
        [text, *(f"{1000 * start[phase]:.0f} ms" for start in starts.values())]
        for phase, text in {**PHASES, "all": "all"}.items()
    ]
    cells.append(["memory", *(f"{start['memory'] / 1e6:.0f} MB" for start in starts.values())])
    return Table(["part", *starts], cells)


def _sizes(what: str, sizes: Sequence[Size]) -> Table:
    cells = [
        [
            f"{size.size:,}",
            f"{size.intake.messages_per_s:,.0f}",
            f"{size.intake.transforms_per_s:,.0f}",
            f"{size.cpu_percent:.1f} %",
            amount(size.intake.cpu_ns),
            f"{size.met_s:.1f} s",
            f"{size.memory / 1e6:.0f} MB",
        ]
        for size in sizes
    ]
    headings = [what, "messages a second", "transforms a second", "CPU", "a transform"]
    return Table([*headings, "until all were there", "memory grown by"], cells, words=0)
