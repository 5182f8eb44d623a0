"""Reads msgpack payloads, and counts their values before they are made.

A value of one byte takes up to seventy bytes in Python: 8 MB of empty maps took 600 MB. The size of
a payload alone does not bound that; the number of its values does.
"""

from typing import Any

import msgpack

# More are refused: they take at most some ten megabytes, and a fraction of a second to read.
MOST_ITEMS = 1_000_000

# A payload of this size cannot hold enough values to harm.
HARMLESS_SIZE = 64 * 1024


def unpacked(data: bytes, *, strict_map_key: bool = True) -> Any:
    """The value in the bytes. Messages have no extensions: a time of msgpack's is taken as its
    nanoseconds. Raises what msgpack does, and ValueError for other extensions.
    """
    return msgpack.unpackb(
        data, strict_map_key=strict_map_key, timestamp=_AS_NANOSECONDS, ext_hook=_refuse_extension
    )


_AS_NANOSECONDS = 2


def _refuse_extension(code: int, data: bytes) -> object:
    raise ValueError(f"it has an extension of type {code}")


# Stands for a binary that is left where it is, with its number.
_LEFT = 100
_AS_LEFT = b"\xd6" + bytes([_LEFT])


def unpacked_in_place(data: bytes) -> Any:
    """As `unpacked`, but each binary of 4 kB or more is a memoryview of the payload: nothing of it
    is copied. A payload of at most 64 KiB is copied whole.
    """
    if len(data) <= HARMLESS_SIZE:
        return unpacked(data)
    binaries: list[tuple[int, int, int]] = []
    values_in(data, MOST_ITEMS, binaries)
    if not binaries or binaries[-1][2] > len(data):
        return unpacked(data)
    pieces: list[bytes] = []
    at = 0
    for number, (head, _, end) in enumerate(binaries):
        pieces += (data[at:head], _AS_LEFT, number.to_bytes(4, "big"))
        at = end
    pieces.append(data[at:])
    whole = memoryview(data)

    def left(code: int, number: bytes) -> object:
        # A payload may have such an extension, too; it has no number as ours.
        at = int.from_bytes(number, "big")
        if code != _LEFT or len(number) != 4 or at >= len(binaries):
            return _refuse_extension(code, number)
        _, start, end = binaries[at]
        return whole[start:end]

    return msgpack.unpackb(
        b"".join(pieces), strict_map_key=True, timestamp=_AS_NANOSECONDS, ext_hook=left
    )


# A binary of so many bytes is not worth a copy.
_LARGE = 4096


def too_many_items(data: bytes, most: int = MOST_ITEMS) -> str:
    """Why the payload is not read, as a sentence; "" if it has at most `most` values.

    Binary data and text are one value, however long. Bytes that are no msgpack are not found here.
    """
    if len(data) <= HARMLESS_SIZE or values_in(data, most) <= most:
        return ""
    return f"it has more than {most} values; send many numbers as bytes"


# By the first byte of a value: how many bytes follow, or how many values, or how wide the length is
# that follows. https://github.com/msgpack/msgpack/blob/master/spec.md#formats
_BYTES = [0] * 256
_VALUES = [0] * 256
_LENGTH_WIDTH = [0] * 256
_BINARIES = range(0xC4, 0xC7)
_EXTENSIONS = range(0xC7, 0xCA)
_ARRAYS = range(0xDC, 0xDE)
_MAPS = range(0xDE, 0xE0)


def _fill_tables() -> None:
    _VALUES[0x80:0x90] = range(0, 32, 2)  # maps
    _VALUES[0x90:0xA0] = range(16)  # arrays
    _BYTES[0xA0:0xC0] = range(32)  # texts
    _LENGTH_WIDTH[0xC4:0xCA] = (1, 2, 4, 1, 2, 4)  # binary data, extensions
    _BYTES[0xCA:0xD4] = (4, 8, 1, 2, 4, 8, 1, 2, 4, 8)  # floats and integers
    _BYTES[0xD4:0xD9] = (2, 3, 5, 9, 17)  # extensions of one size, with their type
    _LENGTH_WIDTH[0xD9:0xE0] = (1, 2, 4, 2, 4, 2, 4)  # texts, arrays, maps


_fill_tables()


def values_in(data: bytes, most: int, binaries: list[tuple[int, int, int]] | None = None) -> int:
    """How many values the payload says it has; if they are more than `most`, some number above
    it. `binaries` gets the places of binaries of 4 kB or more: of the head, the data and the end.
    """
    at, end = 0, len(data)
    seen, announced = 0, 1
    while announced and at < end:
        head = data[at]
        at += 1 + _BYTES[head]
        seen += 1
        announced += _VALUES[head] - 1
        if width := _LENGTH_WIDTH[head]:
            length = int.from_bytes(data[at : at + width], "big")
            at += width
            if head in _ARRAYS:
                announced += length
            elif head in _MAPS:
                announced += 2 * length
            else:
                at += length + (head in _EXTENSIONS)
                if length >= _LARGE and head in _BINARIES and binaries is not None:
                    binaries.append((at - length - width - 1, at - length, at))
        if seen + announced > most:
            break
    return seen + announced
