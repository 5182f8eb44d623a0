"""The tree of frames at one moment, with the publishers of each edge and the problems."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from tfbus.base.clock import Clock
from tfbus.base.stamps import other_unit
from tfbus.base.wording import (
    counted,
    duration,
    is_slip,
    mistake_in,
    natural_order,
    near_names,
    printable,
    quoted,
)
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.frames.clocks import (
    MOST_SKEW_S,
    NOT_SIMULATED,
    SimulatedTime,
    is_ahead,
    is_another_time,
    is_late,
    whose_clock,
    why_no_stamp,
)
from tfbus.streams.info import StreamInfo
from tfbus.wire.fleet import shared_name

ProblemKind = Literal[
    "loop", "conflict", "gone", "disconnected", "orphan", "silent", "clock", "unit", "ahead", "late"
]

# For each child frame the parents that living streams give it, and by which stream.
Claims = Mapping[str, list[tuple[str, StreamInfo]]]

_NS_PER_S = 1e9

# A misspelt parent makes one tree; where there are more than these, something else is wrong, and
# names of thousands of frames would be compared with each root.
_MOST_MISSPELT = 3


# The remedies of problems that have none of their own; of stamps ahead or late the text says it.
REMEDIES: dict[ProblemKind, str] = {
    "loop": "swap parent and child of the edge that points the wrong way, or stop publishing it",
    "conflict": "stop one of the two, or rename one of the frames",
    "gone": "start it again, or check the link to its host if it runs",
    "disconnected": "publish a transform between the trees; look for a misspelled parent",
    "orphan": "publish a transform that connects it to the others",
    "silent": "check whether its node still sends (tfbus monitor), and its options",
    "clock": "give --sim-time to this tool, and to all nodes that look up these frames",
    "unit": "stamp them with node.now_ns(), or tfbus.stamp_ns(SECONDS)",
}


@dataclass(frozen=True)
class Problem:
    """A problem of the tree of frames: the evidence is `text`, a sentence; `remedy` the way out.

    `kind` is "loop" (edges form one), "conflict" (several living publishers), "gone" (a publisher
    is), "disconnected" and "orphan" (a tree, or a frame, apart from the largest tree), "silent"
    (announced, and never sent), "clock" (stamps of a simulated time), "unit" (stamps that are no
    nanoseconds), "ahead" (stamps in the future) or "late" (over 1 s after its stamp).
    `frames` are the frames concerned.
    """

    kind: ProblemKind
    frames: tuple[str, ...]
    text: str
    remedy: str = ""


@dataclass(frozen=True)
class FrameTree:
    """All frames and all streams by name, as they were at `recorded_ns` (ns since the Unix epoch,
    by the listener's clock, which is simulated or the system's).

    `simulated` says which publishers follow a simulated time, if the listener does not. If the
    listener's process `was_paused`, silence and delays say nothing about others.
    """

    frames: Mapping[str, FrameInfo]
    streams: Mapping[str, StreamInfo]
    recorded_ns: int
    is_simulated: bool = False
    simulated: SimulatedTime = NOT_SIMULATED
    was_paused: bool = False

    @cached_property
    def trees(self) -> list[list[tuple[int, FrameInfo]]]:
        """Whole trees as `walk` gives them: the largest first, then by the names of their roots."""
        roots = [frame.name for frame in self.frames.values() if frame.parent is None]
        trees = [list(self.walk(root)) for root in sorted(roots, key=natural_order)]
        return sorted(trees, key=len, reverse=True)

    @property
    def roots(self) -> list[FrameInfo]:
        """The frames without a parent: the root of the largest tree first, then by name."""
        return [tree[0][1] for tree in self.trees]

    def ask_if_slip(self, root: str, other: str) -> str:
        """The question whether the root of one of two trees is a slip of a frame of the other; ""
        if no name is near.
        """
        names = {tree[0][1].name: [each.name for _, each in tree] for tree in self.trees}
        for name, apart in ((root, other), (other, root)):
            likely = [each for each in names.get(apart, ()) if is_slip(name, each)]
            if near := near_names(name, likely, most=1):
                return f"did you mean {near[0]!r} by {name!r}?"
        return ""

    def below(self, frame: str) -> list[str]:
        """All frames below this one, a parent always before its children."""
        return [info.name for _, info in self.walk(frame)][1:]

    def walk(self, frame: str) -> Iterator[tuple[int, FrameInfo]]:
        """The frame and all below it with their depth, each before its children."""
        stack = [(0, frame)]  # a tree may be deeper than Python's own stack
        while stack:
            depth, name = stack.pop()
            info = self.frames[name]
            yield depth, info
            stack += [(depth + 1, child) for child in reversed(self.children(name))]

    def children(self, frame: str) -> list[str]:
        """The frames directly below this one, by name."""
        children = [child for child in self.frames[frame].children if child in self.frames]
        return sorted(children, key=natural_order) if len(children) > 1 else children

    def age_s(self, frame: FrameInfo) -> float | None:
        """How old the newest stamp of a frame is, in s; None for a static frame, or no sample."""
        if frame.static or frame.newest_ns is None:
            return None
        return (self.recorded_ns - frame.newest_ns) / _NS_PER_S

    def kept_s(self, frame: FrameInfo) -> float | None:
        """How many seconds the samples of a frame span; None for a static frame, or no sample."""
        if frame.static or frame.newest_ns is None or frame.oldest_ns is None:
            return None
        return (frame.newest_ns - frame.oldest_ns) / _NS_PER_S

    def publisher(self, frame: FrameInfo) -> StreamInfo:
        """The stream of the frame's last sample."""
        return self.streams.get(frame.authority) or StreamInfo(frame.authority)

    def publishers(self, frame: FrameInfo) -> tuple[str, ...]:
        """The living streams that list a frame, by name; without any, its last sample's."""
        if frame.name in self.conflicts:
            return tuple(sorted({stream.name for _, stream in self.claims[frame.name]}))
        if frame.name in self.claims:
            return (self.claims[frame.name][0][1].name,)
        return (frame.authority,) if frame.authority else ()

    @cached_property
    def claims(self) -> Claims:
        """For each child frame the parents that living streams give it, and by which stream."""
        claims: dict[str, list[tuple[str, StreamInfo]]] = {}
        for stream in self.streams.values():
            if stream.alive:
                for parent, child, _ in stream.frames:
                    claims.setdefault(child, []).append((parent, stream))
        return claims

    @cached_property
    def conflicts(self) -> frozenset[str]:
        """The frames that two or more living streams list."""
        return frozenset(
            child
            for child, claimed in self.claims.items()
            if len(claimed) > 1 and len({stream.name for _, stream in claimed}) > 1
        )

    def is_of_another_time(self, frame: FrameInfo) -> bool:
        """Whether the stamps of a dynamic frame are of a simulated time that we do not follow."""
        followers = self.simulated.followers
        return bool(followers) and not frame.static and self.publisher(frame).node in followers

    def is_ahead(self, frame: FrameInfo) -> bool:
        """Whether the newest stamp of a dynamic frame is in the future, by the clock that we follow
        and the publisher should.
        """
        if self.is_of_another_time(frame):
            return False
        age_s = self.age_s(frame)
        if age_s is None or age_s >= 0.0:
            return False
        return is_ahead(age_s, self.publisher(frame), is_simulated=self.is_simulated)

    def late_s(self, frame: FrameInfo) -> float | None:
        """How long after their stamps the samples of a dynamic frame come, in s, if that is late by
        the clock that we follow and the publisher should; None if not.
        """
        # Who plays a recording with its old stamps publishes its clock.
        if frame.static or self.simulated.clocks or self.was_paused:
            return None
        stream = self.publisher(frame)
        if stream.delay_s is None or stream.last_delay_s is None:
            return None
        # If this process itself was held up, the last of the waiting messages comes in time.
        delay_s = min(stream.delay_s, stream.last_delay_s)
        late = is_late(delay_s, frame.rate_hz, is_simulated=self.is_simulated)
        return delay_s if late else None

    def no_stamps(self, frame: FrameInfo) -> str:
        """Why the stamps of a dynamic frame are none, as `why_no_stamp` says it; "" if they are."""
        if frame.static or frame.newest_ns is None or self.is_of_another_time(frame):
            return ""
        return why_no_stamp(frame.newest_ns, self.recorded_ns)

    def problems(self) -> list[Problem]:
        """The problems of the tree, the worst first."""
        found = [
            *_loops(self.claims),
            *self._conflicts(),
            *self._gone(),
            *self._disconnected(),
            *self._silent(),
            *self._of_another_time(),
            *self._in_another_unit(),
            *self._ahead(),
            *self._late(),
        ]
        return [replace(each, remedy=each.remedy or REMEDIES.get(each.kind, "")) for each in found]

    def _conflicts(self) -> Iterator[Problem]:
        for child, claimed in self.claims.items():
            if child in self.conflicts:
                sides = "; ".join(f"{who(stream)} under {parent!r}" for parent, stream in claimed)
                yield Problem(
                    "conflict", (child,), f"{child!r} is published by several at once: {sides}"
                )

    def _gone(self) -> Iterator[Problem]:
        by_stream: dict[str, list[str]] = {}
        for frame in self.frames.values():
            if frame.gone:
                by_stream.setdefault(frame.authority, []).append(frame.name)
        for name, frames in by_stream.items():
            stream = self.streams.get(name) or StreamInfo(name)
            yield Problem(
                "gone",
                tuple(frames),
                f"the publisher of {quoted(frames)} is gone: {who(stream)}",
            )

    def _disconnected(self) -> Iterator[Problem]:
        main, *others = [root.name for root in self.roots] or [""]
        for at, name in enumerate(others):
            below = self.below(name)
            shared = shared_name(main, name)
            hint = remedy = ""
            if shared:
                hint = f"; if the robots share {shared!r}, pass --shared {shared}"
                remedy = (
                    f"pass --shared {shared} if {shared!r} is one frame for all robots; if each "
                    "has its own, publish a transform to each from a frame that they share"
                )
            elif at < _MOST_MISSPELT and (question := self.ask_if_slip(name, main)):
                hint = f"; {question}"
            if below:
                yield Problem(
                    "disconnected",
                    (name, *below),
                    f"{name!r} and {counted(len(below), 'frame')} below it are a separate tree: no "
                    f"transform joins {name!r} to the tree of {main!r}{hint}",
                    remedy,
                )
            else:
                text = f"{name!r} is alone: no transform joins it to another frame{hint}"
                yield Problem("orphan", (name,), text, remedy)

    def _silent(self) -> Iterator[Problem]:
        for stream in self.streams.values():
            # A frame that is only the parent of others has no place either.
            missing = [
                child
                for _, child, _ in stream.frames
                if child not in self.frames or self.frames[child].parent is None
            ]
            if stream.alive and missing:
                text = f"no transform of {quoted(missing)} has come, though {who(stream)} lists it"
                if stream.unreadable:
                    text += f"; its messages could not be read: {stream.unreadable}"
                yield Problem("silent", tuple(missing), text)

    def _of_another_time(self) -> Iterator[Problem]:
        frames = [name for name, frame in self.frames.items() if self.is_of_another_time(frame)]
        if frames:
            yield Problem(
                "clock",
                tuple(frames),
                f"{self.simulated.published}; {self.simulated.followed}, and this tool does not: "
                "ages are wrong without --sim-time",
            )

    def _in_another_unit(self) -> Iterator[Problem]:
        found: dict[tuple[str, str], list[str]] = {}
        for frame in self.frames.values():
            if why := self.no_stamps(frame):
                found.setdefault((frame.authority, why), []).append(frame.name)
        for (_, why), names in found.items():
            publisher = who(self.publisher(self.frames[names[0]]))
            yield Problem(
                "unit",
                tuple(names),
                f"the stamps of {quoted(names)} by {publisher} {why}, and stamps are nanoseconds",
            )

    def _ahead(self) -> Iterator[Problem]:
        by_stream: dict[str, list[FrameInfo]] = {}
        for frame in self.frames.values():
            if self.is_ahead(frame) and not frame.gone:
                by_stream.setdefault(frame.authority, []).append(frame)
        for frames in by_stream.values():
            names = [frame.name for frame in frames]
            least_s = min(self.age_s(frame) or 0.0 for frame in frames)
            remedy = self._on_other_stamps(frames[0], names, least_s)
            said = f"{in_the_future(names, least_s)}: {remedy}"
            yield Problem("ahead", tuple(names), said, remedy)

    def _late(self) -> Iterator[Problem]:
        by_stream: dict[str, list[FrameInfo]] = {}
        for frame in self.frames.values():
            if self.late_s(frame) is not None and not frame.gone:
                by_stream.setdefault(frame.authority, []).append(frame)
        for frames in by_stream.values():
            names = [frame.name for frame in frames]
            delay_s = self.late_s(frames[0]) or 0.0
            remedy = self._on_other_stamps(frames[0], names, delay_s)
            yield Problem("late", tuple(names), f"{come_late(names, delay_s)}: {remedy}", remedy)

    def _on_other_stamps(self, frame: FrameInfo, names: list[str], age_s: float) -> str:
        """The remedy for frames of one stream that are ahead, or late."""
        stream = self.publisher(frame)
        if is_another_time(age_s):
            return f"{who(stream)}: {whose_clock(is_simulated=self.is_simulated)}"
        skew_s = (stream.clock_offset_s or 0.0) * (1 if age_s < 0.0 else -1)
        if not self.is_simulated and skew_s > MOST_SKEW_S:
            return synchronize(stream)
        return stamp_when_measured(stream, names)


def frame_tree(
    buffer: Buffer,
    streams: Iterable[StreamInfo],
    recorded_ns: int,
    simulated: SimulatedTime = NOT_SIMULATED,
    *,
    was_paused: bool = False,
) -> FrameTree:
    """The knowledge of the buffer and its listener at the time `recorded_ns`, by the listener's
    clock.

    A frame without parent and children is in it only if a living stream lists it. All texts come as
    they can be printed: streams, nodes and hosts are named by strangers.
    """
    is_simulated = isinstance(buffer.clock, Clock) and buffer.clock.is_simulated
    by_name = {stream.name: stream for stream in map(_printable_stream, streams)}
    listed = {
        name for each in by_name.values() if each.alive for row in each.frames for name in row[:2]
    }
    frames = {
        frame.name: _shown(frame, recorded_ns)
        for frame in buffer.all_frames()
        # A parent outlives its last child in the buffer, of which a listener that comes later, or
        # a recording, knows nothing.
        if frame.parent is not None or frame.children or frame.name in listed
    }
    known = NOT_SIMULATED if is_simulated else simulated
    return FrameTree(frames, by_name, recorded_ns, is_simulated, known, was_paused)


def _shown(frame: FrameInfo, now_ns: int) -> FrameInfo:
    # A buffer takes no frame whose name cannot be printed.
    authority = printable(frame.authority)
    if frame.rate_hz is not None and other_unit(frame.newest_ns or 0, now_ns):
        return replace(frame, authority=authority, rate_hz=None)  # a billion Hz
    return frame if authority == frame.authority else replace(frame, authority=authority)


def _printable_stream(stream: StreamInfo) -> StreamInfo:
    shown = replace(
        stream,
        name=printable(stream.name),
        node=printable(stream.node),
        host=printable(stream.host),
        session=printable(stream.session),
    )
    if any(mistake_in(name) for row in stream.frames for name in row[:2]):
        frames = tuple(row for row in stream.frames if not any(map(mistake_in, row[:2])))
        return replace(shown, frames=frames)
    return shown


def who(stream: StreamInfo) -> str:
    """A publisher as people look for it: its node, host and pid; a bridge's streams have another
    publisher, in ROS.
    """
    if not stream.node:
        return f"stream {stream.name!r}"
    if stream.origin:
        return f"{_in_ros(stream)} (brought by {_node(stream)})"
    return _node(stream)


def why_unreadable(stream: StreamInfo) -> str:
    """`the description of stream 'arm' could not be read: ...`, for one that has the reason."""
    what = counted(stream.rejected, "message") if stream.rejected else "the description"
    return f"{what} of stream {stream.name!r} could not be read: {stream.unreadable}"


def in_the_future(names: list[str], age_s: float) -> str:
    """`samples of 'arm' are 5 min in the future`, for an age below zero."""
    return f"samples of {quoted(names)} are {duration(-age_s)} in the future"


def come_late(names: list[str], delay_s: float) -> str:
    """`samples of 'arm' come 5.0 s after their stamps, so ...`."""
    return (
        f"samples of {quoted(names)} come {duration(delay_s)} after their stamps, so no lookup at "
        "the present time finds one"
    )


def stamp_when_measured(stream: StreamInfo, names: list[str]) -> str:
    """The remedy if a publisher stamps frames with another time."""
    were = "they were" if len(names) > 1 else "it was"
    return (
        f"have {who(stream)} stamp {quoted(names)} with the time at which {were} measured: "
        "node.now_ns()"
    )


def synchronize(stream: StreamInfo) -> str:
    """The remedy if the clock of a publisher's host differs from ours."""
    return f"synchronize the clocks of {stream.host} and this host by NTP"


def _in_ros(stream: StreamInfo) -> str:
    """The node in ROS of a stream `ros2/NODE` of the bridge `ros2`."""
    bridge = stream.node.rpartition("/")[2]
    _, _, node = f"/{stream.name}".partition(f"/{bridge}/")
    return f"ROS's node /{node}" if node else "a node of ROS"


def _node(stream: StreamInfo) -> str:
    if not stream.host:
        return stream.node  # it did not describe itself, as in a recording of ROS
    return f"{stream.node} on {stream.host}, pid {stream.pid}"


def _loops(claims: Claims) -> Iterator[Problem]:
    """The loops that the edges of living streams would close; a buffer refuses such an edge."""
    done: set[str] = set()
    for start in claims:
        path: dict[str, None] = {}
        stack = [(start, 0)]
        while stack:
            child, depth = stack.pop()
            while len(path) > depth:
                path.popitem()
            if child in path:
                names = list(path)
                loop = names[names.index(child) :]
                sides = {who(stream): None for frame in loop for _, stream in claims[frame]}
                yield Problem(
                    "loop",
                    tuple(loop),
                    f"{' -> '.join(repr(frame) for frame in [*loop, child][::-1])} is a loop, "
                    f"made by {' and '.join(sides)}: one of them has parent and child swapped",
                )
            elif child not in done:
                path[child] = None
                stack += [(parent, depth + 1) for parent, _ in claims.get(child, ())]
            done.add(child)
