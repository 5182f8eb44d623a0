"""Lines of numbers in text files, with errors that name the line."""

import math
import re
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation

from tfbus.core.kernel import LONGEST_NS, QUATERNION_TOLERANCE
from tfbus.errors import DecodeError
from tfbus.trajectory.trajectory import FilePath
from tfbus.wording import printable

# Longer lines are not of such a file: another kind of file may have no line break at all.
_LONGEST_LINE = 100_000

_NS_DIGITS = 9

# Seconds as people write them.
_DECIMAL = re.compile(r"-?\d{1,10}\.\d*|-?\d\.\d+e\+?0?9", re.ASCII)


def lines_of(path: FilePath, *, comments: bool = True) -> Iterator[tuple[int, str]]:
    """The lines of a UTF-8 file with their numbers; with `comments` without those that are empty
    or begin with `#`.

    Raises DecodeError for a file that is not text, and OSError.
    """
    number = 0
    with open(path, encoding="utf-8-sig", newline="" if not comments else None) as file:
        try:
            while line := file.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE or "\0" in line:
                    raise DecodeError(f"{path}, line {number}: not a text file of poses")
                if not comments or (line.strip() and not line.lstrip().startswith("#")):
                    yield number, line
        except UnicodeDecodeError as error:
            raise DecodeError(f"{path}, line {number + 1}: not UTF-8 text") from error


def finite(text: str, where: str) -> float:
    """The number of a text. Raises DecodeError for another text, infinity and NaN."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise DecodeError(f"{where}: expected a finite number, got {printable(text, 40)!r}")
    return number


def pose_of(fields: Iterable[str], where: str) -> list[float]:
    """The seven numbers x, y, z, qx, qy, qz, qw of a pose. Raises DecodeError."""
    pose = [finite(field, where) for field in fields]
    if not abs(sum([part * part for part in pose[3:]]) - 1.0) < QUATERNION_TOLERANCE:
        raise DecodeError(f"{where}: expected a quaternion qx qy qz qw with norm 1, got {pose[3:]}")
    return pose


def whole_stamp(text: str, where: str) -> int:
    """A stamp in nanoseconds. Raises DecodeError if it is none."""
    try:
        stamp_ns = int(text)
    except ValueError:
        stamp_ns = LONGEST_NS
    if not -LONGEST_NS < stamp_ns < LONGEST_NS:
        what = "; is it in seconds?" if _DECIMAL.fullmatch(text.strip()) else ""
        raise DecodeError(
            f"{where}: expected a stamp in whole nanoseconds since 1970, within 146 years of it, "
            f"got {printable(text, 40)!r}{what}"
        )
    return stamp_ns


def decimal_stamp(text: str, where: str) -> int:
    """A stamp in seconds, in nanoseconds: not by way of a float, which rounds to 0.2 us.

    Raises DecodeError if it is none.
    """
    try:
        seconds = Decimal(text)
        # Before the digits are written out: 1e999999999 is a short text.
        is_near = seconds.is_finite() and seconds.adjusted() < len(str(LONGEST_NS))
    except InvalidOperation:
        is_near = False
    stamp_ns = int(seconds.scaleb(_NS_DIGITS).to_integral_value()) if is_near else LONGEST_NS
    if not -LONGEST_NS < stamp_ns < LONGEST_NS:
        what = "; is it in nanoseconds?" if text.isdecimal() else ""
        raise DecodeError(
            f"{where}: expected a timestamp in seconds since 1970, within 146 years of it, got "
            f"{printable(text, 40)!r}{what}"
        )
    return stamp_ns
