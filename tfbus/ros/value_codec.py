"""Values to CDR and back, by the type of a message.

A codec is made once for a type; then numbers that follow each other are written and read at once.
"""

import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import isnan
from typing import Any

import msgpack

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError
from tfbus.ros.cdr import HEADER_SIZE, CdrReader, CdrWriter
from tfbus.ros.message_type import (
    BOOL,
    FLOAT,
    NUMBER,
    SCALARS,
    MessageType,
    Rows,
    Scalar,
    Sequence,
    Text,
    Type,
    rows_of,
)
from tfbus.wire.codec import HARMLESS_SIZE, MOST_ITEMS, unpacked, values_in

# The most bytes of numbers in lists. Most take forty bytes each in Python; integers of one byte
# eight, as they are shared: a map of 10,000 by 10,000 cells is read.
_MOST_NUMBERS_BYTES = 1_300_000_000
_NUMBER_BYTES, _SHARED_BYTES = 40, 8

# Of a message within a message, so many numbers count as one more value.
_NUMBERS_A_VALUE = 32

_NATIVE = "<" if sys.byteorder == "little" else ">"


class UnfitError(Exception):
    """A value is not of the type."""


@dataclass(frozen=True)
class ValueCodec:
    """Writes and reads the values of one type, which take at least `least_size` bytes.

    `write` raises UnfitError, `read` DecodeError.
    """

    least_size: int
    write: Callable[[CdrWriter, Any], None]
    read: Callable[["ValueReader"], Any]


class ValueReader(CdrReader):
    """Reads values, and not more of them than memory is for.

    With `arrays` lists of numbers are arrays of numpy (N,), and bytes a memoryview: they share the
    memory of `data`, and cannot be written to.
    """

    def __init__(self, data: bytes, *, arrays: bool = False) -> None:
        super().__init__(data)
        self.arrays = arrays
        self._values = 0
        self._numbers_bytes = 0
        self._packed = 0

    def spend(self, values: int) -> None:
        """Raise DecodeError if the message has more than a million maps, lists and texts."""
        self._values += values
        if self._values > MOST_ITEMS:
            raise DecodeError(f"the message has more than {MOST_ITEMS} values")

    def spend_numbers(self, numbers: int, each: int) -> None:
        """Raise DecodeError if the lists of numbers take more than 1.3 GB, of `each` bytes."""
        self._numbers_bytes += numbers * each
        if self._numbers_bytes > _MOST_NUMBERS_BYTES:
            raise DecodeError(f"the message has too many numbers, {numbers:,} in one list")

    def spend_packed(self, data: bytes) -> None:
        """The same for values in MessagePack, which are counted if they could be many."""
        self._packed += len(data)
        if self._packed > HARMLESS_SIZE:
            self.spend(values_in(data, MOST_ITEMS))


def codec_of(type_: Type, made: dict[str, ValueCodec] | None = None) -> ValueCodec:
    """The codec of a type; `made` has the codecs of messages in it made already, by name."""
    made = {} if made is None else made
    if isinstance(type_, Scalar):
        return _scalar_codec(type_)
    if isinstance(type_, Text):
        return _text_codec(type_.most)
    if isinstance(type_, Sequence):
        return _sequence_codec(type_, made)
    # A list that was empty and one of any values have items of one name.
    name = type_.name if type_.kind != "unknown" else ""
    if name not in made:
        made[name] = _message_codec(type_, made)
    return made[name]


# Numbers


def _check_float(value: Any) -> None:
    if type(value) is not float:
        raise UnfitError


def _check_number(value: Any) -> None:
    if type(value) is not float and (type(value) is not int or not _is_exact(value)):
        raise UnfitError


def _is_exact(value: int) -> bool:
    return -(2**53) <= value <= 2**53 or (abs(value) < 2**1023 and int(float(value)) == value)


def _check_float32(value: Any) -> None:
    _check_float(value)
    if not isnan(value) and struct.unpack("f", struct.pack("f", value))[0] != value:
        raise UnfitError


def _check_bool(value: Any) -> None:
    if type(value) is not bool:
        raise UnfitError


def _check_int(value: Any) -> None:
    if type(value) is not int:
        raise UnfitError


_CHECKS: dict[Scalar, Callable[[Any], None]] = {
    BOOL: _check_bool,
    FLOAT: _check_float,
    NUMBER: _check_number,
    Scalar("float32"): _check_float32,
}
_OF_TYPE = {"bool": bool, "float64": float}


class _ScalarRun:
    """Scalars that follow each other, with the padding between them.

    That depends on where they begin, modulo 8.
    """

    def __init__(self, scalars: list[Scalar]) -> None:
        names = [each.name for each in scalars]
        self._codes = [SCALARS[name] for name in names]
        self._checks = [_CHECKS.get(each, _check_int) for each in scalars]
        self._plain = [_OF_TYPE.get(name, int) for name in names if name != "float32"]
        self._structs: dict[tuple[str, int], struct.Struct] = {}
        self.least_size = sum(map(struct.calcsize, (f"={code}" for code in self._codes)))

    def write(self, writer: CdrWriter, values: list[Any]) -> None:
        if list(map(type, values)) != self._plain:
            for check, value in zip(self._checks, values, strict=True):
                check(value)
        writer.data += self._struct("<", len(writer.data)).pack(*values)

    def read(self, reader: ValueReader) -> tuple[Any, ...]:
        numbers = self._struct(reader.order, reader.at)
        return numbers.unpack_from(reader.data, reader.skip(numbers.size))

    def _struct(self, order: str, at: int) -> struct.Struct:
        start = (at - HEADER_SIZE) % 8
        found = self._structs.get((order, start))
        if found is None:
            parts = [order]
            offset = start
            for code in self._codes:
                size = struct.calcsize(f"={code}")
                padding = -offset % size
                parts.append(f"{padding}x{code}")
                offset += padding + size
            found = self._structs[order, start] = struct.Struct("".join(parts))
        return found


def _scalar_codec(scalar: Scalar) -> ValueCodec:
    numbers = _ScalarRun([scalar])
    return ValueCodec(
        numbers.least_size,
        lambda writer, value: numbers.write(writer, [value]),
        lambda reader: numbers.read(reader)[0],
    )


def _text_codec(most: int) -> ValueCodec:
    def write(writer: CdrWriter, value: Any) -> None:
        if type(value) is not str or (most and len(value.encode()) > most):
            raise UnfitError
        writer.text(value)

    def read(reader: ValueReader) -> str:
        reader.spend(1)
        return reader.text()

    return ValueCodec(4, write, read)


# Sequences


def _sequence_codec(sequence: Sequence, made: dict[str, ValueCodec]) -> ValueCodec:
    size = sequence.size
    if isinstance(sequence.item, Scalar):
        items = _octets if sequence.is_octets else _numbers_codec(sequence.item)
    else:
        items = _items_codec(codec_of(sequence.item, made))
    write_items, read_items, least = items.write, items.read, items.least_size
    most = sequence.most or None
    rows = rows_of(sequence)

    def write(writer: CdrWriter, value: Any) -> None:
        if type(value) is not items.kind and buffer_of(value, sequence) is None:
            if rows is None:
                raise UnfitError
            write_rows(writer, value, rows)
            return
        if size is None:
            if most is not None and len(value) > most:
                raise UnfitError
            writer.count(len(value))
        elif len(value) != size:
            raise UnfitError
        if len(value):
            write_items(writer, value)

    def write_rows(writer: CdrWriter, value: Any, rows: Rows) -> None:
        array = array_of(value, rows)
        if array is None or (most is not None and len(array) > most):
            raise UnfitError
        writer.count(len(array))
        if len(array):
            writer.align(array.itemsize)
            writer.memory(np.ascontiguousarray(array).data.cast("B"))

    def read(reader: ValueReader) -> Any:
        count = reader.count(least) if size is None else size
        if reader.arrays and rows is not None and rows.columns and reader.order == _NATIVE:
            size_of_number = rows.size // len(rows.columns)
            start = reader.skip(count * rows.size, size_of_number) if count else 0
            return rows.of_memory(memoryview(reader.data)[start : start + count * rows.size])
        if size is not None and count * least > reader.left:
            raise DecodeError(f"{count} items should follow, and only {reader.left} bytes do")
        return read_items(reader, count) if count or reader.arrays else items.kind()

    return ValueCodec(4 if size is None else size * least, write, read)


def array_of(value: Any, rows: Rows) -> Any:
    """The array of numpy that is, or has its memory in, a value; None for any other value."""
    if isinstance(value, bytes | memoryview):
        # As a message on the bus has it.
        size = memoryview(value).nbytes
        return None if size % rows.size else rows.of_memory(value)
    return value if rows.is_of(value) else None


# The letters of struct and of numpy for one kind of number.
_SAME_KIND = {letter: kind for kind in ("fd", "bhilqn", "BHILQN", "?") for letter in kind}


def buffer_of(value: Any, sequence: Sequence) -> memoryview | None:
    """The memory of an array whose numbers are exactly of the sequence's type: of array.array,
    numpy or any other with one dimension in this machine's byte order. None for all else.
    """
    if not isinstance(sequence.item, Scalar) or type(value) is list:
        return None
    try:
        view = memoryview(value)
    except (TypeError, ValueError, BufferError):  # no array, or of a type without numbers in Python
        return None
    code = SCALARS[sequence.item.name]
    if view.ndim != 1 or view.itemsize != struct.calcsize(f"={code}"):
        return None
    # numpy marks an array that is not aligned by an order, as one read from a message.
    letter = view.format.removeprefix("=").removeprefix(_NATIVE)
    return view if _SAME_KIND.get(letter) == _SAME_KIND[code] else None


@dataclass(frozen=True)
class _Items:
    """Writes and reads the items of a sequence, without their number; `kind` is list or bytes."""

    kind: type[list[Any]] | type[bytes]
    least_size: int
    write: Callable[[CdrWriter, Any], None]
    read: Callable[[ValueReader, int], Any]


def _write_octets(writer: CdrWriter, value: Any) -> None:
    view = memoryview(value)
    writer.memory(view if view.c_contiguous else memoryview(view.tobytes()))


def _read_octets(reader: ValueReader, count: int) -> bytes | memoryview:
    start = reader.skip(count)
    data = memoryview(reader.data) if reader.arrays else reader.data
    return data[start : start + count]


_octets = _Items(bytes, 1, _write_octets, _read_octets)


# The integers of one byte. Python makes a new object each time for integers below -5, so that
# theirs are kept here.
_OF_OCTET = [*range(128), *range(-128, 0)].__getitem__
_SHARED = bytes([*range(128), *range(251, 256)])


def _numbers_codec(scalar: Scalar) -> _Items:
    name, check = scalar.name, _CHECKS.get(scalar, _check_int)
    code, plain = SCALARS[name], _OF_TYPE.get(name, int)
    size = struct.calcsize(f"={code}")
    each_bytes = _SHARED_BYTES if size == 1 else _NUMBER_BYTES

    def write(writer: CdrWriter, value: Any) -> None:
        if type(value) is not list:
            if _NATIVE == "<":
                writer.align(size)
                view = memoryview(value)
                writer.memory(view.cast("B") if view.c_contiguous else memoryview(view.tobytes()))
                return
            value = value.tolist()
        if name == "float32" or set(map(type, value)) != {plain}:
            for each in value:
                check(each)
        writer.align(size)
        writer.data += struct.pack(f"<{len(value)}{code}", *value)

    def read(reader: ValueReader, count: int) -> Any:
        if not count:  # no padding comes before no numbers
            return np.empty(0, code)
        start = reader.skip(count * size, size)
        if reader.arrays:
            if code == "?":  # not every byte is a boolean
                return np.frombuffer(reader.data, np.uint8, count, start) != 0
            numbers = np.frombuffer(reader.data, f"{reader.order}{code}", count, start)
            return numbers if reader.order == _NATIVE else numbers.astype(code)
        reader.spend_numbers(count, each_bytes)
        if code == "b" and (octets := reader.data[start : reader.at]).translate(None, _SHARED):
            return list(map(_OF_OCTET, octets))
        if reader.order == _NATIVE and code != "?":
            # In half the time and memory: an occupancy grid has millions.
            view: Any = memoryview(reader.data)[start : reader.at]
            return list(view.cast(code))
        return list(struct.unpack_from(f"{reader.order}{count}{code}", reader.data, start))

    return _Items(list, size, write, read)


def _items_codec(item: ValueCodec) -> _Items:
    write_item, read_item = item.write, item.read

    def write(writer: CdrWriter, value: list[Any]) -> None:
        for each in value:
            write_item(writer, each)

    def read(reader: ValueReader, count: int) -> list[Any]:
        return [read_item(reader) for _ in range(count)]

    return _Items(list, item.least_size, write, read)


# Messages


def _message_codec(message: MessageType, made: dict[str, ValueCodec]) -> ValueCodec:
    if message.kind == "msgpack":
        return ValueCodec(4, _write_packed, _read_packed)
    if message.kind == "unknown":
        return ValueCodec(4, _write_nothing, _read_packed)
    if message.kind == "map":
        return _map_codec(message, made)
    if message.kind == "value":
        return codec_of(message.fields[0].type, made)
    return _fields_codec(message, made)


def _fields_codec(message: MessageType, made: dict[str, ValueCodec]) -> ValueCodec:
    keys = [field.key for field in message.fields]
    parts = _parts(message, made)
    is_list = message.kind == "list"
    weight = 1 + sum(isinstance(field.type, Scalar) for field in message.fields) // _NUMBERS_A_VALUE

    def write_values(writer: CdrWriter, values: list[Any]) -> None:
        for first, end, numbers, codec in parts:
            if numbers is not None:
                numbers.write(writer, values[first:end])
            else:
                codec.write(writer, values[first])
        if not values:
            writer.data.append(0)

    def write(writer: CdrWriter, value: Any) -> None:
        if is_list:
            if type(value) is not list or len(value) != len(keys):
                raise UnfitError
            write_values(writer, value)
        elif type(value) is not dict or [*value] != keys:
            raise UnfitError
        else:
            write_values(writer, [value[key] for key in keys])

    def read(reader: ValueReader) -> Any:
        reader.spend(weight)
        values: list[Any] = []
        for _, _, numbers, codec in parts:
            if numbers is not None:
                values += numbers.read(reader)
            else:
                values.append(codec.read(reader))
        if not keys:
            reader.skip(1)
        return values if is_list else dict(zip(keys, values, strict=True))

    least = sum((numbers or codec).least_size for _, _, numbers, codec in parts)
    return ValueCodec(least if keys else 1, write, read)


_Part = tuple[int, int, _ScalarRun | None, ValueCodec]


def _parts(message: MessageType, made: dict[str, ValueCodec]) -> list[_Part]:
    """The fields from one index up to another, either numbers that follow each other, or one."""
    parts: list[_Part] = []
    scalars: list[Scalar] = []
    for at, field in enumerate((*message.fields, None)):
        if field is not None and isinstance(field.type, Scalar):
            scalars.append(field.type)
            continue
        if scalars:
            parts.append((at - len(scalars), at, _ScalarRun(scalars), _nothing))
            scalars = []
        if field is not None:
            parts.append((at, at + 1, None, codec_of(field.type, made)))
    return parts


def _map_codec(message: MessageType, made: dict[str, ValueCodec]) -> ValueCodec:
    entries = message.fields[0].type
    assert isinstance(entries, Sequence) and isinstance(entries.item, MessageType)
    as_list = MessageType(entries.item.name, entries.item.fields, "list")
    codec = _sequence_codec(Sequence(as_list), {**made, as_list.name: _fields_codec(as_list, made)})

    def write(writer: CdrWriter, value: Any) -> None:
        if type(value) is not dict:
            raise UnfitError
        codec.write(writer, [[key, item] for key, item in value.items()])

    def read(reader: ValueReader) -> dict[str, Any]:
        return dict(codec.read(reader))

    return ValueCodec(codec.least_size, write, read)


# MessagePack


def _write_packed(writer: CdrWriter, value: Any) -> None:
    try:
        writer.octets(msgpack.packb(value))
    except (ValueError, TypeError, OverflowError) as error:
        raise UnfitError from error


def _write_nothing(writer: CdrWriter, value: Any) -> None:
    raise UnfitError


_nothing = ValueCodec(0, _write_nothing, lambda reader: None)


def _read_packed(reader: ValueReader) -> Any:
    data = reader.octets()
    reader.spend_packed(data)
    try:
        return unpacked(data, strict_map_key=False)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise DecodeError(f"not msgpack ({type(error).__name__}: {error})") from error
