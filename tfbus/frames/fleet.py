"""A fleet at a glance: the robots of a moment of the bus, one value each, and the roster of those
that are expected.
"""

import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from tfbus.errors import InvalidArgumentException, InvalidNameError
from tfbus.frames.moment import BusMoment, FrameStatus
from tfbus.frames.snapshot import FrameTree, Problem
from tfbus.listen.info import StreamInfo
from tfbus.wire.keys import check_namespace, namespace_of_node, relative
from tfbus.wording import duration, natural_order, printable

RobotState = Literal["gone", "missing", "there"]

# Worst first: a robot that was there and is lost, one that never came, then those with problems.
_RANKS: dict[RobotState, int] = {"gone": 0, "missing": 1, "there": 2}

# A longer roster is a mistake in its range.
_MOST_ROBOTS = 10_000

# Rates are those of this time.
_RECENT_S = 5.0

# Trees apart from the others are a trouble only in a robot that has several, as each robot has its
# own map unless they share one.
_APART = ("disconnected", "orphan")

_RANGES = re.compile(r"\[([^\[\]]*)\]")


@dataclass(frozen=True)
class RobotStatus:
    """A robot of a fleet, by the namespace of its nodes relative to the listener's.

    `state` is "there", "gone" (its nodes and streams left, at `gone_ns`) or "missing" (of the
    roster, and never seen). `is_expected` is False for a robot outside of the roster. `age_s` is
    the age of its newest dynamic sample, `clock_offset_s` how far the clock that is farthest off is
    ahead of ours; `messages_hz` and `bytes_per_s` are the transforms received from it, by their
    payloads. All are None while not known. `versions` are those of tfbus in its nodes. `problems`
    are those of its frames, `stale` counts frames that are silent.
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

    @property
    def is_well(self) -> bool:
        """Whether it is there, without any problem."""
        return self.state == "there" and not self.problems and not self.stale

    @property
    def trouble(self) -> str:
        """The kinds of its problems, each with how often it is: `gone, 2 stale`; "" for none."""
        if self.state != "there":
            return ""
        count = Counter(each.kind for each in self.problems)
        words = [kind if times == 1 else f"{times} {kind}" for kind, times in count.items()]
        words += [f"{self.stale} stale"] if self.stale else []
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
    """The robots that are gone, then the missing, those with problems and the others; each kind in
    the natural order of names.
    """
    return sorted(robots, key=lambda robot: robot._rank)


def roster_of(names: Iterable[str]) -> tuple[str, ...]:
    """The names of robots, in natural order: `robot[1-3]` are robot1, robot2 and robot3; `[a,c]`
    lists, `[01-10]` keeps its zeros.

    Raises InvalidArgumentException for a range that is none, a name that cannot be a namespace, and
    more than 10,000 robots.
    """
    found: set[str] = set()
    for name in names:
        for each in _expanded(name):
            try:
                found.add(check_namespace(each))
            except InvalidNameError as error:
                raise InvalidArgumentException(f"robot {printable(each, 60)!r}: {error}") from error
            if len(found) > _MOST_ROBOTS:
                raise InvalidArgumentException(f"at most {_MOST_ROBOTS:,} robots may be expected")
    found.discard("")
    return tuple(sorted(found, key=natural_order))


def _expanded(name: str) -> Iterator[str]:
    """The names of a pattern: of its first range, then of the others."""
    ranges = _RANGES.search(name)
    if ranges is None:
        yield name
        return
    before, after = name[: ranges.start()], name[ranges.end() :]
    for part in ranges[1].split(","):
        for each in _parts(part.strip(), name):
            yield from _expanded(f"{before}{each}{after}")


def _parts(part: str, name: str) -> Iterator[str]:
    bounds = re.fullmatch(r"([0-9]{1,9})-([0-9]{1,9})", part)
    if bounds is None:
        if not part or "-" in part:
            raise InvalidArgumentException(
                f"{printable(name, 60)!r} is no range of robots: write robot[1-30], or robot[1,4,7]"
            )
        yield part
        return
    first, last = int(bounds[1]), int(bounds[2])
    if not first <= last < first + _MOST_ROBOTS:
        raise InvalidArgumentException(
            f"{printable(name, 60)!r}: a range goes up, by at most {_MOST_ROBOTS:,} robots"
        )
    digits = len(bounds[1]) if bounds[1].startswith("0") else 0
    for number in range(first, last + 1):
        yield f"{number:0{digits}}"


@dataclass
class _Parts:
    """The parts of a robot at a moment."""

    nodes: list[str] = field(default_factory=list)
    streams: list[StreamInfo] = field(default_factory=list)
    frames: list[FrameStatus] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


class FleetWatch:
    """The robots from moment to moment: it remembers which there were, and when they left.

    `roster` are the names of the robots that are expected, () for any. With `shares_frames` each
    robot's frames should be joined to the frames that robots share.
    """

    def __init__(self, roster: Iterable[str] = (), *, shares_frames: bool = False) -> None:
        self._roster = tuple(roster)
        self._shares_frames = shares_frames
        self._gone_ns: dict[str, int | None] = {}  # of all robots seen so far
        self._versions: dict[str, tuple[str, ...]] = {}
        self._counted: deque[tuple[int, Mapping[str, tuple[int, int]]]] = deque()

    def robots(self, moment: BusMoment) -> list[RobotStatus]:
        """The robots at a moment, worst first. One before the last moment begins again, as of a
        recording that is played once more.
        """
        if self._counted and moment.at_ns < self._counted[-1][0]:
            for memory in (self._counted, self._gone_ns, self._versions):
                memory.clear()
        parts = self._parts(moment)
        loads = self._loads(moment, parts)
        known = {*self._roster, *parts, *self._gone_ns}
        return worst_first(
            self._status(name, parts.get(name) or _Parts(), loads.get(name), moment)
            for name in known
        )

    def _parts(self, moment: BusMoment) -> dict[str, _Parts]:
        nodes = {name: _below(namespace_of_node(name), moment) for name in moment.node_names}
        streams = {name: _of_stream(each, moment) for name, each in moment.streams.items()}
        robots = _robots({*nodes.values(), *streams.values(), *self._roster, *self._gone_ns})
        parts = {name: _Parts() for name in {*robots.values()} - {*self._roster, *self._gone_ns}}
        parts |= {name: _Parts() for name in self._gone_ns}
        for name, namespace in nodes.items():
            if namespace:
                parts.setdefault(robots[namespace], _Parts()).nodes.append(name)
        for name, namespace in streams.items():
            if namespace:
                parts.setdefault(robots[namespace], _Parts()).streams.append(moment.streams[name])
        of_stream = {name: robots[each] for name, each in streams.items() if each}
        for frame in moment.frames.values():
            if frame.publisher in of_stream:
                parts[of_stream[frame.publisher]].frames.append(frame)
        for problem in self._problems(moment.tree, moment.problems, parts):
            for name in _concerned(problem, moment.tree, of_stream, parts):
                parts[name].problems.append(problem)
        return parts

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
        """Messages and bytes per second of each robot, since some moments ago."""
        now = {
            name: (each.messages, each.bytes) for name, each in moment.streams.items() if each.alive
        }
        self._counted.append((moment.at_ns, now))
        while len(self._counted) > 2 and moment.at_ns - self._counted[1][0] >= _RECENT_S * 1e9:
            self._counted.popleft()
        then_ns, then = self._counted[0]
        over_s = (moment.at_ns - then_ns) / 1e9
        if over_s <= 0.0:
            return {}
        loads = {}
        for robot, part in parts.items():
            messages = size = 0
            for stream in part.streams:
                if stream.name in now:
                    before = then.get(stream.name, (0, 0))
                    messages += max(stream.messages - before[0], 0)
                    size += max(stream.bytes - before[1], 0)
            loads[robot] = messages / over_s, size / over_s
        return loads

    def _status(
        self, name: str, parts: _Parts, load: tuple[float, float] | None, moment: BusMoment
    ) -> RobotStatus:
        is_expected = not self._roster or name in self._roster
        is_there = bool(parts.nodes) or any(stream.alive for stream in parts.streams)
        if is_there:
            self._gone_ns[name] = None
            in_parts = set(parts.nodes)
            versions = {each.version for each in moment.nodes if each.name in in_parts}
            # A node that came just now has not been asked yet.
            self._versions[name] = tuple(sorted(versions)) or self._versions.get(name, ())
        elif name not in self._gone_ns and not parts.streams:
            return RobotStatus(name, "missing", is_expected)
        elif self._gone_ns.get(name) is None:
            heard = [each.last_heard_ns for each in parts.streams if each.last_heard_ns]
            # The listener may have known of it for longer than this watch.
            seen_before = name in self._gone_ns
            self._gone_ns[name] = moment.at_ns if seen_before else max(heard, default=None)
        ages = [each.age_s for each in parts.frames if each.age_s is not None]
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
            None if is_there else self._gone_ns[name],
            min(ages, key=abs, default=None),
            max(offsets, key=abs, default=None),
            messages_hz,
            bytes_per_s,
            self._versions.get(name, ()),
            tuple(sorted(parts.nodes, key=natural_order)),
            len(parts.frames),
            sum(each.state == "stale" for each in parts.frames),
            tuple(parts.problems),
        )


def _below(namespace: str, moment: BusMoment) -> str:
    """A namespace relative to the listener's; "" if it is not below that."""
    below = relative(f"/{namespace}", moment.namespace)
    return "" if below.startswith("/") else below


def _of_stream(stream: StreamInfo, moment: BusMoment) -> str:
    if stream.node:
        return _below(namespace_of_node(stream.node), moment)
    return stream.name.rpartition("/")[0]


def _robots(namespaces: set[str]) -> dict[str, str]:
    """The robot of each namespace: `robot7` of `robot7/arm` too, if that has nodes of its own, or
    is expected.
    """
    robots: dict[str, str] = {}
    for namespace in sorted(namespaces - {""}, key=len):
        above = namespace
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
    """The robots that a problem concerns: those that publish its frames, or have their names."""
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
