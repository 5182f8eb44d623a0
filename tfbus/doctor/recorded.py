"""Gathers all that the checks need from a recording; no Zenoh."""

from collections.abc import Sequence
from dataclasses import replace

from tfbus.bus.settings import NodeSettings
from tfbus.doctor.examination import PASSING, Examination, PassingProblem, RecordedSpan
from tfbus.frames.changes import Ticks
from tfbus.frames.fleet import FleetWatch
from tfbus.frames.moment import Ongoing
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.snapshot import Problem, ProblemKind
from tfbus.monitor.meter import SpanMeter, measure
from tfbus.wire.fleet import Fleet

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
    ticks = Ticks(frames, from_ns, every_ns, lambda log_ns: passing.look_again(frames, log_ns))
    for event in measure(frames, meter, ticks.before):
        lost += event.dropped
        if event.kind in ("stream", "stream gone"):
            passing.look(frames, event.log_ns)
    passing.look(frames, to_ns)
    restarts = {name: sorted(begun.values())[1:] for name, begun in meter.epochs.items()}
    span = RecordedSpan(
        start_ns=frames.start_ns,
        is_complete=frames.source.is_complete,
        restarts={name: times for name, times in restarts.items() if times},
        samples=meter.samples(),
        passing=passing.found(),
        lost=lost,
        paused=len(meter.pauses),
        damage=tuple(each.text(frames.start_ns) for each in frames.source.damage),
    )
    moment, watch = frames.moment(), FleetWatch(roster)
    return Examination(
        replace(settings, sim_time=frames.is_simulated),
        moment,
        tuple(meter.edges()),
        listened_s=(to_ns - from_ns) / 1e9,
        span=span,
        is_fleet=fleet is not None,
        robots=() if fleet is None else tuple(watch.robots(moment, has_frames=False)),
        roster=tuple(roster),
    )


class _Passing:
    """The problems that come and go, and when."""

    def __init__(self) -> None:
        self._ongoing: Ongoing[tuple[ProblemKind, tuple[str, ...]], Problem] = Ongoing()
        self._from_ns: dict[tuple[ProblemKind, tuple[str, ...]], int] = {}
        self._closed: list[PassingProblem] = []
        self._looks = 0

    def look(self, frames: RecordedFrames, log_ns: int) -> None:
        """Look at the tree now."""
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

    def look_again(self, frames: RecordedFrames, log_ns: int) -> None:
        """Look whether a problem is over."""
        if self._from_ns:
            self._looks -= 1
            self.look(frames, log_ns)

    def found(self) -> tuple[PassingProblem, ...]:
        """All, in the order in which they began."""
        ongoing = self._ongoing.items.items()
        every = [PassingProblem(each, self._from_ns[key]) for key, each in ongoing] + self._closed
        return tuple(sorted(every, key=lambda each: (each.from_ns, each.problem.frames)))
