"""docs/reference/performance-tables.md: how each number was measured, and further ones."""

from benchmarks.parts import Part, Table, kept

_PAGE = """\
# How it was measured

[How fast tfbus is](performance.md) has the results; `benchmarks/measured` has every row, with the
machine, its load and all versions. If the load is not far below one, other processes used the
cores, and CPU and ratios say more than times.

{0}

{1}

{2}

{3}

{4}

{5}

{6}
"""

_BUFFER = """\
## The buffer beside its peers

By `make bench`. All have the same chains of frames: 100 Hz, 1,000 samples an edge, poses that
swing, stamps of today. A lookup goes from end to end and interpolates on every edge, at stamps
scattered over the last tenth of a second unless the row says 10 s. Each peer is a warmed-up
process; those of a row take turns, and a number is the median of their runs.

- tf2 from C++ has its strings made in advance. transform-tree has one writer an edge, refuses
  samples out of order, and has a plan for its latest compiled in advance.
- schiebung's latest is the newest of each edge, which need not be of one time.
- pytransform3d takes whole series, so it has no insert; it interpolates along screws.
- Inserts take messages or arrays made in advance, 5,000 at a time; of tf2 and transform-tree 50
  edges are 50 calls.
- Memory is the growth of the process, with a million samples over 100 edges.
{left_out}
"""

_BUS = """\
## The bus

By `make bench ARGS="--only bus"`, between processes on loopback.

{shown}

- **From the bus**: one process sends messages made in advance as fast as the link takes them;
  another has a `TransformListener` and a buffer of 0.1 s. CPU is of all its threads, Zenoh's too.
- **tf2_ros** is Debian's under rospy, with messages of the same 50 transforms at 200 Hz.{tf2_ros}
- **Latency** is from before `send_transform` until a lookup in the other process has answered
  with that transform, in the thread that delivers it, at 1,000 sends a second; of bare Zenoh from
  `put` until a callback has a payload of the same size and priority. The pairs take turns of
  {turn} messages; {count} of each came.
- **By interest**: 200 publishers send 100,000 transforms a second; one process receives all,
  another the path that it looks up twice a second. Both include an idle session.
- **Joint states**: {joints} positions 1,000 times a second, of which `tfbus robot_state` makes
  transforms; a third process looks the whole chain up.
- **The bridge**: `tfbus ros2 --via zenoh`; beside it a relay in Python.
"""

_VIEW = """\
## The view

By `python -m benchmarks.view --write`. Each message has all frames, and browsers draw nothing.
CPU is of all threads of the view. Pictures a second are those that a Chromium draws of the page,
1280 by 800{pictures}.
"""

# How the pictures came about.
_PICTURES = {
    "SwiftShader": ", without a graphics card,\non the cores of the view and the publisher",
    "": "; they were not counted",
}

_RECORDINGS = """\
## Recordings

By `make bench ARGS="--only recordings"`, one message a tick. Numbers are CPU of a process that
did the same before; medians of runs that take turns.

- **Write**: tfbus makes CDR of columns; mcap has the bytes made in advance; rosbags serialises
  its own messages.
- **Read**: all make one array of stamps and one of poses of the same file; rosbags and
  mcap-ros2-support make objects in Python of each message.
- **A lookup** goes over five edges, at stamps in no order, and reads the 2 s around its stamp.
  tf2's way is to play everything into a buffer, measured with tfbus's own reader and buffer.
- **CPU to record** is of all threads of `tfbus bag record`, over {robot_s} s, from one publisher
  or from ten with five frames each.
- **Without loss**: one publisher sends for {flood_s} s, twice as fast each time, until a message
  is missing in the file in each of three tries.
- **Late** is a message of `tfbus bag play`, 1,000 a second for {play_s} s, from when it is due
  until Zenoh hands it over in another process; in brackets a loop in Python on bare Zenoh.
"""

_ROBOTS = """\
## Robots

By `python -m benchmarks.robots --write`: CPU, medians of {runs} runs that take turns, of made-up
robots: an arm with {arm}, a humanoid with {humanoid}, two of three revolute and one fixed. Angles
are a map by joint (yourdfpy: an array). Of 10,000 configurations the peers, which have no such
call, do {looped} in a loop.
"""

_RESOURCES = """\
## A small machine

By `python -m benchmarks.resources --write`: **CPU** in percent of one core and **wake-ups**
(voluntary context switches of all threads) a second, over {seconds} s; **memory** that the
process has for itself alone (USS); **start** until it is ready, CPU in brackets. The view has no
browser open. 32 of the threads are Zenoh's [that
receive](../internals/zenoh.md#zenoh-receives-with-32-threads), and sleep.
"""

_LARGE = """\
## Large messages

By `python -m benchmarks.bus.large --write`, as root for the links; peers take turns, up to 60 MB a
second. Latency is from before the message is made until the callback has it. rclpy is that with
Fast DDS from wheels, foxglove-sdk's client reads only the time, and rerun's server tells none.
{left_out}
"""

_PARTS = {
    "buffer": _BUFFER,
    "bus": _BUS,
    "large": _LARGE,
    "view": _VIEW,
    "recordings": _RECORDINGS,
    "robots": _ROBOTS,
    "resources": _RESOURCES,
}


# Measures of the bus that are not on the first page.
_SHOWN = (
    "single-transform messages into the buffer",
    "transforms, 50 to a message, a core",
    "CPU to receive what a path over one publisher needs",
    "CPU of a message that comes alone",
    "process start to first lookup",
    "memory of a process then",
    "joint states of 30 joints until a lookup elsewhere answers, p50",
    "CPU of a message of one transform to ROS by the bridge",
    "CPU of a message of one transform from ROS by the bridge",
)


def made() -> str:
    """The whole page."""
    return _PAGE.format(*(_part(kept(name), text) for name, text in _PARTS.items()))


def _part(part: Part, text: str) -> str:
    facts = dict(part.facts)
    if "pictures" in facts:
        facts["pictures"] = _PICTURES[facts["pictures"]]
    facts.setdefault("left_out", "")
    if facts["left_out"]:
        facts["left_out"] = f"\nLeft out: {facts['left_out']}\n"
    if "measures" in part.tables:
        facts["shown"] = _shown(part.tables["measures"]).as_markdown()
    return text.format(**facts).rstrip()


def _shown(table: Table) -> Table:
    """The measures that the page shows, without goals."""
    headings = [name for name in table.headings if name not in ("goal", "reached")]
    rows = [[table.row(name)[heading] for heading in headings] for name in _SHOWN]
    return Table(headings, rows, table.words)
