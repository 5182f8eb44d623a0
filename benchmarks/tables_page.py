"""docs/reference/performance-tables.md: how each number was measured, and further ones."""

from benchmarks.parts import Part, Table, kept

_PAGE = """\
# How it was measured

How [the results](performance.md) came about; `benchmarks/measured` has every row. If the load is
not far below one, other processes used the cores, and CPU and ratios say more than times.

{0}

{1}

{2}

{3}

{4}

{5}
"""

_BUFFER = """\
## The buffer beside its peers

By `make bench`, on the machine and with the versions named [there](performance.md).

All have the same chains of frames: 100 Hz, 1,000 samples an edge. A lookup interpolates on every
edge of a chain, at stamps in the last tenth of a second unless the row says 10 s. Peers are
warmed-up processes that take turns; a number is the median of their runs.

- tf2 from C++ has its strings made in advance. transform-tree has one writer an edge, and refuses
  samples out of order; its latest is by a plan compiled in advance.
- schiebung's latest is the newest of each edge, which need not be of one time.
- pytransform3d takes whole series, so it has no insert; it interpolates along screws.
- Inserts take messages or arrays made in advance; of 50 edges, tf2 and transform-tree take 50
  calls.
- Memory is the growth of the process, with a million samples over 100 edges.
{left_out}
"""

_BUS = """\
## The bus

By `make bench ARGS="--only bus"`, between processes on loopback. {place}

{measures}

- **From the bus**: messages made in advance, as fast as the link takes them, into a buffer of 0.1
  s. CPU is of all threads, Zenoh's too.
- **tf2_ros** is Debian's `tf2_ros.TransformListener` under rospy, with messages of the same 50
  transforms at 200 Hz.{tf2_ros}
- **Latency** is from before `send_transform` until a lookup elsewhere has answered with that
  transform, at 1,000 sends a second. Bare Zenoh: from `put` until a callback has the payload, of
  the same size and priority. The pairs take turns of {turn} messages; {count} of each came.
- **By interest**: 200 publishers send 100,000 transforms a second; one process receives all,
  another the path that it looks up twice a second.
- **Joint states**: {joints} positions 1,000 times a second, by `tfbus robot_state` to a process
  that looks the chain up; on bare Zenoh a message of the same size.
- **The bridge**: `tfbus ros2 --via zenoh`; beside it a relay in Python.
- **A message that comes alone**: {paced_rate} a second of one transform each, at an even pace.
- **The first lookup** counts from the start of the process.
"""

_VIEW = """\
## The view

By `python -m benchmarks.view --write`. {place} {versions}.

- All frames move at 30 Hz in one message, and browsers draw nothing. CPU is of all threads of the
  view.
- Pictures a second are those that a Chromium draws of the page, 1280 by 800{pictures}.
"""

# How the pictures came about.
_PICTURES = {
    "SwiftShader": ", without a\n  graphics card, on the cores of the view and the publisher",
    "": "; they were not counted",
}

_RECORDINGS = """\
## Recordings

By `make bench ARGS="--only recordings"`. {place} {versions}.

A robot of 50 frames at 50 Hz, one message a tick: 3,000 messages in a minute, {hour} in an hour.
Numbers are CPU of a process that did the same before; medians of runs that take turns.

- **Write**: tfbus makes CDR of columns; mcap has the bytes made in advance; rosbags serialises its
  own messages.
- **Read**: all make arrays of stamps and poses of the same file; rosbags and mcap-ros2-support by
  objects.
- **A lookup** goes over five edges, at stamps in no order, and reads the 2 s around its stamp.
  tf2's way is to play everything into a buffer, measured with tfbus's own reader and buffer.

{live}

- **CPU to record** is of all threads of `tfbus bag record`, over {robot_s} s, from one publisher or
  from ten with five frames each.
- **Without loss**: one publisher sends for {flood_s} s, twice as fast each time, until a message is
  missing in the file in each of three tries.
- **Late** is a message of `tfbus bag play`, 1,000 a second for {play_s} s, from when it is due
  until Zenoh hands it over in another process; in brackets a loop in Python on bare Zenoh.
"""

_ROBOTS = """\
## Robots

By `python -m benchmarks.robots --write`. {place} {versions}.

CPU, medians of {runs} runs that take turns, of made-up robots: an arm with {arm}, a humanoid with
{humanoid}, two of three revolute and one fixed. Angles are a map by joint (yourdfpy: an array). Of
10,000 configurations the peers, which have no such call, do {looped} in a loop.
"""

_RESOURCES = """\
## A small machine

By `python -m benchmarks.resources --write`. {place}

[The results](performance.md#a-small-machine): **CPU** in percent of one core and **wake-ups**
(voluntary context switches of all threads) a second, over {seconds} s; **memory** that the process
has for itself alone (USS); **start** until it is ready, CPU in brackets. With frames, a publisher
sends {frames} frames at {rate} Hz. The view has no browser open. 32 of the threads are Zenoh's
[that receive](../internals/zenoh.md#zenoh-receives-with-32-threads), and sleep.
"""

_PARTS = {
    "buffer": _BUFFER,
    "bus": _BUS,
    "view": _VIEW,
    "recordings": _RECORDINGS,
    "robots": _ROBOTS,
    "resources": _RESOURCES,
}


def made() -> str:
    """The whole page."""
    return _PAGE.format(*(_part(kept(name), text) for name, text in _PARTS.items()))


def _part(part: Part, text: str) -> str:
    facts = dict(part.facts)
    if "pictures" in facts:
        facts["pictures"] = _PICTURES[facts["pictures"]]
    if facts.get("left_out"):
        facts["left_out"] = f"\nLeft out: {facts['left_out']}\n"
    return text.format(
        place=part.place,
        versions=", ".join(f"{who}: {what}" for who, what in part.versions.items()),
        **{name: _compact(table).as_markdown() for name, table in part.tables.items()},
        **facts,
    ).rstrip()


def _compact(table: Table) -> Table:
    """A row of each measure with all peers, where there is a row of each peer; without goals."""
    if table.headings[:4] != ["measure", "peer", "peer takes", "tfbus takes"]:
        shown = [i for i, name in enumerate(table.headings) if name not in ("goal", "reached")]
        headings, *rows = ([row[i] for i in shown] for row in (table.headings, *table.rows))
        return Table(headings, rows, table.words)
    rows: dict[str, dict[str, str]] = {}
    for measure, peer, theirs, ours, *_ in table.rows:
        name, by_plan, _ = measure.partition(" (its plan)")
        who = f"{peer}, its plan" if by_plan else "tfbus alone" if peer == "tfbus" else peer
        rows.setdefault(name, {"tfbus": ours})[who] = theirs
    peers = dict.fromkeys(who for row in rows.values() for who in row if who not in ("", "a limit"))
    return Table(
        ["", *peers], [[name, *(row.get(who, "") for who in peers)] for name, row in rows.items()]
    )
