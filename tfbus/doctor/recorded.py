"""Looks at a recording: gathers all that the checks of recordings need."""

from dataclasses import dataclass, replace

from tfbus.buffer.buffer import Buffer
from tfbus.bus.settings import NodeSettings
from tfbus.doctor.examination import Examination, Host
from tfbus.frames.recorded import RecordedFrames
from tfbus.frames.snapshot import Problem, ProblemKind
from tfbus.monitor.flow import Edge
from tfbus.monitor.recorded import EdgeSamples, SpanMeter, Ticks, measure

# Problems that come and go, and are looked for at each change of a stream.
_PASSING: tuple[ProblemKind, ...] = ("conflict", "loop", "gone")

# A recording of a bus where streams come and go all the time has many changes: the tree is looked
# at no more often than this.
_MOST_LOOKS = 2000

# How often a tree with such a problem is looked at again, to see whether it is over.
_LOOK_EVERY_NS = 500_000_000

_NO_HOST = Host({}, is_compiled=False, interfaces=(), scouted=None, routers=0)


@dataclass(frozen=True)
class PassingProblem:
    """A problem, and from when to when it was there (log times); `until_ns` is None if it was
    still there at the end.
    """

    problem: Problem
    from_ns: int
    until_ns: int | None = None


@dataclass(frozen=True, kw_only=True)
class RecordedExamination(Examination):
    """A span of a recording; `tree` and `nodes` are those at its end.

    `start_ns` is the beginning of the recording. `restarts` are the log times at which streams
    began new epochs, by stream. `lost` counts messages that the recorder dropped; `damage` says
    what cannot be read.
    """

    start_ns: int
    is_complete: bool
    passing: tuple[PassingProblem, ...] = ()
    restarts: dict[str, list[int]]
    samples: dict[Edge, EdgeSamples]
    lost: int = 0
    paused: int = 0
    damage: tuple[str, ...] = ()

    def time(self, log_ns: int) -> str:
        """A log time as `--at` takes it: `+12.345s`."""
        return f"+{(log_ns - self.start_ns) / 1e9:.3f}s"


def examine_recorded(
    frames: RecordedFrames, settings: NodeSettings, from_ns: int, to_ns: int, *, is_complete: bool
) -> RecordedExamination:
    """Look at a span of a recording."""
    meter, passing = SpanMeter(from_ns, to_ns, frames.pauses), _Passing()
    lost = 0
    every_ns = max(_LOOK_EVERY_NS, (to_ns - from_ns) // _MOST_LOOKS)
    ticks = Ticks(frames, from_ns, every_ns, lambda log_ns: passing.look_again(frames, log_ns))
    for event in measure(frames, meter, ticks.before):
        lost += event.dropped
        if event.kind in ("stream", "stream gone"):
            passing.look(frames, event.log_ns)
    passing.look(frames, to_ns)
    samples = meter.samples()
    return RecordedExamination(
        settings=replace(settings, sim_time=frames.is_simulated),
        host=_NO_HOST,
        nodes=frames.nodes,
        tree=frames.tree(),
        flows=tuple(meter.edges()),
        listened_s=(to_ns - from_ns) / 1e9,
        rejected=_rejected(frames.buffer),
        start_ns=frames.start_ns,
        is_complete=is_complete,
        passing=passing.found(),
        restarts={
            name: sorted(begun.values())[1:]
            for name, begun in meter.epochs.items()
            if len(begun) > 1
        },
        samples=samples,
        lost=lost,
        paused=len(meter.pauses),
    )


def _rejected(buffer: Buffer) -> dict[str, int]:
    return dict(buffer.rejected)


class _Passing:
    """The problems that come and go."""

    def __init__(self) -> None:
        self._open: dict[tuple[ProblemKind, tuple[str, ...]], PassingProblem] = {}
        self._closed: list[PassingProblem] = []
        self._looks = 0

    def look(self, frames: RecordedFrames, log_ns: int) -> None:
        """Look at the tree now."""
        self._looks += 1
        if self._looks > _MOST_LOOKS:
            return
        now = {
            (problem.kind, problem.frames): problem
            for problem in frames.tree().problems()
            if problem.kind in _PASSING
        }
        for key in self._open.keys() - now.keys():
            self._closed.append(replace(self._open.pop(key), until_ns=log_ns))
        for key in now.keys() - self._open.keys():
            self._open[key] = PassingProblem(now[key], log_ns)

    def look_again(self, frames: RecordedFrames, log_ns: int) -> None:
        """Look whether a problem is over."""
        if self._open:
            self._looks -= 1
            self.look(frames, log_ns)

    def found(self) -> tuple[PassingProblem, ...]:
        """All, in the order in which they began."""
        every = [*self._closed, *self._open.values()]
        return tuple(sorted(every, key=lambda each: (each.from_ns, each.problem.frames)))
