"""The bus at one moment, by a listener or by a recording at a log time; every tool takes it.

The state of a frame has one rule, by which all tools judge. The first that holds:

- *root*: it has no parent.
- *gone*: the publisher of its last sample has left the bus; the pose is the last one sent.
- *conflict*: two or more living streams list it. A frame can be gone and in conflict: its state is
  gone, and the conflict is mentioned with it.
- *static*: it holds at all times.
- *stale*: silent for longer than 1 s and than 3 of its own periods; if a single sample gives no
  rate, for longer than 3 s. None is stale shortly after a pause of this process itself.
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

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Generic, Literal, Protocol, TypeVar

from tfbus.base import structs
from tfbus.base.wording import age, duration
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.bus.graph import Graph, ServiceInfo, TopicInfo, graph_of
from tfbus.frames.clocks import is_another_time, whose_clock
from tfbus.frames.snapshot import FrameTree, Problem
from tfbus.streams.info import StreamInfo
from tfbus.wire.descriptions import NodeDescription, StreamDescription
from tfbus.wire.keys import namespace_of_node, relative_name, stream_key

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

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
    return _state(frame, faults(tree, frame))


def _state(frame: FrameInfo, found: tuple[Fault, ...]) -> State:
    if frame.parent is None:
        return "root"
    if found:
        return found[0]
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
    """Whether a dynamic frame has been silent for longer than its rate allows, and this process
    would have heard it.
    """
    silence_s = silent_s(tree, frame)
    return silence_s is not None and silence_s > stale_after_s(frame) and not tree.was_paused


def why_another_time(tree: FrameTree, frame: FrameInfo | None) -> str:
    """The note on a frame whose newest stamp is over a year away: its unit, or a question."""
    if frame is not None and (why := tree.no_stamps(frame)):
        return f"its stamps {why}: stamps are nanoseconds"
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


@dataclass(frozen=True)
class FrameStatus:
    """A frame, and how the edge to its parent comes.

    `state` is "root" (no parent), "static" or "dynamic", or the worst of its `faults`: "gone" (its
    publisher has left), "conflict" (several living publishers), "stale" (silent for longer than its
    rate allows) or "ahead" (stamped in the future). `publisher` is the stream of the last sample,
    `publishers` are all living streams that list the frame; `node` (full name) and `host` are the
    publisher's.

    In s, None for a root or static frame and while not known: `age_s` is the newest stamp's,
    `silent_s` the time since a sample came, `delay_s` how old samples are when they come. `rate_hz`
    is how often they come, by their stamps. `oldest_ns` and `newest_ns` are the stamps kept, in ns
    since the Unix epoch.
    """

    name: str
    parent: str | None
    state: State
    faults: tuple[Fault, ...]
    publisher: str
    publishers: tuple[str, ...]
    node: str
    host: str
    rate_hz: float | None
    age_s: float | None
    silent_s: float | None
    delay_s: float | None
    oldest_ns: int | None
    newest_ns: int | None


@dataclass(frozen=True, kw_only=True)
class BusMoment:
    """The bus at one moment, with the same contents whether it is live or recorded.

    `at_ns` is the moment, by the system's clock or as a log time, in ns since the Unix epoch, and
    `start_ns` the beginning of the recording, 0 of a live bus. `nodes` are the descriptions of
    nodes, `unanswered` the full names of others, which did not answer in time. `rejected` counts
    rejected transforms by reason, `dropped` messages that the listener dropped.
    """

    at_ns: int
    # As the listener in `namespace` has it; `elsewhere` are streams by their keys, also others.
    tree: FrameTree
    nodes: tuple[NodeDescription, ...] = ()
    unanswered: tuple[str, ...] = ()
    rejected: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    namespace: str = ""
    elsewhere: Mapping[str, StreamDescription] = field(default_factory=dict)
    start_ns: int = 0

    @property
    def now_ns(self) -> int:
        """The time with which stamps are compared, in ns: simulated, or the same as `at_ns`."""
        return self.tree.recorded_ns

    @cached_property
    def frames(self) -> Mapping[str, FrameStatus]:
        """All frames by name."""
        frames = self.tree.frames.items()
        return MappingProxyType({name: frame_status(self.tree, each) for name, each in frames})

    @property
    def streams(self) -> Mapping[str, StreamInfo]:
        """All streams by name: publishers, their clocks, and counts of their messages."""
        return self.tree.streams

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """The problems of the tree of frames, the worst first."""
        return tuple(self.tree.problems())

    @property
    def conflicts(self) -> frozenset[str]:
        """The frames that two or more living streams list."""
        return self.tree.conflicts

    @property
    def clocks(self) -> Mapping[str, float]:
        """How far each publisher's clock is ahead of ours, in s, by stream, if it is known."""
        return {
            name: stream.clock_offset_s
            for name, stream in self.streams.items()
            if stream.alive and stream.clock_offset_s is not None
        }

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """The topics by name, sorted, with the nodes at their ends."""
        return self._graph.topics

    @property
    def services(self) -> Mapping[str, ServiceInfo]:
        """The services and actions by name, sorted, with the nodes at their ends."""
        return self._graph.services

    @property
    def lost(self) -> int:
        """How many messages of transforms were sent and never received, or were dropped."""
        return self.dropped + sum(stream.missed for stream in self.streams.values())

    @property
    def refused(self) -> int:
        """How many transforms were rejected, and messages that could not be read."""
        unread = sum(stream.rejected for stream in self.streams.values())
        return unread + sum(self.rejected.values())

    def relative_name(self, node: str) -> str:
        """A node's name in the namespace of the moment; a node's elsewhere has its slash."""
        return relative_name(node, self.namespace)

    def since(self, before: "BusMoment") -> "BusMoment":
        """The same moment, with the counts of lost and refused transforms since an earlier one."""
        then = before.streams
        streams = {
            name: structs.replace(
                stream,
                missed=stream.missed - then[name].missed,
                rejected=stream.rejected - then[name].rejected,
            )
            if name in then
            else stream
            for name, stream in self.streams.items()
        }
        rejected = {
            reason: count - before.rejected.get(reason, 0)
            for reason, count in self.rejected.items()
            if count > before.rejected.get(reason, 0)
        }
        return replace(
            self,
            tree=replace(self.tree, streams=streams),
            rejected=rejected,
            dropped=self.dropped - before.dropped,
        )

    @property
    def node_names(self) -> frozenset[str]:
        """The full names of all nodes that are there, described or not."""
        return frozenset([*(node.name for node in self.nodes), *self.unanswered])

    def _described(self) -> dict[str, StreamDescription]:
        """The descriptions of streams by their keys: of the living ones, as far as it is known."""
        described = dict(self.elsewhere)
        for stream in self.streams.values():
            key = key_of_stream(stream.name, namespace_of_node(stream.node))
            described.pop(key, None)
            if stream.alive:
                described[key] = StreamDescription(
                    1,
                    stream.node,
                    stream.epoch_ns or 0,
                    stream.frames,
                    host=stream.host,
                    pid=stream.pid,
                )
        return described

    @cached_property
    def _graph(self) -> Graph:
        return graph_of(self.nodes, self._described(), self.namespace)


class BusView(Protocol):
    """A view of the bus that makes moments: a live listener, or a recording at a log time."""

    @property
    def buffer(self) -> Buffer:
        """The samples of the last seconds."""

    @property
    def dropped(self) -> int:
        """How many messages were dropped, since transforms came on too many keys."""

    def now_ns(self) -> int:
        """The moment, by the clock that the stamps are compared with."""

    def tree(self) -> FrameTree:
        """The tree of frames."""

    def moment(self) -> BusMoment:
        """The bus at the moment."""

    def hint(self, frame: str = "") -> str:
        """The place of a frame, or of any frame; "" if that is not known."""


class LiveView(BusView, Protocol):
    """A view of the bus now, for a command that goes on."""

    def moment(self, *, has_frames: bool = True) -> BusMoment:
        """The bus now; without frames it takes less long."""

    def watch_nodes(self) -> None:
        """Let the moments from now on have the nodes as they are then."""

    def hint_while_empty(self) -> str:
        """`hint()` for a screen that shows nothing yet."""

    def unlinked(self) -> str:
        """The router without which this process sees nobody, while there is no link to it."""

    def wait(self, timeout_s: float) -> bool:
        """Wait for this many real seconds; False if this process is to stop."""


def frame_status(tree: FrameTree, frame: FrameInfo) -> FrameStatus:
    """The status of a frame of this tree."""
    publisher, found = tree.publisher(frame), faults(tree, frame)
    return FrameStatus(
        frame.name,
        frame.parent,
        _state(frame, found),
        found,
        frame.authority,
        tree.publishers(frame),
        publisher.node,
        publisher.host,
        frame.rate_hz,
        tree.age_s(frame),
        silent_s(tree, frame),
        None if frame.static or frame.parent is None else publisher.delay_s,
        frame.oldest_ns,
        frame.newest_ns,
    )


def key_of_stream(name: str, namespace: str) -> str:
    """The key of a stream's description: of `robot7/sim`, of a node in `robot7`, that in there."""
    prefix = f"{namespace}/" if namespace else ""
    if not name.startswith(prefix):
        return stream_key(name)
    return prefix + stream_key(name.removeprefix(prefix))


class Ongoing(Generic[K, V]):
    """Items that begin and end: compares the items of one moment with the moment before's."""

    def __init__(self) -> None:
        self.items: dict[K, V] = {}

    def update(self, now: Mapping[K, V]) -> tuple[dict[K, V], dict[K, V]]:
        """The items that have begun, and the ended ones, as they were at first."""
        begun = {key: value for key, value in now.items() if key not in self.items}
        ended = {key: value for key, value in self.items.items() if key not in now}
        self.items = {key: value for key, value in self.items.items() if key in now} | begun
        return begun, ended
