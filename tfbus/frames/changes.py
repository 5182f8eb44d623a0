"""Changes of the bus: the differences between one moment and the next."""

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from tfbus.frames.moment import BusMoment, FrameStatus
from tfbus.frames.snapshot import Problem
from tfbus.wording import duration, listed

ChangeKind = Literal[
    "frame appeared",
    "frame removed",
    "frame gone",
    "frame stale",
    "frame back",
    "publisher changed",
    "node came",
    "node left",
    "conflict begun",
    "conflict ended",
    "problem begun",
    "problem ended",
]

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

# The faults in which nothing of a frame comes.
_AWAY = ("gone", "stale")


@dataclass(frozen=True)
class BusChange:
    """A change of the bus, noticed at `at_ns` (by the system's clock, or a log time; in ns).

    `kind` is "frame appeared", "frame removed" (no longer listed), "frame gone" (its publisher
    left), "frame stale", "frame back" (from either), "publisher changed", "node came", "node left",
    or "conflict" or "problem" with " begun" or " ended". `name` is that of the frame or node,
    `text` a sentence, and `problem` that of a conflict or problem, with its remedy.
    """

    at_ns: int
    kind: ChangeKind
    name: str
    text: str
    problem: Problem | None = None


class Ongoing(Generic[K, V]):
    """Items that begin and end: compares those of one moment with those of the moment before."""

    def __init__(self) -> None:
        self.items: dict[K, V] = {}

    def update(self, now: Mapping[K, V]) -> tuple[dict[K, V], dict[K, V]]:
        """The items that have begun, and those that have ended, as they were at first."""
        begun = {key: value for key, value in now.items() if key not in self.items}
        ended = {key: value for key, value in self.items.items() if key not in now}
        self.items = {key: value for key, value in self.items.items() if key in now} | begun
        return begun, ended


class Changes:
    """The changes from each moment to the next; the first moment is what has come."""

    def __init__(self) -> None:
        self._frames: Mapping[str, FrameStatus] = {}
        self._nodes: frozenset[str] = frozenset()
        self._problems: Ongoing[tuple[str, str], Problem] = Ongoing()

    def to(self, moment: BusMoment) -> Iterator[BusChange]:
        """The changes from the last moment to this one: of nodes, then frames, then problems."""
        yield from self._of_nodes(moment)
        yield from self._of_frames(moment)
        yield from self._of_problems(moment)

    def _of_nodes(self, moment: BusMoment) -> Iterator[BusChange]:
        before, self._nodes = self._nodes, moment.node_names
        for name in sorted(before - self._nodes):
            yield BusChange(moment.at_ns, "node left", name, f"node {name} left")
        for name in sorted(self._nodes - before):
            yield BusChange(moment.at_ns, "node came", name, f"node {name} came")

    def _of_frames(self, moment: BusMoment) -> Iterator[BusChange]:
        before, self._frames = self._frames, moment.frames
        for name in sorted(before.keys() - self._frames.keys()):
            yield BusChange(moment.at_ns, "frame removed", name, f"frame {name!r} is removed")
        for name, frame in self._frames.items():
            for kind, text in _of_frame(before.get(name), frame):
                yield BusChange(moment.at_ns, kind, name, f"frame {name!r} {text}")

    def _of_problems(self, moment: BusMoment) -> Iterator[BusChange]:
        begun, ended = self._problems.update(
            {(each.kind, each.frames[0]): each for each in moment.problems}
        )
        for problems, verb in ((ended, "ended"), (begun, "begun")):
            for problem in problems.values():
                yield BusChange(
                    moment.at_ns,
                    _kind_of(problem, is_begun=verb == "begun"),
                    problem.frames[0],
                    problem.text if verb == "begun" else f"no longer: {problem.text}",
                    problem,
                )


def _of_frame(before: FrameStatus | None, now: FrameStatus) -> Iterator[tuple[ChangeKind, str]]:
    """The changes of a frame, each with the rest of its sentence."""
    was = None if before is None else _away(before)
    if before is None:
        under = "as a root" if now.parent is None else f"under {now.parent!r} by {now.publisher}"
        yield "frame appeared", f"appeared {under}"
    elif before.publisher != now.publisher and before.publisher and now.publisher:
        yield (
            "publisher changed",
            f"comes from {_source(now)}, no longer from {_source(before)}",
        )
    is_now = _away(now)
    if is_now == was:
        return
    if is_now == "gone":
        yield "frame gone", f"has lost its publisher {_source(now)}"
    elif is_now == "stale":
        yield "frame stale", f"has been silent for {duration(now.silent_s)}: {_source(now)}"
    elif was is not None:
        yield "frame back", f"comes again from {listed(now.publishers) or now.publisher}"


def _away(frame: FrameStatus) -> str | None:
    return next((fault for fault in frame.faults if fault in _AWAY), None)


def _source(frame: FrameStatus) -> str:
    return f"{frame.node} on {frame.host}" if frame.host else frame.publisher


def _kind_of(problem: Problem, *, is_begun: bool) -> ChangeKind:
    if problem.kind == "conflict":
        return "conflict begun" if is_begun else "conflict ended"
    return "problem begun" if is_begun else "problem ended"
