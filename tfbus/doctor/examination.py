"""The evidence that the checks judge, from a bus or a recording; their findings; and all checks."""

import socket
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from tfbus.base.addresses import Interface
from tfbus.base.wording import printable
from tfbus.bus.settings import NodeSettings
from tfbus.frames.fleet import FleetWatch, RobotStatus
from tfbus.frames.meter import EpochSpan, SpanMeter, measure
from tfbus.frames.moment import BusMoment, Ongoing
from tfbus.frames.recorded import RecordedFrames, Tick
from tfbus.frames.report import Edge, EdgeFlow, EdgeSamples, StreamFlow
from tfbus.frames.snapshot import FrameTree, Problem, ProblemKind
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.fleet import Fleet


@dataclass(frozen=True)
class Participant:
    """A participant of DDS, about one a process: its id, the name of its DDS, and whether it is of
    ROS 2.
    """

    id: bytes
    vendor: str
    is_ros: bool


@dataclass(frozen=True)
class RosAround:
    """The ROS that is seen from this host.

    `nodes` are the full names of the nodes that rmw_zenoh has, by domain; `at` is the endpoint
    through which they are seen, "" if it is rmw_zenoh's usual one. `bridges` is the number of
    zenoh-bridge-ros2dds. `participants` of DDS are in `domain`, to which it listened for
    `listened_s` seconds; `is_dds_here` is whether one is on this host. `domain` is -1 if
    ROS_DOMAIN_ID is none. `distro` is the ROS that is sourced. `master_nodes` is the number of
    nodes of ROS 1 at `master`, None if that does not answer.
    """

    nodes: Mapping[int, frozenset[str]] = field(default_factory=dict)
    at: str = ""
    bridges: int = 0
    domain: int = 0
    participants: tuple[Participant, ...] = ()
    is_dds_here: bool = False
    listened_s: float = 0.0
    distro: str = ""
    is_ros1: bool = False
    master: str = ""
    master_nodes: int | None = None


@dataclass(frozen=True)
class ExaminedHost:
    """This host: its packages, its interfaces, and the result of a trial of scouting.

    `versions` are of Python and of packages, "" if one is not installed. `scouted` is whether
    scouting found a session of our own, None if scouting is off. `unreachable` are endpoints to
    connect to that do not answer, with the reason. `routers` counts the connected routers.
    `listens_beyond` are the endpoints that other hosts can reach. `without_datagrams` is why frames
    wait for lost packets on a network on which an open bus's do not, "" if they do not.
    `why_interpreted` is why the compiler failed, if it did. `scouts` are other processes of this
    host that take part in scouting, by their pids, and `stopped` the pids of scouts that do not
    run, by SIGSTOP or in a debugger. `name` is its name in the descriptions of its nodes.
    """

    versions: Mapping[str, str]
    is_compiled: bool
    interfaces: tuple[Interface, ...]
    scouted: bool | None
    routers: int
    unreachable: Mapping[str, str] = field(default_factory=dict)
    listens_beyond: tuple[str, ...] = ()
    why_interpreted: str = ""
    scouts: Mapping[int, str] = field(default_factory=dict)
    stopped: frozenset[int] = frozenset()
    name: str = ""
    without_datagrams: str = ""


NO_HOST = ExaminedHost({}, is_compiled=False, interfaces=(), scouted=None, routers=0)

# Problems that come and go, and are looked for at each change of a stream.
PASSING: tuple[ProblemKind, ...] = ("conflict", "loop", "gone")


@dataclass(frozen=True)
class PassingProblem:
    """A problem, and from when to when it was there (log times); `from_ns` is None if it was there
    before the span, and it is not known since when; `until_ns` if it was still there at the end.
    """

    problem: Problem
    from_ns: int | None
    until_ns: int | None = None


@dataclass(frozen=True)
class Twins:
    """Processes that sent one stream at the same time, as a node that was started twice does: each
    of the `places` is a host and pid; the times are as a PassingProblem's.
    """

    node: str
    places: tuple[str, ...]
    from_ns: int | None
    until_ns: int | None = None


@dataclass(frozen=True, kw_only=True)
class RecordedSpan:
    """The span of a recording that is examined, and events in it.

    `start_ns` is the beginning of the recording, `from_ns` of the span. `restarts` are the log
    times at which streams began new epochs, by stream, but for those of `twins`. `samples` are by
    dynamic edge. `lost` counts messages that the recorder dropped, `paused` its pauses; `damage`
    are sentences on unreadable parts.
    """

    start_ns: int
    from_ns: int
    is_complete: bool
    is_growing: bool
    restarts: dict[str, list[int]]
    samples: dict[Edge, EdgeSamples]
    passing: tuple[PassingProblem, ...] = ()
    twins: tuple[Twins, ...] = ()
    lost: int = 0
    paused: int = 0
    damage: tuple[str, ...] = ()

    def time(self, log_ns: int) -> str:
        """A log time as `--at` takes it: `+12.345s`."""
        return f"+{(log_ns - self.start_ns) / 1e9:.3f}s"

    def when(self, passing: PassingProblem | Twins) -> str:
        """From when to when it was there: `from +1.000s to +2.500s`, `from before +1.000s on`."""
        from_ns, until_ns = passing.from_ns, passing.until_ns
        begin = f"before {self.time(self.from_ns)}" if from_ns is None else self.time(from_ns)
        return f"from {begin} {'on' if until_ns is None else f'to {self.time(until_ns)}'}"


@dataclass(frozen=True)
class Examination:
    """The bus in `listened_s` seconds: as seen from this host, or in a span of a recording.

    `moment` is the bus at the end; `flows` are how samples of its edges came, and `loads` how
    messages of its streams did. Of a fleet, with nodes and frames of all namespaces below too:
    `robots`, worst first, the `roster` of robots that are expected, and whether it `is_booting`:
    missing robots may still come. Of a live bus: `host` and `ros`;
    `out_of_reach` says of a bus here that this process gets no link to, if it sees no node. Of a
    recording: `span`.
    """

    settings: NodeSettings
    moment: BusMoment
    flows: tuple[EdgeFlow, ...]
    loads: Mapping[str, StreamFlow]
    listened_s: float
    host: ExaminedHost = NO_HOST
    ros: RosAround = field(default_factory=RosAround)
    out_of_reach: str = ""
    span: RecordedSpan | None = None
    is_fleet: bool = False
    robots: tuple[RobotStatus, ...] = ()
    roster: tuple[str, ...] = ()
    is_booting: bool = False

    @property
    def tree(self) -> FrameTree:
        """The tree of frames at the end."""
        return self.moment.tree

    @property
    def scope(self) -> str:
        """The namespaces whose nodes and frames are checked."""
        return scope(self.moment.namespace, is_fleet=self.is_fleet)

    @property
    def nodes(self) -> tuple[NodeDescription, ...]:
        """The nodes of the scope at the end; `moment.nodes` has other namespaces' too."""
        return tuple(node for node in self.moment.nodes if self._is_in_scope(node.name))

    @property
    def unanswered(self) -> tuple[str, ...]:
        """The nodes of the scope that were asked, and did not answer."""
        return tuple(filter(self._is_in_scope, self.moment.unanswered))

    @property
    def below(self) -> tuple[str, ...]:
        """The relative names of nodes in namespaces below that only a fleet's scope has."""
        names = map(self.moment.relative_name, self.moment.node_names)
        return () if self.is_fleet else tuple(name for name in names if name.find("/") > 0)

    def is_recent(self, node: NodeDescription, at_ns: int) -> bool:
        """Whether a time by the clock of a node's host is one of the last minute, or may be: it is
        0 if unknown, and that clock may be another than ours.
        """
        clocks = self.moment.clocks
        offset_s = next((clocks[each] for each in node.streams if each in clocks), None)
        is_elsewhere = self.span is None and node.host != printable(socket.gethostname())
        if not at_ns or (offset_s is None and is_elsewhere):
            return True
        return self.moment.at_ns - at_ns + round((offset_s or 0.0) * 1e9) < _RECENT_NS

    def _is_in_scope(self, node: str) -> bool:
        name = self.moment.relative_name(node)
        return not name.startswith("/") if self.is_fleet else "/" not in name

    def problems(self, kind: ProblemKind) -> list[str]:
        """The problems of a kind as sentences; in a span all that came and went, with times."""
        if self.span is None or kind not in PASSING:
            return [each.text for each in self.moment.problems if each.kind == kind]
        return [
            f"{self.span.when(each)}, {each.problem.text}"
            for each in self.span.passing
            if each.problem.kind == kind
        ]


def scope(namespace: str, *, is_fleet: bool) -> str:
    """The namespaces whose nodes and frames are checked, in words: `namespace /robot7`; of a fleet
    with all below it.
    """
    return f"namespace /{namespace}{' and all below it' if is_fleet else ''}"


# What happened longer ago than this is over, unless it goes on.
_RECENT_NS = 60_000_000_000


Verdict = Literal["ok", "warn", "fail", "skipped"]


@dataclass(frozen=True)
class Finding:
    """The verdict of one check, its evidence, and the remedy.

    `evidence` are sentences, one for each problem; of a skipped check, the reason.
    `remedy` is "" if there is nothing to do.
    """

    verdict: Verdict
    evidence: tuple[str, ...] = ()
    remedy: str = ""


def ok(*evidence: str) -> Finding:
    """Nothing is wrong."""
    return Finding("ok", evidence)


def skipped(reason: str) -> Finding:
    """The check could not be made, or does not apply."""
    return Finding("skipped", (reason,))


def found(verdict: Verdict, evidence: list[str], remedy: str, fine: str = "") -> Finding:
    """The verdict, if there is evidence; else ok, with `fine` as the evidence."""
    if not evidence:
        return ok(*filter(None, (fine,)))
    return Finding(verdict, tuple(evidence), remedy)


# The evidence that a check needs: any moment has the tree of frames; a live bus has this host, and
# counts of nodes; a recording has a span of time, with all that came and went in it.
Need = Literal["tree", "bus", "recording"]

Find = Callable[[Examination], Finding]

OF_A_BUS = skipped("it needs a live bus: a recording does not have that")


@dataclass(frozen=True)
class Check:
    """A check, and the evidence that it needs; it is skipped if an examination has none."""

    find: Find
    needs: Need = "tree"

    @property
    def promise(self) -> str:
        """The sentence that holds if it finds nothing."""
        return self.find.__doc__ or ""

    def applies(self, *, to_recording: bool) -> bool:
        """Whether a recording, or a live bus, has the evidence."""
        return self.needs == "tree" or to_recording == (self.needs == "recording")

    def __call__(self, seen: Examination) -> Finding:
        if self.applies(to_recording=seen.span is not None):
            return self.find(seen)
        if self.needs == "recording":
            return skipped("it needs a recording: give --bag FILE")
        return OF_A_BUS


# In the order in which they are printed: of this host, of the tree of frames, of flows.
CHECKS: dict[str, Check] = {}


def check(name: str, *, needs: Need = "tree") -> Callable[[Find], Find]:
    """List a function as the check of this name; its docstring is the promise."""

    def listed(find: Find) -> Find:
        CHECKS[name] = Check(find, needs)
        return find

    return listed


def examined(seen: Examination, names: Iterable[str] = ()) -> dict[str, Finding]:
    """The findings of all checks, or of these, by their names."""
    wanted = set(names) or CHECKS.keys()
    return {name: check(seen) for name, check in CHECKS.items() if name in wanted}


# A recording of a bus where streams come and go all the time has many changes: the tree is looked
# at no more often than this.
_MOST_LOOKS = 2000

# How often a tree with such a problem is looked at again, to see whether it is over.
_LOOK_EVERY_NS = 500_000_000


def examine_recorded(
    frames: RecordedFrames,
    settings: NodeSettings,
    from_ns: int,
    to_ns: int,
    fleet: Fleet | None = None,
    roster: Sequence[str] = (),
) -> Examination:
    """Look at a span of a recording, whose frames are of a fleet if one is given."""
    meter, passing = SpanMeter(from_ns, to_ns, frames.pauses), _Passing()
    lost = 0
    every_ns = max(_LOOK_EVERY_NS, (to_ns - from_ns) // _MOST_LOOKS)
    frames.seek(from_ns - 1)
    passing.begin(frames)
    # The epochs that were there before the span; the one that counted is the last.
    known = {
        each.name: [*frames.described(each.name, from_ns), each.epoch_ns or 0]
        for each in frames.streams()
    }
    for each in measure(frames, meter, every_ns):
        if isinstance(each, Tick):
            passing.update_ongoing(frames, each.log_ns)
            continue
        lost += each.dropped
        if each.kind in ("stream", "stream gone"):
            passing.update(frames, each.log_ns)
    passing.update(frames, to_ns)
    twins, restarts = [], {}
    # The clocks of several recorders differ: by them no two processes sent at the same time.
    is_of_one = frames.source.is_of_one_recorder
    for name, epochs in meter.epochs.items():
        doubled = _doubled(epochs) if is_of_one else {}
        if doubled:
            twins.append(_twins(frames, name, doubled, known.get(name, ()), to_ns))
        restarts[name] = _restarts(epochs, doubled, known.get(name, ()))
    span = RecordedSpan(
        start_ns=frames.start_ns,
        from_ns=from_ns,
        is_complete=frames.source.is_complete,
        is_growing=frames.source.is_growing,
        restarts={name: times for name, times in restarts.items() if times},
        samples=meter.samples(),
        passing=passing.found(),
        twins=tuple(twins),
        lost=lost,
        paused=len(meter.pauses),
        damage=tuple(each.text(frames.start_ns) for each in frames.source.damage),
    )
    moment, watch = frames.moment(), FleetWatch(roster)
    return Examination(
        replace(settings, sim_time=frames.is_simulated),
        moment,
        tuple(meter.edges()),
        meter.streams(),
        listened_s=(to_ns - from_ns) / 1e9,
        span=span,
        is_fleet=fleet is not None,
        robots=() if fleet is None else tuple(watch.robots(moment, has_frames=False)),
        roster=tuple(roster),
    )


# The messages of two epochs that come for so long at the same time are of two processes: the last
# messages of a process that was restarted may be on their way for a while.
_TOGETHER_NS = 2_000_000_000

# What was there so shortly before the end was still there.
_UNTIL_END_NS = 2_000_000_000


def _doubled(epochs: Mapping[int, EpochSpan]) -> dict[int, EpochSpan]:
    """The epochs of a stream during which another was sent too."""
    return {
        epoch_ns: span
        for epoch_ns, span in epochs.items()
        if any(
            each is not span
            and min(each.last_ns, span.last_ns) - max(each.first_ns, span.first_ns) > _TOGETHER_NS
            for each in epochs.values()
        )
    }


def _twins(
    frames: RecordedFrames,
    stream: str,
    doubled: Mapping[int, EpochSpan],
    known: Collection[int],
    to_ns: int,
) -> Twins:
    """The processes of these epochs; `known` are the epochs that were there before the span."""
    described = frames.described(stream, to_ns)
    from_ns = sorted(span.first_ns for span in doubled.values())[1]
    until_ns = sorted(span.last_ns for span in doubled.values())[-2]
    found = [described.get(each) for each in doubled]
    return Twins(
        next((each.node for each in found if each), stream),
        tuple(f"{each.host}, pid {each.pid}" if each else "an unknown host" for each in found),
        None if doubled.keys() <= set(known) else from_ns,
        until_ns if until_ns < to_ns - _UNTIL_END_NS else None,
    )


def _restarts(
    epochs: Mapping[int, EpochSpan], doubled: Collection[int], known: Collection[int]
) -> list[int]:
    """When epochs of a stream began in the span, each after another; those of twins are none."""
    begun = sorted((span.first_ns, each) for each, span in epochs.items() if each not in known)
    later = begun if known else begun[1:]
    return [first_ns for first_ns, epoch_ns in later if epoch_ns not in doubled]


class _Passing:
    """The problems that come and go, and when."""

    def __init__(self) -> None:
        self._ongoing: Ongoing[tuple[ProblemKind, tuple[str, ...]], Problem] = Ongoing()
        self._from_ns: dict[tuple[ProblemKind, tuple[str, ...]], int | None] = {}
        self._closed: list[PassingProblem] = []
        self._looks = 0

    def begin(self, frames: RecordedFrames) -> None:
        """Look at the tree before the span."""
        self.update(frames, frames.at_ns)
        known = frames.tree().frames
        for key, problem in self._ongoing.items.items():
            frame = known.get(problem.frames[0])
            gone_ns = frames.gone_ns(frame.authority) if frame and problem.kind == "gone" else None
            self._from_ns[key] = gone_ns

    def update(self, frames: RecordedFrames, log_ns: int) -> None:
        """Compare the tree of now with the one before."""
        self._looks += 1
        if self._looks > _MOST_LOOKS:
            return
        problems = frames.tree().problems()
        begun, ended = self._ongoing.update(
            {(each.kind, each.frames): each for each in problems if each.kind in PASSING}
        )
        self._from_ns |= dict.fromkeys(begun, log_ns)
        for key, problem in ended.items():
            self._closed.append(PassingProblem(problem, self._from_ns.pop(key), log_ns))

    def update_ongoing(self, frames: RecordedFrames, log_ns: int) -> None:
        """Look whether a problem is over."""
        if self._from_ns:
            self._looks -= 1
            self.update(frames, log_ns)

    def found(self) -> tuple[PassingProblem, ...]:
        """All, in the order in which they began."""
        ongoing = self._ongoing.items.items()
        every = [PassingProblem(each, self._from_ns[key]) for key, each in ongoing] + self._closed
        return tuple(sorted(every, key=lambda each: (each.from_ns or 0, each.problem.frames)))
