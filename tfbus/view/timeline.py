"""The timeline of a recording: its span, how busy it was, and marks of its events.

Its events give most marks at once; gaps and how busy it was are in the index of its files.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tfbus.base.wording import counted, duration, listed, printable
from tfbus.frames.track import least_gap_between
from tfbus.recording.items import EventItem, Pause, waits_between
from tfbus.recording.part import Part
from tfbus.recording.reader import RecordingReader

Ints = NDArray[np.int64]

MarkKind = Literal["gone", "back", "restart", "conflict", "gap", "paused", "dropped"]

# In this order they stand in the legend; of marks in one place the first is named first.
KINDS: tuple[MarkKind, ...] = get_args(MarkKind)

# Events within this time happen together.
_TOGETHER_NS = 500_000_000

_MOST_NAMED = 3


@dataclass(frozen=True)
class Mark:
    """An event from `start_ns` to `end_ns`, by the log times of the recording; the two are the
    same if it takes no time. `what` happened to the `streams`, if it is about some; `detail`
    is a further clause.
    """

    kind: MarkKind
    start_ns: int
    end_ns: int
    what: str
    streams: tuple[str, ...] = ()
    detail: str = ""

    @property
    def text(self) -> str:
        """A sentence that can be printed."""
        names = listed([f"'{printable(name)}'" for name in self.streams], most=_MOST_NAMED)
        return f"{names} {self.what}{self.detail}" if names else f"{self.what}{self.detail}"

    def is_gone(self, stream: str) -> bool:
        """Whether this stream was gone."""
        return self.kind == "gone" and stream in self.streams

    def joins(self, other: "Mark") -> bool:
        """Whether the other says the same of other streams, at the same time."""
        return (
            (self.kind, self.what) == (other.kind, other.what)
            and bool(self.streams and other.streams)
            and not set(self.streams) & set(other.streams)
            and abs(self.start_ns - other.start_ns) <= _TOGETHER_NS
            and abs(self.end_ns - other.end_ns) <= _TOGETHER_NS
        )


@dataclass(frozen=True)
class Timeline:
    """A recording from `start_ns` to `end_ns`. `marks` are in the order of their starts;
    `activity` are counts of messages in equal parts of the span, () if they are not known.
    """

    start_ns: int
    end_ns: int
    marks: tuple[Mark, ...] = ()
    activity: tuple[int, ...] = ()

    @property
    def span_s(self) -> float:
        """How long it is, in s."""
        return (self.end_ns - self.start_ns) / 1e9

    def within(self, at_ns: int) -> int:
        """A time, or the end of the timeline that is nearer to it."""
        return min(max(at_ns, self.start_ns), self.end_ns)

    def next_mark(self, at_ns: int) -> Mark | None:
        """The first mark that starts after a time."""
        return next((mark for mark in self.marks if mark.start_ns > at_ns), None)

    def mark_before(self, at_ns: int) -> Mark | None:
        """The last mark that starts before a time."""
        return next((mark for mark in reversed(self.marks) if mark.start_ns < at_ns), None)


def in_order(marks: Iterable[Mark]) -> tuple[Mark, ...]:
    """The marks by their starts; an event of several streams at once is one mark."""
    whole: list[Mark] = []
    # A machine that leaves takes all its streams along.
    latest: dict[tuple[str, str], int] = {}
    for mark in sorted(marks, key=lambda mark: (mark.start_ns, KINDS.index(mark.kind))):
        row = latest.get((mark.kind, mark.what))
        if row is not None and whole[row].joins(mark):
            whole[row] = _joined(whole[row], mark)
        else:
            latest[mark.kind, mark.what] = len(whole)
            whole.append(mark)
    return tuple(whole)


def _joined(one: Mark, other: Mark) -> Mark:
    streams = tuple(dict.fromkeys((*one.streams, *other.streams)))
    detail = one.detail if one.detail == other.detail else ""
    end_ns = max(one.end_ns, other.end_ns)
    return replace(one, end_ns=end_ns, streams=streams, detail=detail)


def cut_to(marks: Sequence[Mark], start_ns: int, end_ns: int) -> tuple[Mark, ...]:
    """The marks that a span has something of."""
    return tuple(mark for mark in marks if mark.start_ns <= end_ns and mark.end_ns >= start_ns)


@dataclass
class _ListedStream:
    """A stream as its events described it last; `gone_ns` is since when it is gone."""

    epoch: int
    publisher: str
    children: frozenset[str]
    gone_ns: int | None = None


@dataclass
class _Sweep:
    """The open events while they pass by."""

    streams: dict[str, _ListedStream] = field(default_factory=dict)
    # By frame, the living streams that list it.
    claims: dict[str, set[str]] = field(default_factory=dict)
    # By pair of streams: since when, and the frames that both list.
    conflicts: dict[tuple[str, str], tuple[int, frozenset[str]]] = field(default_factory=dict)
    paused_ns: int | None = None


def marks_of_events(events: Iterable[EventItem], end_ns: int) -> Iterator[Mark]:
    """The marks of events, which come by their times; open ones at the end last to `end_ns`."""
    sweep = _Sweep()
    for event in events:
        yield from _of_event(sweep, event)
    yield from _still_open(sweep, end_ns)


def _of_event(sweep: _Sweep, event: EventItem) -> Iterator[Mark]:
    at_ns = event.log_ns
    match event.kind:
        case "stream":
            yield from _described(sweep, event)
        case "stream gone":
            stream = sweep.streams.get(event.name)
            if stream is not None and stream.gone_ns is None:
                stream.gone_ns = at_ns
                yield from _claim(sweep, event.name, stream.children, frozenset(), at_ns)
        case "paused":
            sweep.paused_ns = at_ns if sweep.paused_ns is None else sweep.paused_ns
        case "resumed" if sweep.paused_ns is not None:
            yield _paused(sweep.paused_ns, at_ns)
            sweep.paused_ns = None
        case "dropped":
            lost = counted(event.dropped, "message") if event.dropped else "messages"
            yield Mark("dropped", at_ns, at_ns, f"{lost} not recorded: the recorder was too slow")


def _described(sweep: _Sweep, event: EventItem) -> Iterator[Mark]:
    at_ns, name = event.log_ns, event.name
    now = _ListedStream(_epoch(event.facts), _publisher(event.facts), event.children)
    former = sweep.streams.get(name)
    if former is not None:
        restarted = bool(former.epoch and now.epoch > former.epoch)
        if former.gone_ns is not None:
            yield _gone(name, former, former.gone_ns, at_ns)
            ago = duration((at_ns - former.gone_ns) / 1e9)
            how = ", restarted" if restarted else ""
            yield Mark("back", at_ns, at_ns, f"back after {ago}{how}", (name,))
        elif restarted:
            yield Mark("restart", at_ns, at_ns, "restarted", (name,), now.publisher)
    sweep.streams[name] = now
    listed_before = former.children if former else frozenset()
    yield from _claim(sweep, name, listed_before, now.children, at_ns)


def _claim(
    sweep: _Sweep, name: str, former: frozenset[str], children: frozenset[str], at_ns: int
) -> Iterator[Mark]:
    """The stream lists these frames from now on in the place of the former, none if it is gone.

    Yields the conflicts that end with that.
    """
    for child in former:
        sweep.claims.get(child, set()).discard(name)
    shared: dict[str, set[str]] = {}
    for child in children:
        names = sweep.claims.setdefault(child, set())
        for other in names:
            shared.setdefault(other, set()).add(child)
        names.add(name)
    open_now = {_pair(name, other): frozenset(frames) for other, frames in shared.items()}
    for pair in [pair for pair in sweep.conflicts if name in pair]:
        since_ns, frames = sweep.conflicts[pair]
        if open_now.get(pair) != frames:
            del sweep.conflicts[pair]
            yield _conflict(pair, frames, since_ns, at_ns)
    for pair, frames in open_now.items():
        sweep.conflicts.setdefault(pair, (at_ns, frames))


def _still_open(sweep: _Sweep, end_ns: int) -> Iterator[Mark]:
    for name, stream in sweep.streams.items():
        if stream.gone_ns is not None:
            yield _gone(name, stream, stream.gone_ns, end_ns)
    for pair, (since_ns, frames) in sweep.conflicts.items():
        yield _conflict(pair, frames, since_ns, end_ns)
    if sweep.paused_ns is not None:
        yield _paused(sweep.paused_ns, end_ns)


def _gone(name: str, stream: _ListedStream, since_ns: int, until_ns: int) -> Mark:
    return Mark("gone", since_ns, until_ns, "gone", (name,), stream.publisher)


def _conflict(pair: tuple[str, str], frames: frozenset[str], since_ns: int, until_ns: int) -> Mark:
    what = listed([_quoted(frame) for frame in sorted(frames)], most=_MOST_NAMED)
    text = f"{what} published by {_quoted(pair[0])} and {_quoted(pair[1])}"
    return Mark("conflict", since_ns, until_ns, text)


def _paused(since_ns: int, until_ns: int) -> Mark:
    text = f"recording paused for {duration((until_ns - since_ns) / 1e9)}"
    return Mark("paused", since_ns, until_ns, text)


def _pair(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _quoted(name: str) -> str:
    return f"'{printable(name)}'"


# Facts come from a file: nothing of them is as it should be until it was looked at.


def _epoch(facts: Mapping[str, Any]) -> int:
    epoch = facts.get("epoch")
    return epoch if isinstance(epoch, int) else 0


def _publisher(facts: Mapping[str, Any]) -> str:
    node, host, pid = (facts.get(name) for name in ("node", "host", "pid"))
    if not node:
        return ""
    return f": {printable(str(node))} on {printable(str(host or '?'))}, pid {printable(str(pid))}"


_BARS = 240


def known_timeline(reader: RecordingReader, start_ns: int, end_ns: int) -> Timeline:
    """The span, with the marks of the events."""
    marks = marks_of_events(reader.events, reader.end_ns)
    return Timeline(start_ns, end_ns, cut_to(in_order(marks), start_ns, end_ns))


def whole_timeline(
    reader: RecordingReader, known: Timeline, is_ended: Callable[[], bool]
) -> Timeline | None:
    """The same with the silence of streams, their restarts if there are no events of them, and how
    busy the recording was: from the index of the file. None if `is_ended` before.

    Raises DecodeError if the file is damaged.
    """
    busy = _Activity(known.start_ns, known.end_ns)
    times: dict[str, list[Ints]] = {}
    described = {event.name for event in reader.events if event.kind == "stream"}
    restarts: dict[tuple[str, int], int] = {}
    for part in reader.parts:
        for found in _times_of(part):
            if is_ended():
                return None
            name, epoch_ns, log_ns = found
            busy.add(log_ns)
            times.setdefault(name, []).append(log_ns)
            if name not in described:
                key = (name, epoch_ns)
                restarts[key] = min(restarts.get(key, 2**63), int(log_ns[0]))
    end_ns = reader.end_ns
    marks = [*known.marks, *_restarted(restarts)]
    for name, found_ns in times.items():
        # A stream that is gone, or was not recorded, is marked as that.
        gone = [Pause(mark.start_ns, mark.end_ns) for mark in known.marks if mark.is_gone(name)]
        marks += _silences(name, np.sort(np.concatenate(found_ns)), [*reader.pauses, *gone], end_ns)
    shown = cut_to(in_order(marks), known.start_ns, known.end_ns)
    return replace(known, marks=shown, activity=tuple(busy.counts.tolist()))


def _times_of(part: Part) -> Iterator[tuple[str, int, Ints]]:
    """Stream, epoch and log times of the dynamic transforms in each chunk."""
    for chunk in part.file.chunks:
        for number, log_ns in part.file.log_times(chunk).items():
            channel = part.stream_channels.get(number)
            if channel is not None and not channel.is_static and log_ns:
                stream = channel.stream
                yield stream.name, stream.epoch_ns, np.sort(np.array(log_ns, np.int64))


class _Activity:
    """How many messages came in each part of a span."""

    def __init__(self, start_ns: int, end_ns: int) -> None:
        self.counts = np.zeros(_BARS, np.int64)
        self._start_ns = start_ns
        self._span_ns = max(end_ns - start_ns, 1)

    def add(self, log_ns: Ints) -> None:
        """Count these."""
        bars = ((log_ns - self._start_ns) / self._span_ns * _BARS).astype(np.int64)
        inside = bars[(bars >= 0) & (bars <= _BARS)]
        self.counts += np.bincount(np.minimum(inside, _BARS - 1), minlength=_BARS)


def _silences(name: str, log_ns: Ints, apart: Sequence[Pause], end_ns: int) -> Iterator[Mark]:
    """The gaps in a stream with messages at these log times, and its silence up to the end; a gap
    begins, or ends, at a pause of `apart`.
    """
    least_ns = least_gap_between(waits_between(log_ns, apart).length_ns)
    waits = waits_between(np.append(log_ns, max(end_ns, int(log_ns[-1]))), apart)
    for row in np.flatnonzero(waits.length_ns > least_ns).tolist():
        start_ns, length_ns = int(waits.from_ns[row]), int(waits.length_ns[row])
        how_long = duration(length_ns / 1e9)
        yield Mark("gap", start_ns, start_ns + length_ns, f"silent for {how_long}", (name,))


def _restarted(first_ns: dict[tuple[str, int], int]) -> Iterator[Mark]:
    """The later epochs of streams, by when their first messages came."""
    former = ""
    for name, epoch_ns in sorted(first_ns):
        if name == former:
            at_ns = first_ns[name, epoch_ns]
            yield Mark("restart", at_ns, at_ns, "restarted", (name,))
        former = name
