"""The state of a frame, by one rule, and what a line says about it.

`tfbus frames`, `monitor`, `top`, `doctor` and `view` all judge by it. The first that holds:

- *root*: it has no parent.
- *gone*: the publisher of its last sample has left the bus; the pose is the last one sent.
- *conflict*: two or more living streams list it. A frame can be gone and in conflict: its state is
  gone, and the conflict is mentioned with it.
- *static*: it holds at all times.
- *stale*: silent for longer than 1 s and than 3 of its own periods; if a single sample gives no
  rate, for longer than 3 s.
- *ahead*: its newest stamp is in the future, by the rule of `clocks`.
- *dynamic*: its samples come.

Silence is the time since a sample arrived: the age of the newest stamp, less the delay of the
stream's last message. A skewed clock, or a replay with old stamps, changes both alike, so that a
frame whose samples keep coming is not stale. Before a live message gives the delay, the measured
offset of the publisher's clock takes its place, except under simulated time, which is no system's;
if that cannot be, as with stamps that are 5 min old, silence counts from when the messages came
that the publisher had kept. All come with every snapshot of the streams. Arrivals noted frame by
frame would be known to long-running tools only: to `tfbus frames`, which listens for a second, a
frame that stopped long ago arrives with the history just now. The price: the delay is that of a
whole stream, and a frame whose stamps lag behind the others of its stream counts as silent for the
difference.
"""

from typing import Literal

from tfbus.buffer.info import FrameInfo
from tfbus.frames.clocks import is_another_time, whose_clock
from tfbus.frames.snapshot import FrameTree
from tfbus.wording import age, duration

Fault = Literal["gone", "conflict", "stale", "ahead"]
State = Literal["root", "static", "dynamic"] | Fault

_STALE_PERIODS = 3.0
_STALE_S = 1.0
_STALE_WITHOUT_RATE_S = 3.0

# A publisher keeps messages for 10 s, unless its options say otherwise. With some room: where the
# stamps say that kept messages are older, or not sent yet, it is not known when they were sent.
_MOST_KEPT_S, _LEAST_KEPT_S = 11.0, 1.0


def state(tree: FrameTree, frame: FrameInfo) -> State:
    """The state of a frame."""
    if frame.parent is None:
        return "root"
    for fault in faults(tree, frame):
        return fault
    return "static" if frame.static else "dynamic"


def faults(tree: FrameTree, frame: FrameInfo) -> tuple[Fault, ...]:
    """The problems of a frame, the worst first: ("gone", "conflict") if it is both."""
    if frame.parent is None:
        return ()
    found: tuple[Fault, ...] = ("gone",) if frame.gone else ()
    if frame.name in tree.conflicts:
        found = (*found, "conflict")
    if found:
        return found
    if is_stale(tree, frame):
        return ("stale",)
    return ("ahead",) if tree.is_ahead(frame) else ()


def silent_s(tree: FrameTree, frame: FrameInfo) -> float | None:
    """For how long no sample of a frame has come, in s; None for a static frame, or no sample."""
    age_s = tree.age_s(frame)
    if age_s is None:
        return None
    stream = tree.publisher(frame)
    if stream.last_delay_s is not None:
        return age_s - stream.last_delay_s
    silence_s = age_s
    if not tree.is_simulated and stream.clock_offset_s is not None:
        # A clock ahead of ours makes a sample look younger than it is.
        silence_s += stream.clock_offset_s
    if stream.kept_delay_s is None:
        return silence_s
    since_kept_s = age_s - stream.kept_delay_s
    before_s = silence_s - since_kept_s
    return silence_s if -_LEAST_KEPT_S < before_s < _MOST_KEPT_S else since_kept_s


def stale_after_s(frame: FrameInfo) -> float:
    """For how long a frame may be silent before it is stale, in s."""
    if not frame.rate_hz:
        return _STALE_WITHOUT_RATE_S
    return max(_STALE_S, _STALE_PERIODS / frame.rate_hz)


def is_stale(tree: FrameTree, frame: FrameInfo) -> bool:
    """Whether a dynamic frame has been silent for longer than its rate allows."""
    silence_s = silent_s(tree, frame)
    return silence_s is not None and silence_s > stale_after_s(frame)


def why_another_time(tree: FrameTree, frame: FrameInfo | None) -> str:
    """The note on a frame whose newest stamp is over a year away: its unit, or a question."""
    if frame is not None and (unit := tree.unit_of(frame)):
        return f"its stamps look like {unit}: stamps are nanoseconds"
    return whose_clock(is_simulated=tree.is_simulated)


def facts(tree: FrameTree, frame: FrameInfo) -> list[str]:
    """The notes on an edge, the most important first; nothing for a root."""
    if frame.parent is None:
        return []
    words = [fault.upper() for fault in faults(tree, frame)]
    if frame.static:
        words.append("static")
    else:
        age_s = tree.age_s(frame)
        words.append(age(age_s))
        if tree.is_of_another_time(frame):
            words.append("its time is simulated: use --sim-time")
        elif is_another_time(age_s):
            words.append(why_another_time(tree, frame))
        if frame.rate_hz is not None:
            words.append(f"{frame.rate_hz:.1f} Hz over {duration(tree.kept_s(frame))}")
    words.append(f"by {frame.authority}")
    return words
