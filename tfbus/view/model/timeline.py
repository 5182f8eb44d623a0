"""A recording as the page's timeline shows it: its span, how busy it was, what happened when."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from tfbus.wording import listed, printable

MarkKind = Literal["gone", "back", "restart", "conflict", "gap", "paused", "dropped"]

# In this order they stand in the legend; of marks in one place the first is named first.
KINDS: tuple[MarkKind, ...] = get_args(MarkKind)

# What happens within this time happens together.
_TOGETHER_NS = 500_000_000

_MOST_NAMED = 3


@dataclass(frozen=True)
class Mark:
    """An event from `start_ns` to `end_ns`, by the log times of the recording; the two are the
    same for what takes no time. `what` happened to the `streams`, if it is about some; `detail`
    is what else to say.
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
    """The marks by their starts; what happened to several streams at once is one."""
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
