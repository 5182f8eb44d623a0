"""The model of a history: each process's transforms, which tell it themselves.

The x of a dynamic transform is the number of its series, its y the stamp in seconds. So each answer
of a lookup tells its sender, epoch and time; one between two series is of neither.
"""

import itertools
from dataclasses import dataclass, field
from typing import Any

from tfbus.testing.processes import START_NS, Process

# Numbers of series lie this far apart, unevenly: what is between two is hardly that of a third.
_UNEVEN = 0.6180339887

# Stamps that go back by more than this begin an epoch.
_MOST_BACK_NS = 1_000_000_000


@dataclass
class Series:
    """The samples of one frame that a process sends in one epoch, until it removes the frame."""

    x: float
    publisher: "Publisher"
    frame: str
    epoch: int
    first_ns: int
    last_ns: int

    @property
    def whose(self) -> tuple[int, int]:
        """The process and the epoch."""
        return self.publisher.number, self.epoch


@dataclass
class Publisher:
    """A process that publishes, and what it has sent."""

    number: int
    slot: str
    process: Process | None = None
    node: Any = None
    dynamic: Any = None
    static: Any = None
    statics: dict[str, int] = field(default_factory=dict)
    versions: dict[str, set[int]] = field(default_factory=dict)
    removed: dict[str, float] = field(default_factory=dict)
    ever_sent: set[str] = field(default_factory=set)
    epoch: int = 0
    newest_ns: dict[str, int] = field(default_factory=dict)
    series: dict[str, Series] = field(default_factory=dict)
    is_closed: bool = False
    began_s: float = 0.0
    changed_s: float = 0.0
    # Sends messages of a stream without a token and a description, where it is a plain program.
    plain: Any = None
    plain_epoch_ns: int = 0

    @property
    def is_alive(self) -> bool:
        """Whether it publishes, or would if it were not stopped."""
        return (
            self.process is not None
            and not self.process.is_dead
            and self.node is not None
            and not self.is_closed
        )

    @property
    def is_gone(self) -> bool:
        """Whether it has ended."""
        return self.is_closed or (self.process is not None and self.process.is_dead)

    @property
    def moving(self) -> str:
        """The frame that it alone sends."""
        return f"{self.slot}_moving"


class Sent:
    """All series of a history, by their x."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._series: dict[int, Series] = {}

    def note(self, publisher: Publisher, frames: list[str], stamp_ns: int) -> list[Series]:
        """The series of frames that a process sends now with this stamp."""
        newest = publisher.newest_ns
        if any(stamp_ns < newest.get(frame, stamp_ns) - _MOST_BACK_NS for frame in frames):
            publisher.epoch += 1
            newest.clear()
            publisher.series.clear()
        found = []
        for frame in frames:
            newest[frame] = max(newest.get(frame, stamp_ns), stamp_ns)
            series = publisher.series.get(frame)
            if series is None:
                number = next(self._numbers)
                series = Series(
                    round(number + number * _UNEVEN % 1, 6),
                    publisher,
                    frame,
                    publisher.epoch,
                    stamp_ns,
                    stamp_ns,
                )
                publisher.series[frame] = self._series[round(series.x * 1e6)] = series
            series.first_ns = min(series.first_ns, stamp_ns)
            series.last_ns = max(series.last_ns, stamp_ns)
            publisher.ever_sent.add(frame)
            found.append(series)
        return found

    def end(self, publisher: Publisher, frame: str) -> None:
        """The process has removed the frame."""
        publisher.newest_ns.pop(frame, None)
        publisher.series.pop(frame, None)

    def mistake(self, frame: str, stamp_ns: int, x: float, y: float) -> str:
        """Why nobody has sent this value for this stamp; "" where somebody has."""
        series = self.of(x)
        at_s = (stamp_ns - START_NS) / 1e9
        if series is None or series.frame != frame:
            return f"{frame} at {at_s:.3f} has x {x}, which no process sent of it"
        if abs(y - at_s) > 1e-6:
            return f"{frame} at {at_s:.3f} has y {y}"
        if not series.first_ns <= stamp_ns <= series.last_ns:
            return f"{frame} at {at_s:.3f} is of {series.whose}, which sent nothing around then"
        return ""

    def of(self, x: float) -> Series | None:
        """The series of this x, unless it lies between several."""
        number = round(x * 1e6)
        return self._series.get(number) if abs(x * 1e6 - number) < 1e-2 else None
