"""Parts of messages, shortened for people; and filters."""

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any

import click

from tfbus.base.errors import DecodeError
from tfbus.base.wording import did_you_mean
from tfbus.cli.output import OneLine, as_text
from tfbus.messages import CompressedImage, Image, OccupancyGrid, PointCloud
from tfbus.wire.codec import from_map, is_in_ros_layout, without_header
from tfbus.wire.limits import size_text

_PART = re.compile(r"[^.\[\]]+")


@dataclass(frozen=True)
class Shortening:
    """Cuts texts, bytes and lists to at most `longest` (None: not at all).

    Without `lists` or `texts` it shows only their lengths.
    """

    longest: int | None = 128
    lists: bool = True
    texts: bool = True

    @property
    def summarizes(self) -> bool:
        """Whether large data may be a summary: of neither all of it nor its length alone."""
        return self.lists and self.longest is not None

    def shorten(self, value: Any) -> Any:
        """The value with all that is too long cut, also nested; bytes in hexadecimal."""
        if isinstance(value, dict):
            return {key: self.shorten(item) for key, item in value.items()}
        if isinstance(value, list):
            return value if isinstance(value, OneLine) else self._list(value)
        if _is_array(value):
            return self._array(value)
        if isinstance(value, bytes):
            if not (self.texts and self.lists):
                return f"<{len(value)} bytes>"
            return value[: self.longest].hex() + self._mark(value)
        if isinstance(value, str):
            shown = f"<text of {len(value)}>" if not self.texts else value[: self.longest]
            return shown + self._mark(value)
        return value

    def _list(self, items: list[Any]) -> Any:
        if not self.lists:
            return f"<list of {len(items)}>"
        kept = [self.shorten(item) for item in items[: self.longest]]
        return kept if len(kept) == len(items) else [*kept, "..."]

    def _array(self, array: Any) -> Any:
        if not self.lists:
            shape = " by ".join(map(str, array.shape))
            return f"<{array.dtype} array of {shape}>"
        kept = _numbers(array[: self.longest])
        return OneLine(kept if len(kept) == len(array) else [*kept, "..."])

    def _mark(self, value: str | bytes) -> str:
        """The mark of a cut text."""
        return "..." if self.texts and self.longest and len(value) > self.longest else ""


def _is_array(value: object) -> bool:
    return hasattr(value, "dtype")


# Digits take a microsecond or two of each number.
_MOST_SHORT = 100_000


def _numbers(array: Any) -> Any:
    """The numbers of an array; 32-bit floats with the fewest digits that tell them apart, unless
    there are very many.
    """
    # As 64 bits 3.51 would be 3.509999990463257.
    is_short = array.dtype.str[1:] == "f4" and array.size <= _MOST_SHORT
    return (array.astype(str).astype(float) if is_short else array).tolist()


_FIRST_ROWS = 3
_MOST_COLUMNS = 30


def summarized(message: dict[str, Any]) -> dict[str, Any]:
    """The message with a summary in the place of the bytes of a cloud, an image or a map; any other
    as it is.
    """
    for kind, summary in _SUMMARIES.items():
        if {each.name for each in fields(kind)} - {"stamp_ns", "frame_id"} <= message.keys():
            with suppress(DecodeError, ValueError, TypeError):
                return {**message, "data": summary(from_map(kind, message))}
    return message


def _of_cloud(cloud: PointCloud) -> object:
    names = [each.name for each in cloud.fields if each.name][:_MOST_COLUMNS]
    first = [[cloud[name].reshape(len(cloud), -1)[row] for name in names] for row in _rows(cloud)]
    return {
        "points": len(cloud),
        "columns": {name: _span(cloud[name]) for name in names},
        "first": [OneLine([number for part in row for number in _numbers(part)]) for row in first],
    }


def _rows(cloud: PointCloud) -> range:
    return range(min(len(cloud), _FIRST_ROWS))


def _of_image(image: Image) -> str:
    size = f"{image.width} by {image.height}, {image.encoding}, {size_text(len(image.data))}"
    try:
        return f"{size}, {_span(image.pixels())}"
    except ValueError:  # an encoding that is not known
        return size


def _of_compressed_image(image: CompressedImage) -> str:
    return f"{image.format}, {size_text(len(image.data))}"


def _of_grid(grid: OccupancyGrid) -> str:
    size = f"{grid.info.width} by {grid.info.height} cells of {grid.info.resolution:g} m"
    cells = grid.data
    if not len(cells):
        return size
    parts = (("free", cells == 0), ("unknown", cells < 0), ("occupied", cells >= _OCCUPIED))
    return f"{size}: {', '.join(f'{each.mean():.1%} {name}' for name, each in parts)}"


# As map_saver has it.
_OCCUPIED = 65


def _span(numbers: Any) -> str:
    """The type of an array, and its least and greatest number."""
    flat = numbers[numbers == numbers]  # without NaN
    span = f", {flat.min():.6g} to {flat.max():.6g}" if flat.size else ""
    missing = numbers.size - flat.size
    return f"{numbers.dtype}{span}{f', {missing} NaN' if missing else ''}"


_SUMMARIES: Mapping[type[Any], Callable[[Any], object]] = {
    PointCloud: _of_cloud,
    Image: _of_image,
    OccupancyGrid: _of_grid,
    CompressedImage: _of_compressed_image,
}


def part_of(message: Any, path: str) -> Any:
    """The part of a message at `linear.x`, or `transforms[0].frame_id`.

    Raises click.UsageError, with near names, if there is none.
    """
    at = message
    for name in _PART.findall(path):
        is_list = isinstance(at, list) or _is_array(at)
        if is_list and name.isdigit() and int(name) < len(at):
            at = at[int(name)]
            at = _numbers(at) if _is_array(at) else at
        elif isinstance(at, dict) and name in (named := _by_all_names(at)):
            at = named[name]
        else:
            raise click.UsageError(f"there is no field {path!r}{_missing(at, name, path)}")
    return at


def _by_all_names(message: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """The fields by the names that they are printed with, and a header's by ours, too."""
    with suppress(KeyError, TypeError):
        if is_in_ros_layout(message):
            return {**without_header(message), **message}
    return message


def _missing(at: Any, name: str, path: str) -> str:
    if isinstance(at, list) or _is_array(at):
        return f": {name!r} is not an index of a list of {len(at)}"
    if isinstance(at, dict):
        part = "" if name == path else f": no {name!r}"
        return f"{part}{did_you_mean(name, map(str, at), none=', nor any other')}"
    return f": the value there has no fields, so no {name!r}"


def csv_row(value: Any) -> str:
    """All values of a message in order, separated by commas."""
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(
        as_text(leaf) if isinstance(leaf, str) else leaf for leaf in _leaves(value)
    )
    return text.getvalue()


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        value = list(value.values())
    if _is_array(value):
        value = _numbers(value)
    if isinstance(value, list):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


class MessageFilter:
    """A Python expression about `m`, a message, which takes messages if it is true: `m.x > 5`."""

    def __init__(self, expression: str):
        self._expression = expression
        try:
            self._code = compile(expression, "--filter", "eval")
        except SyntaxError as error:
            raise click.UsageError(
                f"--filter {expression!r} is not a Python expression: {error.msg}"
            ) from error

    def takes(self, message: dict[str, Any]) -> bool:
        """Whether the expression is true. Raises click.UsageError if it fails."""
        try:
            return bool(eval(self._code, {"m": _Fields(message)}))
        except Exception as error:
            raise click.UsageError(
                f"--filter {self._expression!r} fails: {type(error).__name__}: {error}"
            ) from error


class _Fields:
    """A map whose values are attributes, also nested ones."""

    def __init__(self, values: dict[str, Any]):
        self._values = values

    def __getattr__(self, name: str) -> Any:
        values = _by_all_names(self._values)
        if name not in values:
            raise AttributeError(f"no field {name!r}{did_you_mean(name, self._values, none='')}")
        return _as_fields(values[name])


def _as_fields(value: Any) -> Any:
    if isinstance(value, list):
        return [_as_fields(item) for item in value]
    return _Fields(value) if isinstance(value, dict) else value
