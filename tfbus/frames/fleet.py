"""A fleet at a glance: the robots of a moment of the bus, one value each, and the roster of the
robots that are expected.
"""

from collections import Counter, deque
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from tfbus.base.wording import duration, listed, natural_order
from tfbus.buffer.info import FrameInfo
from tfbus.frames.moment import BusMoment, faults
from tfbus.frames.snapshot import FrameTree, Problem
from tfbus.streams.info import MOST_GONE, StreamInfo
from tfbus.wire.keys import namespace_of_node, relative

RobotState = Literal["gone", "missing", "there"]

# Worst first: a robot that was there and is lost, one that never came, then robots with problems.
_RANKS: dict[RobotState, int] = {"gone": 0, "missing": 1, "there": 2}

# Zenoh, TCP, IP and Ethernet add this to a message that comes alone, as benchmarks.bus.air counts
# it, and to each further packet of it the headers.
_AROUND_MESSAGE, _HEADERS, _PACKET = 95, 66, 1448

# Rates are over this time.
_RECENT_S = 5.0

# Trees apart from the others are a trouble only in a robot that has several, as each robot has its
# own map unless they share one.
_APART = ("disconnected", "orphan")


@dataclass(frozen=True)
class RobotStatus:
    """A robot of a fleet, by the namespace of its nodes relative to the listener's.

    `state` is "there", "gone" (its nodes and streams left, at `gone_ns`) or "missing" (of the
    roster, and never seen). `is_expected` is False for a robot outside of the roster. `age_s` is
    the age of its newest dynamic sample, `clock_offset_s` how far the clock that is farthest off is
    ahead of ours; `messages_hz` are the messages of transforms received from it, and `bytes_per_s`
    an estimate of their bytes on the air: the payloads, and the network's headers of each. All
    are None while not known. `versions` of tfbus are in its nodes. `problems` concern its
    frames, `stale` counts frames that are silent. `twice` are the hosts on which nodes of the
    same name run at once, as when a robot and its substitute are both on.
    """

    name: str
    state: RobotState
    is_expected: bool = True
    gone_ns: int | None = None
    age_s: float | None = None
    clock_offset_s: float | None = None
    messages_hz: float | None = None
    bytes_per_s: float | None = None
    versions: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()
    frames: int = 0
    stale: int = 0
    problems: tuple[Problem, ...] = ()
    twice: tuple[str, ...] = ()

    @property
    def is_well(self) -> bool:
        """Whether it is there, without any problem."""
        return self.state == "there" and not (self.problems or self.stale or self.twice)

    @property
    def trouble(self) -> str:
        """The kinds of its problems, each with how often it is: `gone, 2 stale`; "" for none."""
        if self.state != "there":
            return ""
        count = Counter(each.kind for each in self.problems)
        words = [kind if times == 1 else f"{times} {kind}" for kind, times in count.items()]
        words += [f"{self.stale} stale"] if self.stale else []
        words += [f"twice, on {listed(self.twice, most=2)}"] if self.twice else []
        return ", ".join(words if self.is_expected else [*words, "not expected"])

    def state_text(self, at_ns: int) -> str:
        """Its state at a moment, with how long it has been gone: `gone 3 min`."""
        if self.gone_ns is None:
            return self.state
        return f"gone {duration(max(at_ns - self.gone_ns, 0) / 1e9)}"

    @property
    def _rank(self) -> tuple[int, bool, object]:
        return _RANKS[self.state], self.is_well, natural_order(self.name)


def worst_first(robots: Iterable[RobotStatus]) -> list[RobotStatus]:
    """The robots that are gone, the missing, the ones with problems, then the others; each kind in
    the natural order of names.
    """
    return sorted(robots, key=lambda robot: robot._rank)


@dataclass
class _Frames:
    """The frames of a robot: how many there are and are stale, the newest's age, and problems."""

    count: int = 0
    stale: int = 0
    age_s: float | None = None
    problems: list[Problem] = field(default_factory=list)

    def add(self, tree: FrameTree, frame: FrameInfo) -> None:
        """Count one more."""
        self.count += 1
        self.stale += faults(tree, frame) == ("stale",)
        age_s = tree.age_s(frame)
        if age_s is not None and (self.age_s is None or abs(age_s) < abs(self.age_s)):
            self.age_s = age_s


@dataclass
class _Parts:
    """The parts of a robot at a moment."""

    nodes: list[str] = field(default_factory=list)
    streams: list[StreamInfo] = field(default_factory=list)
    frames: _Frames = field(default_factory=_Frames)


@dataclass
class _Seen:
    """A robot that was seen: its versions, and its frames at the last look.

    `gone_ns` is None while it is there, and if since when it is gone is not known.
    """

    is_there: bool = False
    gone_ns: int | None = None
    versions: tuple[str, ...] = ()
    frames: _Frames = field(default_factory=_Frames)


class FleetWatch:
    """The robots from moment to moment: it remembers which there were, and when they left; of
    robots outside of the roster the last thousand that are gone.

    `roster` are the names of the robots that are expected, () for any. With `shares_frames` each
    robot's frames should be joined to the frames that robots share.
    """

    def __init__(self, roster: Iterable[str] = (), *, shares_frames: bool = False) -> None:
        self._roster = dict.fromkeys(roster)
        self._shares_frames = shares_frames
        self._seen: dict[str, _Seen] = {}
        # How many messages and bytes had come of each living stream, at the last moments; and since
        # which moment it has gone on without a pause.
        self._counted: deque[tuple[int, Mapping[str, tuple[int, int]]]] = deque()
        self._since_ns: dict[str, int] = {}

    def robots(self, moment: BusMoment, *, has_frames: bool = True) -> list[RobotStatus]:
        """The robots at a moment, worst first. One before the last moment begins again, as of a
        recording that is played once more. If the moment is one without frames, the last seen
        frames count, and ages are by the streams.
        """
        if self._counted and moment.at_ns < self._counted[-1][0]:
            self._seen.clear()
            self._counted.clear()
            self._since_ns.clear()
        parts = self._parts(moment, has_frames)
        loads = self._loads(moment, parts)
        statuses = [
            self._status(name, parts.get(name) or _Parts(), loads.get(name), moment)
            for name in {*self._roster, *parts}
        ]
        if not has_frames:
            statuses = [
                replace(each, age_s=_age_s(parts.get(each.name) or _Parts(), moment))
                for each in statuses
            ]
        self._forget()
        return worst_first(statuses)

    def _forget(self) -> None:
        """Make room: forget robots outside of the roster that have been gone for longest."""
        gone = [
            (seen.gone_ns or 0, name)
            for name, seen in self._seen.items()
            if not seen.is_there and name not in self._roster
        ]
        for _, name in sorted(gone)[: max(len(gone) - MOST_GONE, 0)]:
            del self._seen[name]

    def _parts(self, moment: BusMoment, has_frames: bool) -> dict[str, _Parts]:
        nodes = {name: _below(namespace_of_node(name), moment) for name in moment.node_names}
        streams = {name: _of_stream(each, moment) for name, each in moment.streams.items()}
        namespaces = {*nodes.values(), *streams.values(), *self._roster, *self._seen}
        robots = _robots(namespaces, self._roster)
        parts = {name: _Parts() for name in {*robots.values()} - self._roster.keys()}
        parts |= {name: _Parts() for name in self._seen}
        for name, namespace in nodes.items():
            if namespace:
                parts.setdefault(robots[namespace], _Parts()).nodes.append(name)
        for name, namespace in streams.items():
            if namespace:
                parts.setdefault(robots[namespace], _Parts()).streams.append(moment.streams[name])
        if has_frames:
            self._judge(
                moment, {name: robots[each] for name, each in streams.items() if each}, parts
            )
        else:
            for name in parts.keys() & self._seen.keys():
                parts[name].frames = self._seen[name].frames
        return parts

    def _judge(
        self, moment: BusMoment, of_stream: Mapping[str, str], parts: Mapping[str, _Parts]
    ) -> None:
        """Look at all frames, and at their problems."""
        for frame in moment.tree.frames.values():
            robot = of_stream.get(frame.authority)
            if robot is not None:
                parts[robot].frames.add(moment.tree, frame)
        for problem in self._problems(moment.tree, moment.problems, parts):
            for name in _concerned(problem, moment.tree, of_stream, parts):
                parts[name].frames.problems.append(problem)

    def _problems(
        self, tree: FrameTree, problems: Iterable[Problem], parts: Mapping[str, _Parts]
    ) -> Iterator[Problem]:
        roots: dict[str, int] = {}
        for root in tree.roots:
            name = _prefix(root.name, parts)
            roots[name] = roots.get(name, 0) + 1
        for problem in problems:
            is_own = not self._shares_frames and roots.get(_prefix(problem.frames[0], parts)) == 1
            if problem.kind not in _APART or not is_own:
                yield problem

    def _loads(
        self, moment: BusMoment, parts: Mapping[str, _Parts]
    ) -> dict[str, tuple[float, float]]:
        """Messages and bytes per second of each robot, since some moments ago; of a stream that
        was not there all the time, since it is.
        """
        now = {
            name: (each.messages, each.bytes) for name, each in moment.streams.items() if each.alive
        }
        if self._counted and self._counted[-1][0] == moment.at_ns:
            self._counted.pop()  # a moment looked at again, as of a clock that stands still
        self._counted.append((moment.at_ns, now))
        while len(self._counted) > 2 and moment.at_ns - self._counted[1][0] >= _RECENT_S * 1e9:
            self._counted.popleft()
        last = self._counted[-2][1] if len(self._counted) > 1 else {}
        self._since_ns = {
            name: self._since_ns.get(name, moment.at_ns)
            if name in last and last[name][0] <= count[0]
            else moment.at_ns
            for name, count in now.items()
        }
        loads = {}
        for robot, part in parts.items():
            rates = [self._load(each.name) for each in part.streams if each.name in now]
            known = [rate for rate in rates if rate is not None]
            if known:
                loads[robot] = sum(each[0] for each in known), sum(each[1] for each in known)
        return loads

    def _load(self, stream: str) -> tuple[float, float] | None:
        """Messages and bytes on the air per second of a stream; None if it came just now."""
        now_ns, now = self._counted[-1]
        since_ns = self._since_ns[stream]
        then_ns, then = next(each for each in self._counted if each[0] >= since_ns)
        over_s = (now_ns - then_ns) / 1e9
        if over_s <= 0.0:
            return None
        messages, size = (new - old for new, old in zip(now[stream], then[stream], strict=True))
        size += _AROUND_MESSAGE * messages + _HEADERS * size // _PACKET
        return messages / over_s, size / over_s

    def _status(
        self, name: str, parts: _Parts, load: tuple[float, float] | None, moment: BusMoment
    ) -> RobotStatus:
        is_expected = not self._roster or name in self._roster
        is_there = bool(parts.nodes) or any(stream.alive for stream in parts.streams)
        if not is_there and name not in self._seen and not parts.streams:
            return RobotStatus(name, "missing", is_expected)
        seen = self._seen.setdefault(name, _Seen())
        seen.frames = parts.frames
        if is_there:
            seen.is_there, seen.gone_ns = True, None
            in_parts = set(parts.nodes)
            versions = {each.version for each in moment.nodes if each.name in in_parts}
            # A node that came just now has not been asked yet.
            seen.versions = tuple(sorted(versions)) or seen.versions
        elif seen.gone_ns is None:
            heard = [each.last_heard_ns for each in parts.streams if each.last_heard_ns]
            # The listener may have known of it for longer than this watch.
            seen.gone_ns = moment.at_ns if seen.is_there else max(heard, default=None)
            seen.is_there = False
        offsets = [
            each.clock_offset_s
            for each in parts.streams
            if each.alive and each.clock_offset_s is not None
        ]
        messages_hz, bytes_per_s = load if load and is_there else (None, None)
        return RobotStatus(
            name,
            "there" if is_there else "gone",
            is_expected,
            seen.gone_ns,
            parts.frames.age_s,
            max(offsets, key=abs, default=None),
            messages_hz,
            bytes_per_s,
            seen.versions,
            tuple(sorted(parts.nodes, key=natural_order)),
            parts.frames.count,
            parts.frames.stale,
            tuple(parts.frames.problems),
            _twice(parts, moment),
        )


def _twice(parts: _Parts, moment: BusMoment) -> tuple[str, ...]:
    """The hosts of the nodes of a robot that run more than once."""
    names = set(parts.nodes)
    nodes = [each for each in moment.nodes if each.name in names]
    count = Counter(each.name for each in nodes)
    hosts = {each.host for each in nodes if count[each.name] > 1}
    return tuple(sorted(hosts, key=natural_order))


def _age_s(parts: _Parts, moment: BusMoment) -> float | None:
    """The age of a robot's newest sample, by when the last message of its streams came."""
    ages = [
        (moment.at_ns - stream.last_heard_ns) / 1e9 + stream.last_delay_s
        for stream in parts.streams
        if stream.last_heard_ns is not None and stream.last_delay_s is not None
    ]
    return min(ages, key=abs, default=None)


def _below(namespace: str, moment: BusMoment) -> str:
    """A namespace relative to the listener's; "" if it is not below that."""
    below = relative(f"/{namespace}", moment.namespace)
    return "" if below.startswith("/") else below


def _of_stream(stream: StreamInfo, moment: BusMoment) -> str:
    if stream.node:
        return _below(namespace_of_node(stream.node), moment)
    return stream.name.rpartition("/")[0]


def _robots(namespaces: set[str], roster: Container[str]) -> dict[str, str]:
    """The robot of each namespace: `robot7` of `robot7/arm` too, if that has nodes of its own, or
    is expected, and the arm is not.
    """
    robots: dict[str, str] = {}
    for namespace in sorted(namespaces - {""}, key=len):
        above = "" if namespace in roster else namespace
        while above := above.rpartition("/")[0]:
            if above in robots:
                break
        robots[namespace] = robots[above] if above else namespace
    return robots


def _prefix(frame: str, parts: Mapping[str, _Parts]) -> str:
    """The robot of a frame by its name in the fleet; "" for a shared frame."""
    while frame := frame.rpartition("/")[0]:
        if frame in parts:
            break
    return frame


def _concerned(
    problem: Problem, tree: FrameTree, of_stream: Mapping[str, str], parts: Mapping[str, _Parts]
) -> set[str]:
    """The robots that a problem concerns: the publishers of its frames, or else the robot whose
    namespace is in their names.
    """
    found: set[str] = set()
    for name in problem.frames:
        frame = tree.frames.get(name)
        publishers = (
            tree.publishers(frame)
            if frame is not None
            else [stream.name for _, stream in tree.claims.get(name, ())]
        )
        robots = {of_stream[each] for each in publishers if each in of_stream}
        found |= robots or {_prefix(name, parts)}
    return found & parts.keys()
