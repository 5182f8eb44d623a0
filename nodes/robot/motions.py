"""How joints move by themselves: through their limits, to random places, or as a table says.

A motion gives the positions at a time in seconds since it began.
"""

import math
import random
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from .ranges import Range

# Where the clock jumps further, as when simulated time is set, motions leave out what lies between.
_LONGEST_JUMP_S = 600.0

# The same for tables, of which each row is a message.
_LONGEST_JUMP_OF_ROWS_S = 10.0


class Motion(Protocol):
    """The positions of joints at a time."""

    def at(self, seconds: float) -> Mapping[str, float]:
        """The positions of joints at a time that does not go back."""


class Sweep:
    """Moves each joint smoothly from limit to limit and back, not faster than it may."""

    def __init__(self, ranges: Iterable[Range]) -> None:
        self._ranges = list(ranges)
        self._phases = [_phase(each) for each in self._ranges]

    def at(self, seconds: float) -> dict[str, float]:
        """The positions; it begins where the joints rest."""
        found = {}
        for each, phase in zip(self._ranges, self._phases, strict=True):
            half = 0.5 * each.width
            # The greatest speed of a cosine of this amplitude.
            turned = seconds * each.speed / half if half else 0.0
            found[each.name] = each.lower + half * (1.0 - math.cos(phase + turned))
        return found


def _phase(each: Range) -> float:
    if not each.width:
        return 0.0
    return math.acos(min(1.0, max(-1.0, 1.0 - 2.0 * (each.rest - each.lower) / each.width)))


class RandomPlaces:
    """Moves all joints to a random place within their limits, then to the next.

    They come there together, none faster than it may, and rest for a moment. The same `seed` gives
    the same places.
    """

    REST_S = 0.5

    def __init__(self, ranges: Iterable[Range], seed: int | None = None) -> None:
        self._ranges = list(ranges)
        self._random = random.Random(seed)
        self._from = {each.name: each.rest for each in self._ranges}
        self._began_s = 0.0
        self._choose()

    def at(self, seconds: float) -> dict[str, float]:
        """The positions."""
        if seconds > self._began_s + _LONGEST_JUMP_S:
            self._began_s = seconds
        while seconds >= self._began_s + self._lasts_s + self.REST_S:
            self._began_s += self._lasts_s + self.REST_S
            self._from = self._to
            self._choose()
        part = min(1.0, max(0.0, seconds - self._began_s) / self._lasts_s)
        eased = part * part * (3.0 - 2.0 * part)
        return {
            name: start + eased * (self._to[name] - start) for name, start in self._from.items()
        }

    def _choose(self) -> None:
        self._to = random_places(self._ranges, self._random)
        # The greatest speed on the way is 1.5 times the mean one.
        times = [
            1.5 * abs(self._to[each.name] - self._from[each.name]) / each.speed
            for each in self._ranges
        ]
        self._lasts_s = max([0.1, *times])


def random_places(ranges: Iterable[Range], source: random.Random | None = None) -> dict[str, float]:
    """A random position within the limits of each joint."""
    uniform = (source or random).uniform
    return {each.name: uniform(each.lower, each.upper) for each in ranges}


@dataclass(frozen=True)
class Row:
    """A joint state of a table; `seconds` count from any time."""

    seconds: float
    positions: Mapping[str, float]
    velocities: Mapping[str, float] = field(default_factory=dict)
    efforts: Mapping[str, float] = field(default_factory=dict)


class Table:
    """The rows of a file or recording, one after the other, in order of time.

    With `loops` it begins again after its end, else the last row stays. After a jump of the clock
    by more than 10 s it goes on at the row of that time.
    """

    def __init__(self, rows: Sequence[Row], *, loops: bool = False) -> None:
        self._rows = rows
        self._loops = loops
        self._round = 0
        self._next = 0

    @property
    def lasts_s(self) -> float:
        """From the first row to the last, and one step further."""
        first, last = self._rows[0].seconds, self._rows[-1].seconds
        step = (last - first) / max(1, len(self._rows) - 1)
        return last - first + (step or 1.0)

    @property
    def has_ended(self) -> bool:
        """Whether the last row was given, and it does not begin again."""
        return not self._loops and self._next >= len(self._rows)

    def due(self, seconds: float) -> list[tuple[float, Row]]:
        """The rows up to a time since it began that were not given yet, each after its own time."""
        found: list[tuple[float, Row]] = []
        if not self.has_ended and seconds > self._time_of_next() + _LONGEST_JUMP_OF_ROWS_S:
            self._skip_to(seconds)
        while not self.has_ended and (time := self._time_of_next()) <= seconds:
            found.append((time, self._rows[self._next]))
            self._next += 1
            if self._loops and self._next == len(self._rows):
                self._next = 0
                self._round += 1
        return found

    def _skip_to(self, seconds: float) -> None:
        if self._loops:
            self._round, seconds = int(seconds // self.lasts_s), seconds % self.lasts_s
        later = bisect_right(
            self._rows, self._rows[0].seconds + seconds, key=lambda row: row.seconds
        )
        self._next = max(0, later - 1)

    def _time_of_next(self) -> float:
        row = self._rows[self._next]
        return self._round * self.lasts_s + row.seconds - self._rows[0].seconds
