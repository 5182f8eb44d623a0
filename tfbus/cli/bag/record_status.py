"""The display of `tfbus bag record` while it records, and at its end."""

import shlex
import sys
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tfbus.bag.keeping import WrittenPart
from tfbus.base.wording import counted, cut, duration, listed, printable
from tfbus.cli.output import many, paint, width, with_transforms
from tfbus.wire.limits import size_text

# Rates are over this time.
_RATES_OVER_S = 3.0

# The log says how it goes after this time, then after twice as long each time, up to the other.
_LOG_SOON_S, _LOG_AT_LEAST_S = 10.0, 600.0

# A disk that lasts longer lasts.
_LASTS_S = 7 * 86_400.0

_NAMED = 6

_ERASE_LINE = "\r\x1b[K"


@dataclass(frozen=True)
class RecordCounts:
    """The counts by a moment of the monotonic clock; `held` is how much a snapshot would
    have now, in bytes and seconds, None if all is written. `lost` messages were dropped here,
    `missing` ones never came: they are lost on the way, or come later, into a gap that is filled.
    """

    at_s: float
    messages: int
    transforms: int
    bytes: int
    free_bytes: int
    lost: int
    is_paused: bool = False
    held: tuple[int, float] | None = None
    files: int = 1
    filling: tuple[str, ...] = ()
    missing: int = 0


@dataclass(frozen=True)
class Rates:
    """The rates of recording, a second."""

    messages: float = 0.0
    transforms: float = 0.0
    bytes: float = 0.0


class Rating:
    """The rates of the last seconds, from looks."""

    def __init__(self, over_s: float = _RATES_OVER_S) -> None:
        self._over_s = over_s
        self._looks: deque[RecordCounts] = deque()

    def add(self, look: RecordCounts) -> Rates:
        """The rates with this look, the newest."""
        looks = self._looks
        looks.append(look)
        while len(looks) > 2 and looks[1].at_s <= look.at_s - self._over_s:
            looks.popleft()
        first = looks[0]
        passed_s = look.at_s - first.at_s
        if passed_s <= 0.0:
            return Rates()
        return Rates(
            (look.messages - first.messages) / passed_s,
            (look.transforms - first.transforms) / passed_s,
            (look.bytes - first.bytes) / passed_s,
        )


class LogPace:
    """Says when the log should say how it goes: soon after the beginning and while a gap is filled,
    then ever more rarely, since a black box runs for weeks.
    """

    def __init__(self, began_s: float) -> None:
        self._logged_s, self._every_s = began_s, _LOG_SOON_S

    def is_due(self, look: RecordCounts) -> bool:
        """Whether this look is to be logged; then it counts as logged."""
        every_s = _LOG_SOON_S if look.filling else self._every_s
        if look.at_s < self._logged_s + every_s:
            return False
        self._logged_s, self._every_s = look.at_s, min(2.0 * every_s, _LOG_AT_LEAST_S)
        return True


def clock_text(seconds: float) -> str:
    """A time as a recorder's clock shows it: `0:12:05`."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def status_parts(look: RecordCounts, rates: Rates, running_s: float) -> list[str]:
    """The parts of the status line."""
    state = "paused" if look.is_paused else "rec" if look.held is None else "hold"
    parts = [f"{state} {clock_text(running_s)}", f"{rates.messages:.0f} msg/s"]
    if look.held is None:
        parts.append(f"{rates.transforms:.0f} tf/s")
        parts.append(f"{size_text(look.bytes)} +{size_text(int(rates.bytes))}/s")
    else:
        held_bytes, held_s = look.held
        parts.append(f"last {held_s:.0f} s: {size_text(held_bytes)}")
        parts.append(counted(look.files, "snapshot"))
    free = ", ".join(_free_texts(look, rates))
    missing = [f"missing {look.missing}"] if look.missing else []
    return [*parts, *look.filling[:1], f"free {free}", *missing, f"dropped {look.lost}"]


def _free_texts(look: RecordCounts, rates: Rates) -> list[str]:
    """How much is free, and how long it lasts if that is less than a week."""
    lasts_s = look.free_bytes / rates.bytes if rates.bytes > 0.0 else _LASTS_S
    lasts = [duration(lasts_s)] if lasts_s < _LASTS_S else []
    return [size_text(look.free_bytes), *lasts]


class StatusLine:
    """A line of a terminal that is written again and again; log lines go above it."""

    def __init__(self) -> None:
        self._shown = False

    def show(self, parts: Sequence[str], *, warns: bool = False) -> None:
        """Show these parts; the last is painted if it `warns`."""
        room = width() - 1
        line = "  ".join(parts)
        line = cut(line if len(line) <= room else " ".join(parts), room)
        head, _, tail = line.partition(" ")
        head = paint(head, "warning" if head == "paused" else "bad")
        if warns and tail.endswith(parts[-1]):
            tail = f"{tail.removesuffix(parts[-1])}{paint(parts[-1], 'bad')}"
        self._shown = True
        self._write(f"{_ERASE_LINE}{head} {tail}")

    def clear(self, *_: object) -> bool:
        """Take the line away until it is shown again; True, as a filter of log records says."""
        if self._shown:
            self._shown = False
            self._write(_ERASE_LINE)
        return True

    def _write(self, text: str) -> None:
        with suppress(OSError):  # the terminal has hung up
            sys.stdout.write(text)
            sys.stdout.flush()


def log_text(look: RecordCounts, rates: Rates) -> str:
    """The line of the log that says every now and then how it goes."""
    of = (
        f"{rates.transforms:.0f} transforms/s, {size_text(look.bytes)}, "
        f"{size_text(int(rates.bytes))}/s"
        if look.held is None
        else f"the last {look.held[1]:.0f} s held, {size_text(look.held[0])}"
    )
    free = " free for ".join(_free_texts(look, rates))
    free = free if " free" in free else f"{free} free"
    text = f"{rates.messages:.0f} messages/s, {of}, {free}, {look.lost} dropped"
    if look.missing:
        text += f", {look.missing} missing"
    if look.filling:
        text += f"; {listed(look.filling, most=_NAMED)}"
    return f"Paused: {text}" if look.is_paused else text


def length_text(part: WrittenPart) -> str:
    """How long and how large a file is: `4.0 s, 86.3 kB`."""
    return f"{_length(part.seconds)}, {size_text(part.size)}"


def _length(seconds: float) -> str:
    return duration(seconds) if seconds else "0 s"


def summary(
    parts: Sequence[WrittenPart],
    transforms: int,
    statics: int,
    streams: Counter[str],
    topics: Counter[str],
    lost: Counter[str],
    *,
    deleted: int = 0,
) -> list[str]:
    """The summary of a recording, in at most a screen; `deleted` older files are not there."""
    if not parts:
        return ["Recorded nothing: no snapshot was asked for"]
    length = _length(sum(part.seconds for part in parts))
    lines = [f"Recorded {length} to {counted(len(parts), 'file')}"]
    if deleted:
        lines[0] += f", and deleted {counted(deleted, 'older file')}"
    shown = parts if len(parts) <= _NAMED else [*parts[:2], *parts[-3:]]
    for part in shown:
        lines.append(f"  {printable(str(part.path))}  {length_text(part)}")
    if len(shown) < len(parts):
        lines.insert(3, f"  … {len(parts) - len(shown)} more")
    if streams:
        held = with_transforms(many(streams.total(), "message"), transforms, statics)
        lines.append(f"{_rows('stream', streams)}: {held}")
    else:
        lines.append("No transforms")
    if topics:
        lines.append(f"{_rows('topic', topics)}: {many(topics.total(), 'message')}")
    if lost:
        what = listed([f"{count} {_LOST.get(kind, kind)}" for kind, count in lost.items()])
        lines.append(f"Not recorded: {what}")
    paths = [part.path for part in parts]
    named = [shlex.quote(str(path)) for path in paths]
    if len(paths) > 3:
        named = [_all_parts(paths[0], is_numbered=deleted > 0)]
    lines.append(f"Look into it: tfbus bag info {printable(' '.join(named))}")
    return lines


def _all_parts(first: Path, *, is_numbered: bool) -> str:
    """All files of a recording, as a shell finds them; the first left has a number, if it is not
    the first one.
    """
    stem = str(first.with_suffix(""))
    begin = stem[: stem.rindex("_") + 1] if is_numbered else stem
    return f"{shlex.quote(begin)}*{first.suffix}"


_LOST = {
    "transforms": "messages of transforms (dropped: too slow)",
    "statics": "messages of static transforms (dropped: too slow)",
    "topics": "messages of topics (dropped: too slow)",
    "events": "events (dropped: too slow)",
    "missing": "messages of transforms that never arrived (dropped on the way)",
    "history": "messages that publishers held from before (dropped: no room)",
    "too large": "larger than the limits",
    "unreadable": "that could not be read",
    "refused": "that the file cannot hold",
}


def _rows(noun: str, counts: Counter[str]) -> str:
    names = [printable(name, 60) for name, _ in counts.most_common(_NAMED)]
    more = len(counts) - len(names)
    named = listed([*names, *[""] * more], most=_NAMED)
    return f"{counted(len(counts), noun)} ({named})"
