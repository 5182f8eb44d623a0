"""A recording as the page's timeline shows it: its span, how busy it was, what happened when."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

MarkKind = Literal["gone", "back", "restart", "conflict", "gap", "paused", "dropped"]

# In this order they stand in the legend; of marks in one place the first is named first.
KINDS: tuple[MarkKind, ...] = get_args(MarkKind)


@dataclass(frozen=True)
class Mark:
    """What happened from `start_ns` to `end_ns`, by the log times of the recording; the two are the
    same for what takes no time. `text` is one printable sentence.
    """

    kind: MarkKind
    start_ns: int
    end_ns: int
    text: str


@dataclass(frozen=True)
class Timeline:
    """A recording from `start_ns` to `end_ns`. `marks` are in the order of their starts;
    `activity` are counts of messages in equal parts of the span, () where they are not known.
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
    """The marks by their starts."""
    return tuple(sorted(marks, key=lambda mark: (mark.start_ns, KINDS.index(mark.kind))))


def cut_to(marks: Sequence[Mark], start_ns: int, end_ns: int) -> tuple[Mark, ...]:
    """The marks that a span has something of."""
    return tuple(mark for mark in marks if mark.start_ns <= end_ns and mark.end_ns >= start_ns)
