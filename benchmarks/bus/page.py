"""The part of docs/reference/performance.md that is about the bus, written by the benchmark."""

from collections.abc import Sequence

from benchmarks.bus import interest, paced, robot, startup
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
_READING_SHARE = 0.02
_PACED_RATIO = 1.15
_STARTUP_S = 0.15
_MEMORY = 40e6

_PART = """\
{mark}

## The bus

`make bench ARGS="--only bus"` measured this part, between processes on loopback. {place}
Where that load is not far below one, other processes used the cores: then times by the clock (a
second, the start, the percentiles) say little, and CPU says more.

| measure | result | goal | reached |
| --- | ---: | ---: | ---: |
{rows}

- **From the bus**: one process sends messages made in advance, except for their stamps, as fast as
  the link takes them; another has a `TransformListener` and a buffer of 0.1 s. At this rate those
  are thousands of samples an edge, as many as the usual ten seconds hold of a frame that is sent
  some hundred times a second. A buffer of 1 s would hold tens of thousands, 150 MB of them, and
  took a third more CPU, for the pages of memory that it grew into. CPU is of all threads of that
  process, Zenoh's included, over the transforms that it received; *a second, a core* follows from
  that CPU.
- **tf2_ros**: `tf2_ros.TransformListener` of Debian's packages under rospy, with messages of the
  same 50 transforms at 200 Hz and a buffer of 1 s, which is 200 samples an edge, its CPU measured
  the same way; it is C++ below, but rospy's messages are made in Python.{ros}
- **Latency** is from before `send_transform` until a lookup in the other process has answered with
  that transform, 1,000 sends a second. The lookup runs in the thread that delivers it, as soon as
  it is in the buffer: from then on any lookup answers, and no thread has to be woken to find out.
  Bare Zenoh is two more processes without tfbus: from before `put` until a callback on Zenoh's own
  thread, its fastest, holds the payload, of the same size and priority. The two pairs take turns of
  {turn} messages, since the first of a turn waits for a core that did something else, and longer
  turns did not share the busy moments of the machine; {count:,} of each came.
- **By interest**: two hundred publishers send 100,000 transforms a second in all; one process
  receives everything, another what the lookups of one path need, which it makes twice a second.
  Both include what an idle session takes. [What it saves](../guide/interest.md#what-it-saves) says
  more.
- **Joint states**: a driver publishes the positions of {joints} joints 1,000 times a second, `tfbus
  robot_state` makes transforms of them, and a third process looks the whole chain up. On bare Zenoh
  a process in the middle sends another message for each that comes, of the same sizes.
- **The bridge to ROS**: the process of `tfbus ros2 --via zenoh`, with as many messages of one
  transform as its links carry. The relay in Python puts the payload of each message that comes.
- **A message that comes alone**: {paced_rate:,} a second at an even pace, each of one transform,
  into a listener; and the same messages into a callback in Python on bare Zenoh's own thread. Most
  of it is to wake threads and to hand over Python's lock, which is Zenoh's share.
- **The first lookup** of a process counts from the start of the process, at a given endpoint;
  memory is what the process holds then. Bare Zenoh beside it is a process that imports nothing
  else, until its callback has the first message.

The parts of the start:

{startup}

### Where the latency goes

Measured by hand in November 2026, part by part, between two processes that rest for a millisecond
between the messages; so these numbers are not those of the table. Of 147 us, 115 were Zenoh's. The
steps before the put take 7 (the lock, the names, the bytes of the message), from Zenoh's callback
to the buffer 8, the insert 3, the lookup 1, and a callback that gets its key 6. The same code takes
a seventh of these times in a loop: after a millisecond the caches are cold. So work that can wait
runs after the put (the history for late joiners) and after the insert (counts, delays), and a
transform that is sent alone has code of its own. A stream that keeps no history takes 7 us more in
Zenoh: a queryable at its key lets both ends name the key by a number.

In the slowest hundredth the path from the put to the callback takes 80 to 160 us more than usual,
as bare Zenoh's does (90 to 110), and tfbus's own parts together 50 more: the longer the code, the
likelier is a tick of the system's clock or another process on the core. That is why the 99th
percentile is farther from Zenoh's than the median.

Of the CPU of a message of 50 (13 us when it was profiled in November 2026; the table has less now)
a third was the insertion of the rows, a fifth Python, a sixth Zenoh, a sixth the system, and the
rest copies of memory.

### How the bus grows

![The CPU of a listener, by publishers and by frames](performance-bus.svg)

A listener that is sent {rate:,} transforms a second in all, as far as the publishers keep up: first
from more and more streams of one frame, a transform to a message; then of more and more frames of
one stream, at most 1,000 to a message, so that sending 100,000 once takes 10 s. A message that
comes alone costs more than one of many: most of it is to wake threads.

{publishers}

{frames}

[Scaling](../guide/scaling.md) says what follows for processes, hosts and routers.

### Over an hour

![Memory, open files and threads of the listeners over time](soak.svg)

Three listeners for fifty minutes, in which publishers and the router were killed every few seconds:
[the numbers](soak.md).
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
        paced_rate=paced.RATE,
        joints=robot.JOINTS,
        startup=_starts(measured.starts),
        rate=RATE,
        publishers=_sizes("publishers", measured.publishers),
        frames=_sizes("frames", measured.frames),
    )


def _rows(measured: Measured) -> list[tuple[str, str, str, str]]:
    single, fifty = measured.single, measured.fifty
    start, bare_start = measured.starts["at a given endpoint"], measured.starts[startup.BARE]
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
    for kind, publishers in ((interest.NEEDED, "one publisher"), (interest.NEEDED_OF_TWO, "two")):
        share = interest.share(measured.reading, kind)
        by_need, all_of_it = (
            measured.reading[one].cpu_percent for one in (kind, interest.EVERYTHING)
        )
        rows.append(
            _row(
                f"CPU to receive what a path over {publishers} needs, over that to receive all",
                f"{by_need:.2f} % / {all_of_it:.1f} % = {100.0 * share:.1f} %",
                f"at most {100.0 * _READING_SHARE:g} %",
                share <= _READING_SHARE,
            )
        )
    ours_s, bare_s = (measured.paced_s[kind] for kind in ("ours", "bare"))
    what = "CPU of a message that comes alone, over that of bare Zenoh"
    taken = f"{1e6 * ours_s:.0f} us / {1e6 * bare_s:.0f} us = {ours_s / bare_s:.2f} x"
    goal = f"at most {_PACED_RATIO:g} x"
    rows.append(_row(what, taken, goal, ours_s <= _PACED_RATIO * bare_s))
    what = "process start to first lookup (bare Zenoh: to its first message)"
    taken = f"{start['all']:.2f} s ({bare_start['all']:.2f} s)"
    rows.append(_row(what, taken, f"at most {_STARTUP_S:g} s", start["all"] <= _STARTUP_S))
    what = "memory of a process then"
    taken = f"{start['memory'] / 1e6:.0f} MB ({bare_start['memory'] / 1e6:.0f} MB)"
    goal = f"at most {_MEMORY / 1e6:.0f} MB"
    rows.append(_row(what, taken, goal, start["memory"] <= _MEMORY))
    return [*rows, *_robot_rows(measured)]


def _robot_rows(measured: Measured) -> list[tuple[str, str, str, str]]:
    ours, bare = measured.robot_state, measured.bare_relay
    what = f"joint states of {robot.JOINTS} joints until a lookup elsewhere answers (bare Zenoh)"
    return [
        (f"{what}, p50", f"{ours.latency.p50_us:.0f} us ({bare.latency.p50_us:.0f} us)", "", ""),
        (f"{what}, p99", f"{ours.latency.p99_us:.0f} us ({bare.latency.p99_us:.0f} us)", "", ""),
        (
            "CPU of robot_state meanwhile (of a relay on bare Zenoh)",
            f"{ours.cpu_percent:.0f} % ({bare.cpu_percent:.0f} %)",
            "",
            "",
        ),
        *(
            (
                f"CPU of a message of one transform {way}, by the bridge (a relay on bare Zenoh)",
                f"{each.ours_us:.0f} us ({each.bare_us:.0f} us)",
                "",
                "",
            )
            for way, each in measured.bridged.items()
        ),
    ]


def _row(what: str, taken: str, at_least: str, reached: bool) -> tuple[str, str, str, str]:
    return what, taken, at_least, "yes" if reached else "NO"


def _starts(starts: dict[str, dict[str, float]]) -> str:
    cells = [
        [text, *(f"{1000 * start[phase]:.0f} ms" for start in starts.values())]
        for phase, text in {**PHASES, "all": "all"}.items()
    ]
    cells.append(["memory", *(f"{start['memory'] / 1e6:.0f} MB" for start in starts.values())])
    return markdown_table(["part", *starts], cells, words=1)


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
