"""How transforms come, in numbers."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from tfbus.monitor.window import Spread

Edge = tuple[str, str, str]  # stream, parent, child


@dataclass(frozen=True)
class EdgeFlow:
    """How the samples of one edge came.

    Of the recent ones: `rate_hz` by their arrivals, `jitter_s` the standard deviation of the times
    between them, `delays_s` their ages at arrival, by their stamps and our clock, below zero for
    stamps in the future. Since the meter was made: `longest_gap_s` between two stamps,
    `out_of_order` counts samples older than one before, `at_zero` those with the stamp 0.

    In a span of a recording all are of the whole span, and times between samples are of their
    arrivals. There, `gaps` counts the pauses, which rate and jitter leave out, and the longest
    begins at the log time `gap_from_ns`, None without one.
    """

    stream: str
    parent: str
    child: str
    rate_hz: float | None = None
    jitter_s: float | None = None
    delays_s: Spread | None = None
    longest_gap_s: float = 0.0
    out_of_order: int = 0
    at_zero: int = 0
    gaps: int = 0
    gap_from_ns: int | None = None

    @property
    def least_delay_s(self) -> float | None:
        """The age at arrival of the sample that came soonest."""
        return self.delays_s.min if self.delays_s else None


@dataclass(frozen=True)
class StreamFlow:
    """The load of a stream in the last seconds: messages and bytes per second."""

    messages_hz: float
    bytes_per_s: float


class Meter(Protocol):
    """Measures how transforms come: on a bus, or in a span of a recording."""

    def edges(self) -> Iterator[EdgeFlow]:
        """How the samples of each edge came."""

    def stream(self, name: str) -> StreamFlow:
        """How the messages of a stream came."""
