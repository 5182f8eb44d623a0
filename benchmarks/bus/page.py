"""The part of docs/performance.md that is about the bus, written by the benchmark."""

from collections.abc import Sequence

from benchmarks.bus.growth import RATE, Size
from benchmarks.bus.latency import TURN
from benchmarks.bus.measure import Measured
from benchmarks.bus.startup import PHASES
from benchmarks.report import amount, markdown_table

MARK = "<!-- the bus -->"

_SINGLE_PER_S = 150_000
_CPU_NS = 1e9 / 3_000_000
_CPU_RATIO = 15.0
_LATENCY_RATIO = 1.2
_STARTUP_S = 0.5

_PART = """\
{mark}

## The bus

`make bench ARGS="--only bus"` measured this part, between processes on loopback. {place}
Where that load is not far below one, others took their share of the cores: then what is by the
clock says little (a second, the start, the percentiles), and CPU says more.

| measure | taken | at least | reached |
| --- | ---: | ---: | ---: |
{rows}

- **Off the bus**: one process sends messages that are made before, but for their stamps, as many as
  the link bears; another has a `TransformListener` and a buffer of one second. CPU is of all
  threads of that process, Zenoh's included, over the transforms that it received. A second a core
  is what that CPU comes to.
- **tf2_ros**: `tf2_ros.TransformListener` of Debian's packages under rospy, with messages of the
  same 50 transforms at 200 Hz, its CPU taken likewise; it is C++ below, but rospy's messages are
  made in Python.{ros}
- **Latency** is from before `send_transform` until a lookup in the other process has answered with
  that transform, 1,000 sends a second; bare Zenoh is `put` to callback of the same size in the same
  two sessions. The two take turns of {turn} messages; {count:,} of each came.
- **The first lookup** of a process is counted from the moment that it was started.

What the start is made of:

{startup}

### How the bus grows

![The CPU of a listener, by publishers and by frames](performance-bus.svg)

A listener that receives {rate:,} transforms a second in all, from ever more streams of one frame, a
transform to a message; and of ever more frames of one stream, a thousand to a message at most, so
that 100,000 take ten seconds to be sent once. A message that comes alone costs more than one of
many: most of it is the waking of threads.

{publishers}

{frames}
"""


def part(measured: Measured, place: str) -> str:
    """The part of the page."""
    return _PART.format(
        mark=MARK,
        place=place,
        rows="\n".join(f"| {' | '.join(row)} |" for row in _rows(measured)),
        ros=f" Not measured: {measured.theirs}." if isinstance(measured.theirs, str) else "",
        turn=TURN,
        count=min(measured.ours.count, measured.bare.count),
        startup=_starts(measured.starts),
        rate=RATE,
        publishers=_sizes("publishers", measured.publishers),
        frames=_sizes("frames", measured.frames),
    )


def _rows(measured: Measured) -> list[tuple[str, str, str, str]]:
    single, fifty = measured.single, measured.fifty
    slowest_s = max(start["all"] for start in measured.starts.values())
    rows = [
        _row(
            "single-transform messages into the buffer",
            f"{single.messages_per_s:,.0f} a second",
            f"{_SINGLE_PER_S:,} a second",
            single.messages_per_s >= _SINGLE_PER_S,
        ),
        ("CPU of one of them", amount(single.cpu_ns), "", ""),
        _row(
            "transforms, 50 to a message, a core",
            f"{1e9 / fifty.cpu_ns:,.0f} a second",
            f"{1e9 / _CPU_NS:,.0f} a second",
            fifty.cpu_ns <= _CPU_NS,
        ),
        ("the same by the clock", f"{fifty.transforms_per_s:,.0f} a second", "", ""),
    ]
    if not isinstance(measured.theirs, str):
        ratio = measured.theirs.cpu_ns / fifty.cpu_ns
        taken = f"{amount(measured.theirs.cpu_ns)} / {amount(fifty.cpu_ns)} = {ratio:.1f} x"
        what = "or: CPU of a transform, the tf2_ros listener over ours"
        rows.append(_row(what, taken, f"{_CPU_RATIO:g} x", ratio >= _CPU_RATIO))
    ours, bare = measured.ours, measured.bare
    for name, one, other in (("p50", ours.p50_us, bare.p50_us), ("p99", ours.p99_us, bare.p99_us)):
        what = f"latency over that of bare Zenoh, {name}"
        taken = f"{one:.0f} us / {other:.0f} us = {one / other:.2f} x"
        rows.append(
            _row(what, taken, f"at most {_LATENCY_RATIO:g} x", one <= _LATENCY_RATIO * other)
        )
    what, taken = "process start to first lookup", f"{slowest_s:.2f} s"
    rows.append(_row(what, taken, f"at most {_STARTUP_S:g} s", slowest_s <= _STARTUP_S))
    return rows


def _row(what: str, taken: str, at_least: str, reached: bool) -> tuple[str, str, str, str]:
    return what, taken, at_least, "yes" if reached else "NO"


def _starts(starts: dict[str, dict[str, float]]) -> str:
    cells = [
        [text, *(f"{1000 * start[phase]:.0f} ms" for start in starts.values())]
        for phase, text in {**PHASES, "all": "all"}.items()
    ]
    return markdown_table(["of it", *starts], cells, words=1)


def _sizes(what: str, sizes: Sequence[Size]) -> str:
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
    return markdown_table([*headings, "until all were there", "memory grown by"], cells)
