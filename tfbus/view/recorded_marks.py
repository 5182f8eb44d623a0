"""The timeline of a recording: what its events say at once, and what only its messages show."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tfbus.view.model.event_marks import marks_of_events
from tfbus.view.model.timeline import Mark, Timeline, cut_to, in_order
from tfbus.wording import duration

if TYPE_CHECKING:
    from tfbus.recording.part import Part
    from tfbus.recording.reader import RecordingReader

_BARS = 240

# A stream is silent after as long as a frame is stale: 1 s, and three of its periods. Those vary:
# the period is the one that 19 of 20 keep to.
_STALE_S = 1.0
_STALE_PERIODS = 3.0
_USUAL = 0.95

# No shorter pause can decide.
_NOTED_NS = int(1e9 * _STALE_S / _STALE_PERIODS)

_MOST_NOTED = 100_000


def known_timeline(reader: "RecordingReader", start_ns: int, end_ns: int) -> Timeline:
    """The span, with the marks of the events."""
    marks = marks_of_events(reader.events, reader.end_ns)
    return Timeline(start_ns, end_ns, cut_to(in_order(marks), start_ns, end_ns))


def whole_timeline(
    reader: "RecordingReader", known: Timeline, is_ended: Callable[[], bool]
) -> Timeline | None:
    """The same with the silence of streams, their restarts if there are no events of them, and how
    busy the recording was: from the index of the file. None if `is_ended` before.

    Raises DecodeError if the file is damaged.
    """
    busy = _Activity(known.start_ns, known.end_ns)
    times: dict[str, _Times] = {}
    described = {event.name for event in reader.events if event.kind == "stream"}
    restarts: dict[tuple[str, int], int] = {}
    for part in reader.parts:
        for found in _times_of(part):
            if is_ended():
                return None
            name, epoch_ns, log_ns = found
            busy.add(log_ns)
            times.setdefault(name, _Times()).add(log_ns)
            if name not in described:
                key = (name, epoch_ns)
                restarts[key] = min(restarts.get(key, 2**63), int(log_ns[0]))
    end_ns = reader.end_ns
    marks = [*known.marks, *_restarted(restarts)]
    for name, stream in times.items():
        marks += _silences(name, stream, end_ns, known.marks)
    shown = cut_to(in_order(marks), known.start_ns, known.end_ns)
    return replace(known, marks=shown, activity=tuple(busy.counts.tolist()))


def _times_of(part: "Part") -> Iterator[tuple[str, int, NDArray[np.int64]]]:
    """Stream, epoch and log times of the dynamic transforms in each chunk."""
    for chunk in part.file.chunks:
        for number, log_ns in part.file.log_times(chunk).items():
            channel = part.stream_channels.get(number)
            if channel is not None and not channel.is_static and log_ns:
                stream = channel.stream
                yield stream.name, stream.epoch_ns, np.sort(np.array(log_ns, np.int64))


@dataclass
class _Times:
    """How the messages of a stream came: the pauses that may be silence, (start, end)."""

    count: int = 0
    last_ns: int | None = None
    pauses: list[tuple[int, int]] = field(default_factory=list)

    def add(self, log_ns: NDArray[np.int64]) -> None:
        """Take log times, in order and after those before."""
        if self.last_ns is not None:
            log_ns = np.concatenate(([self.last_ns], log_ns))
        noted = np.flatnonzero(np.diff(log_ns) > _NOTED_NS)
        if len(self.pauses) < _MOST_NOTED:
            self.pauses += zip(log_ns[noted].tolist(), log_ns[noted + 1].tolist(), strict=True)
        self.count += len(log_ns)
        self.last_ns = int(log_ns.max())

    def longest_usual_s(self) -> float:
        """The longest pause between messages that is no silence."""
        lengths = sorted((end - start) / 1e9 for start, end in self.pauses)
        unusual = round((1.0 - _USUAL) * self.count)
        if len(lengths) <= unusual:
            return _STALE_S
        return max(_STALE_S, _STALE_PERIODS * lengths[-1 - unusual])


class _Activity:
    """How many messages came in each part of a span."""

    def __init__(self, start_ns: int, end_ns: int) -> None:
        self.counts = np.zeros(_BARS, np.int64)
        self._start_ns = start_ns
        self._span_ns = max(end_ns - start_ns, 1)

    def add(self, log_ns: NDArray[np.int64]) -> None:
        """Count these."""
        bars = ((log_ns - self._start_ns) / self._span_ns * _BARS).astype(np.int64)
        inside = bars[(bars >= 0) & (bars <= _BARS)]
        self.counts += np.bincount(np.minimum(inside, _BARS - 1), minlength=_BARS)


def _silences(name: str, stream: _Times, end_ns: int, marks: Iterable[Mark]) -> Iterator[Mark]:
    usual_s = stream.longest_usual_s()
    pauses = list(stream.pauses)
    if stream.last_ns is not None:
        pauses.append((stream.last_ns, end_ns))
    # What is gone, or was not recorded, is marked as that.
    known = [mark for mark in marks if mark.kind == "paused" or mark.is_gone(name)]
    for start_ns, stop_ns in pauses:
        length_s = (stop_ns - start_ns) / 1e9
        if length_s <= usual_s:
            continue
        if any(mark.start_ns <= stop_ns and mark.end_ns >= start_ns for mark in known):
            continue
        yield Mark("gap", start_ns, stop_ns, f"silent for {duration(length_s)}", (name,))


def _restarted(first_ns: dict[tuple[str, int], int]) -> Iterator[Mark]:
    """The later epochs of streams, by when their first messages came."""
    former = ""
    for name, epoch_ns in sorted(first_ns):
        if name == former:
            at_ns = first_ns[name, epoch_ns]
            yield Mark("restart", at_ns, at_ns, "restarted", (name,))
        former = name
