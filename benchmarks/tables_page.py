"""docs/reference/performance-tables.md: all that was measured, and how."""

from benchmarks.parts import Part, kept

_PAGE = """\
# All measurements

{0}

{1}

{2}

{3}

{4}

{5}
"""

_BUFFER = """\
[How fast tfbus is](performance.md) says it in short. Each part names the machine and its load;
where that load is not far below one, other processes used the cores: then times by the clock say
little, and CPU and ratios say more.

## The buffer beside its peers

`make bench` measured this part. {place}

{versions}

The ratio is what the peer takes over what tfbus takes: above one, tfbus is faster (or smaller). *At
least* is our goal.

{peers}

All have the same chains of frames: 100 Hz, 1,000 samples an edge, poses that swing, stamps of
today. Lookups go from end to end of a chain and interpolate on every edge, at stamps scattered over
the last tenth of a second, as in most robots, unless the row says 10 s. Each peer is a process of
its own, warmed up; those in one group of rows take turns, so that a busy moment of the machine hits
all, and a number is the median of their runs. All numbers of Python include the loop in Python.

- tf2 from C++ is called from C++, with strings made in advance; all others from Python.
- transform-tree has a fixed topology, one writer an edge, and refuses samples out of order; its
  plan is compiled in advance and needs no names; its latest is by plan, too. It and pytransform3d
  answer with matrices, all others with a translation and a quaternion.
- schiebung's latest is the newest of each edge, which need not be of one time.
- pytransform3d takes whole series, so it has no insert; it interpolates along screws.
- Inserts are timed with messages, transforms or arrays made in advance, 5,000 transforms at a time,
  so that they are in the processor's caches like what has just arrived. The names in columns are
  the same texts each time. transform-tree has columns of one edge only, so 50 edges are 50 calls,
  as with tf2.
- Many stamps in one call are the same ones from call to call, as many calls as fill 50 ms.
- Beside inserts: another thread of the same process inserts 2,000 batches of 50 a second; the peer
  is tfbus alone.
- Memory is the growth of the process, with a million samples over 100 edges.
- The interpreted kernel is the same source without a C compiler.
{left_out}
`python -m benchmarks.instructions "lookup 3"` counts instructions under valgrind instead, which a
busy machine does not change.

One lookup along a chain:

{deep}

One lookup between any two frames:

{frames}

One lookup at any time of one edge:

{samples}
"""

_BUS = """\
## The bus

`make bench ARGS="--only bus"` measured this part, between processes on loopback. {place}

{measures}

- **From the bus**: one process sends messages made in advance, except for their stamps, as fast as
  the link takes them; another has a `TransformListener` and a buffer of 0.1 s: at this rate those
  are thousands of samples an edge, as many as the usual ten seconds hold of a frame that is sent
  some hundred times a second. CPU is of all threads of that process, Zenoh's included, over the
  transforms that it received; *a second, a core* follows from that CPU.
- **tf2_ros**: `tf2_ros.TransformListener` of Debian's packages under rospy, with messages of the
  same 50 transforms at 200 Hz and a buffer of 1 s, which is 200 samples an edge, its CPU measured
  the same way; it is C++ below, but rospy's messages are made in Python.{tf2_ros}
- **Latency** is from before `send_transform` until a lookup in the other process has answered with
  that transform, 1,000 sends a second. The lookup runs in the thread that delivers it, as soon as
  it is in the buffer: from then on any lookup answers, and no thread has to be woken to find out.
  Bare Zenoh is two more processes without tfbus: from before `put` until a callback on Zenoh's own
  thread, its fastest, holds the payload, of the same size and priority. The two pairs take turns of
  {turn} messages, since the first of a turn waits for a core that did something else; {count} of
  each came. Here the ratio is ours over bare Zenoh's.
- **By interest**: two hundred publishers send 100,000 transforms a second in all; one process
  receives everything, another what the lookups of one path need, which it makes twice a second.
  Both include what an idle session takes. [What it saves](../guide/interest.md#what-it-saves) says
  more.
- **Joint states**: a driver publishes the positions of {joints} joints 1,000 times a second, `tfbus
  robot_state` makes transforms of them, and a third process looks the whole chain up. On bare Zenoh
  a process in the middle sends another message for each that comes, of the same sizes.
- **The bridge to ROS**: the process of `tfbus ros2 --via zenoh`, with as many messages of one
  transform as its links carry. The relay in Python puts the payload of each message that comes.
- **A message that comes alone**: {paced_rate} a second at an even pace, each of one transform, into
  a listener; and the same messages into a callback in Python on bare Zenoh's own thread. Most of it
  is to wake threads and to hand over Python's lock.
- **The first lookup** of a process counts from the start of the process, at a given endpoint;
  memory is what the process holds then. Bare Zenoh beside it is a process that imports nothing
  else, until its callback has the first message.

The parts of the start:

{starts}

A listener that is sent {rate} transforms a second in all, as far as the publishers keep up: first
from more and more streams of one frame, a transform to a message; then of more and more frames of
one stream, at most 1,000 to a message, so that sending 100,000 once takes 10 s.

{publishers}

{frames}
"""

_VIEW = """\
## The view

`python -m benchmarks.view --write` measured this part. {place}

{versions}

{costs}

- All frames move at 30 Hz, each message has all of them, and `tfbus view` sends at most 30 updates
  a second. A core is one second of processor time a second, of all threads of the view's process.
  While no page is open it receives the frames, and checks them once a second.
- These browsers receive and draw nothing, to leave the processor to the view. Fewer than 30
  messages a second mean that the view could not keep up or, under a load far above one, that other
  processes had the cores.
- Pictures a second are those that a Chromium draws of the page, 1280 by 800{pictures}.
"""

# How the pictures came about.
_PICTURES = {
    "SwiftShader": """. This machine has no
  graphics card: SwiftShader draws them on the cores that the view and the publisher use too, so
  they are few. They do not measure a browser with a graphics card""",
    "": "; they were not counted",
}

_RECORDINGS = """\
## Recordings

`make bench ARGS="--only recordings"` measured this part. {place}

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

{live}

- **CPU to record** is that of `tfbus bag record`, of all its threads, over {robot_s} s of the
  robot: from one publisher, and from ten with five frames each, which are ten times the messages.
- **Without loss**: one publisher sends for {flood_s} s, twice as fast each time, until a message is
  missing in the file in each of three tries, or until it is too slow itself: it is one process in
  Python on the same cores, which drops what Zenoh does not take at once. The table below has each
  rate that it reached.
- **Late** is a message of `tfbus bag play`, 1,000 a second for {play_s} s: from the time at which
  it is due until Zenoh hands it over in another process. Beside it a loop in Python that sleeps
  until the next message is due, and puts it on bare Zenoh: what the machine allowed.

{floods}
"""

_ROBOTS = """\
## Robots

`python -m benchmarks.robots --write` measured this part. {place}

{versions}

{peers}

- Numbers are CPU, medians of {runs} runs that take turns. The ratio is what the peer takes over
  what tfbus takes.
- The robots are made up: an arm with {arm} and a humanoid with {humanoid}, two of three joints
  revolute and one fixed, all origins turned.
- **Where all links are** in the root, from a map of angles by joint (yourdfpy: an array). tfbus
  answers with a `Transform` a link, the others with a matrix (4, 4).
- **10,000 configurations**: `Robot.fk_many` of tfbus; the others have no such call, so that theirs
  is a loop, of which {looped} turns are measured.
"""

_RESOURCES = """\
## A small machine

`python -m benchmarks.resources --write` measured this part. {place}

{processes}

- **CPU** in percent of one core, and **wake-ups** (voluntary context switches of all threads) a
  second, over {seconds} s. **Memory** is what the process has for itself alone (USS). **Start** is
  from the start of the process until it is ready, CPU in brackets.
- With frames, a publisher sends {frames} frames at {rate} Hz in messages of all. The view has no
  browser open.
- 32 of the threads are Zenoh's that receive: tfbus asks for that number, since one of them waits
  for 10 s where a host that is linked is unplugged. They are there from the first link on, and
  sleep. `ZENOH_RUNTIME` overrides it.
- numpy is loaded only when arrays are asked for, and a command imports only what it needs.
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
        versions="\n".join(f"- {who}: {what}" for who, what in part.versions.items()),
        **{name: table.as_markdown() for name, table in part.tables.items()},
        **facts,
    ).rstrip()
