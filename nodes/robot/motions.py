"""Motions of joints: sweeps, random places, and tables of positions, read from files."""

import csv
import math
import random
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from tfbus import Recording, Robot, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.wording import counted, did_you_mean, listed, printable
from tfbus.messages import JointState

from .ranges import Range

# If the clock jumps further, as when simulated time is set, motions leave out the time between.
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


# Columns with the time: in seconds, and in nanoseconds.
_SECONDS = ("time", "t", "time_s", "seconds", "stamp", "timestamp")
_NANOSECONDS = ("stamp_ns", "time_ns", "timestamp_ns", "ns")

_MOST_ROWS = 5_000_000

# Rows that come faster than this, as a loop for ever, leave no time for anything else.
_MOST_HZ = 10_000.0


class TableError(TfbusError):
    """A table of joint states that cannot be read; the message says where and why."""


def rows_of_csv(path: Path, robot: Robot, rate_hz: float) -> list[Row]:
    """The rows of a CSV file: a column for each joint, headed by its name, in rad or m.

    A column `time` has seconds, `stamp_ns` nanoseconds; without one the rows come at `rate_hz`.
    Other columns are refused, so that no joint is missed for a misspelt name. Raises TableError.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            columns, seconds_of = _columns(path, header, robot, rate_hz)
            rows: list[Row] = []
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                where = f"{path}:{reader.line_num}"
                if len(cells) != len(header):
                    raise TableError(
                        f"{where}: {counted(len(cells), 'value')} under "
                        f"{counted(len(header), 'column')}"
                    )
                numbers = [
                    _number(where, name, cell) for name, cell in zip(header, cells, strict=True)
                ]
                seconds = seconds_of(numbers, len(rows))
                if rows and seconds < rows[-1].seconds:
                    raise TableError(f"{where}: the time goes back, to {seconds:.9g} s")
                rows.append(Row(seconds, {name: numbers[at] for name, at in columns.items()}))
                if len(rows) > _MOST_ROWS:
                    raise TableError(f"{path}: more than {_MOST_ROWS:,} rows")
    except OSError as error:
        raise TableError(f"cannot read {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TableError(f"{path} is no CSV file: {error}") from error
    if not rows:
        raise TableError(f"{path} has no rows of numbers below its header")
    return rows


def _columns(
    path: Path, header: Sequence[str], robot: Robot, rate_hz: float
) -> tuple[dict[str, int], Callable[[list[float], int], float]]:
    """The columns of joints by name, and a function that gives the seconds of a numbered row."""
    joints: dict[str, int] = {}
    time: tuple[int, float] | None = None
    for at, name in enumerate(header):
        if name in robot.joints:
            if robot.joints[name].position_size != 1:
                raise TableError(f"{path}:1: joint '{name}' has no position of one number")
            if name in joints:
                raise TableError(f"{path}:1: joint '{name}' has two columns")
            joints[name] = at
        elif name.lower() in _SECONDS and time is None:
            time = at, 1.0
        elif name.lower() in _NANOSECONDS and time is None:
            time = at, 1e-9
        else:
            known = [joint for joint in robot.joints if robot.joints[joint].position_size == 1]
            raise TableError(
                f"{path}:1: the robot has no joint '{printable(name, 60)}'"
                f"{did_you_mean(name, known)}"
            )
    if not joints:
        raise TableError(f"{path}:1: no column of a joint: the first line has their names")
    if time is None:
        return joints, lambda numbers, count: count / rate_hz
    column, unit = time
    return joints, lambda numbers, count: numbers[column] * unit


def _number(where: str, name: str, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise TableError(
            f"{where}: '{printable(cell, 40)}' in column '{printable(name, 60)}' is no finite "
            "number"
        )
    return number


def rows_of_recording(paths: Sequence[Path], topic: str) -> list[Row]:
    """The joint states of a recording, at the times when they were received. Raises TableError."""
    rows: list[Row] = []
    try:
        with Recording(*paths) as recording:
            names = [each.name for each in recording.topics]
            if topic not in names:
                near = [name for name in names if name.rpartition("/")[2] == "joint_states"]
                raise TableError(
                    f"the recording has no topic {topic!r}"
                    + (f"; --bag-topic {near[0]}" if near else f"; it has {listed(names)}")
                )
            for log_ns, state in recording.messages(topic, JointState):
                rows.append(_row(log_ns, state))
    except ImportError as error:
        raise TableError(
            f"--bag needs {error.name or 'mcap'}, which is not installed: {install_command('bag')}"
        ) from error
    except OSError as error:
        raise TableError(
            f"cannot read {listed(list(map(str, paths)))}: {error.strerror}"
        ) from error
    if not rows:
        raise TableError(f"topic {topic!r} of the recording has no messages")
    return rows


def check_loop(rows: list[Row]) -> list[Row]:
    """The rows, which a loop repeats for ever. Raises TableError if they come too fast."""
    if len(rows) / Table(rows).lasts_s > 1.001 * _MOST_HZ:
        raise TableError(
            f"{counted(len(rows), 'row')} in {Table(rows).lasts_s:.3g} s cannot be looped: "
            f"{_MOST_HZ:,.0f} rows a second are the most"
        )
    return rows


def _row(log_ns: int, state: JointState) -> Row:
    return Row(
        log_ns / 1e9,
        dict(zip(state.name, state.position, strict=False)),
        dict(zip(state.name, state.velocity, strict=False)),
        dict(zip(state.name, state.effort, strict=False)),
    )
