"""Joint states of files: CSV, and recordings."""

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from tfbus import Recording, Robot, TfbusError
from tfbus.command import install_command
from tfbus.messages import JointState
from tfbus.wording import counted, did_you_mean, listed, printable

from .motions import Row, Table

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
    """The columns of joints by name, and what tells the seconds of a row from its numbers."""
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
