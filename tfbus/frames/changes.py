"""The changes from one moment of the bus to the next: of a watched bus, and of a recording."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.wording import duration, listed
from tfbus.buffer.explain import check_seconds
from tfbus.frames.moment import BusMoment, FrameStatus, Ongoing
from tfbus.frames.recorded import RecordedFrames, Tick
from tfbus.frames.snapshot import Problem
from tfbus.geometry.transform import check_stamp
from tfbus.recording.items import EventItem, check_span
from tfbus.recording.reader import RecordingReader
from tfbus.wire.fleet import Fleet

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

# Between two looks.
_LEAST_PERIOD_S, _LONGEST_PERIOD_S = 1e-3, 1e9

# The faults in which nothing of a frame comes.
_AWAY = ("gone", "stale")


@dataclass(frozen=True)
class BusChange:
    """A change of the bus, noticed at `at_ns` (by the system's clock, or a log time; in ns).

    `kind` is "frame appeared", "frame removed" (no longer listed), "frame gone" (its publisher
    left), "frame stale", "frame back" (from either), "publisher changed", "node came", "node left",
    or "conflict" or "problem" with " begun" or " ended". `name` is the frame's or node's,
    `text` a sentence, and `problem` that of a conflict or problem, with its remedy.
    """

    at_ns: int
    kind: ChangeKind
    name: str
    text: str
    problem: Problem | None = None


def check_period(period_s: object) -> None:
    """Raise InvalidArgumentException for no time between two looks."""
    check_seconds(period_s, "period_s", least=_LEAST_PERIOD_S, most=_LONGEST_PERIOD_S)


class Changes:
    """The changes from each moment to the next; at the first moment all has come."""

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


class Recorded:
    """The bus at the moments of a recording, as a listener in a namespace, or with a fleet, had it.

    `paths` are the files of one recording. `start_ns` and `end_ns` are its first and last log time,
    in ns since the Unix epoch. Use it in a `with`, or `close()` it. Raises DecodeError if a file is
    no recording, FileError if it cannot be opened.
    """

    def __init__(
        self,
        *paths: str | os.PathLike[str],
        namespace: str = "",
        fleet: Fleet | None = None,
    ) -> None:
        if not paths:
            raise InvalidArgumentException("name at least one file of the recording")
        self._reader = RecordingReader(*paths)
        self._namespace, self._fleet = namespace, fleet
        self._sought = self._frames()
        self.start_ns, self.end_ns = self._reader.start_ns, self._reader.end_ns

    def __enter__(self) -> "Recorded":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files. Twice is fine."""
        self._reader.close()

    def at(self, at_ns: int) -> BusMoment:
        """The bus at a log time. Raises InvalidArgumentException outside of the recording."""
        self._check(at_ns)
        self._sought.seek(at_ns)
        return self._sought.moment()

    def changes(
        self, from_ns: int | None = None, to_ns: int | None = None, period_s: float = 0.2
    ) -> Iterator[BusChange]:
        """The changes between two log times, by default of the whole recording: first of all that
        is there, then each at an event, or at most `period_s` later. Errors as `at`.
        """
        check_span(from_ns, to_ns)
        check_period(period_s)
        first_ns = self.start_ns if from_ns is None else self._check(from_ns)
        last_ns = self.end_ns if to_ns is None else self._check(to_ns)
        return self._changes(first_ns, last_ns, round(period_s * 1e9))

    def _changes(self, first_ns: int, last_ns: int, period_ns: int) -> Iterator[BusChange]:
        frames, changes = self._frames(), Changes()
        frames.seek(first_ns)
        yield from changes.to(frames.moment())
        for each in frames.play(last_ns, period_ns):
            if isinstance(each, EventItem | Tick):
                yield from changes.to(frames.moment())
        yield from changes.to(frames.moment())

    def _frames(self) -> RecordedFrames:
        return RecordedFrames(self._reader, namespace=self._namespace, fleet=self._fleet)

    def _check(self, at_ns: int) -> int:
        check_stamp(at_ns, "log time")
        if not self._reader.start_ns <= at_ns <= self._reader.end_ns:
            raise InvalidArgumentException(
                f"at_ns: {at_ns} is not in the recording, which is of the log times "
                f"{self._reader.start_ns} to {self._reader.end_ns}"
            )
        return at_ns
