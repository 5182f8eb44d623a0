"""CDR, the bytes of ROS 2's messages: numbers, texts and sequences, each at its alignment.

The version is ROS 2's, plain CDR 1: https://www.omg.org/spec/DDSI-RTPS/2.5, section 10.
Bytes are written little-endian and read in both orders.
"""

import struct

from tfbus.base.errors import DecodeError
from tfbus.base.wording import counted, printable

# The head of a message: the way it is encoded, and two bytes that say nothing here. All alignment
# counts from behind it.
HEADER = b"\x00\x01\x00\x00"
HEADER_SIZE = len(HEADER)

_BIG_ENDIAN, _LITTLE_ENDIAN = 0, 1
_OTHER_ENCODINGS = {
    2: "a parameter list",
    3: "a parameter list",
    6: "XCDR2",
    7: "XCDR2",
    8: "XCDR2",
    9: "XCDR2",
    10: "XCDR2",
    11: "XCDR2",
}

# Writers may fill up a message to a multiple of four bytes.
_MOST_PADDING = 3

_U32 = struct.Struct("<I")
_MOST_ALIGNED = 8
_ZEROS = bytes(_MOST_ALIGNED)

_LARGE = 16 * 1024


class CdrWriter:
    """Writes one message, field after field.

    `data` is its end: large memory, and all before it, are joined with that by `message` alone.
    Alignment counts by the length of `data`, which therefore begins with bytes that stand for the
    former ones.
    """

    def __init__(self) -> None:
        self.data = bytearray(HEADER)
        self._former: list[memoryview] = []
        self._stand_in = 0

    def message(self) -> bytes:
        """The whole message."""
        return b"".join((*self._former, memoryview(self.data)[self._stand_in :]))

    def memory(self, numbers: memoryview) -> None:
        """The memory of numbers, aligned already, and maybe large: to copy a megabyte once more
        takes longer than all the rest.
        """
        if numbers.nbytes < _LARGE:
            self.data += numbers
            return
        self._former += (memoryview(self.data)[self._stand_in :], numbers)
        self._stand_in = (len(self.data) + numbers.nbytes) % _MOST_ALIGNED
        self.data = bytearray(self._stand_in)

    def align(self, size: int) -> None:
        """Fill up to a multiple of `size` bytes, a power of two."""
        self.data += _ZEROS[: (HEADER_SIZE - len(self.data)) % size]

    def count(self, count: int) -> None:
        """How many items of a sequence, or bytes of a text, follow."""
        self.align(4)
        self.data += _U32.pack(count)

    def text(self, text: str) -> None:
        """A text, which ends in a zero. Raises UnicodeEncodeError for one that is not Unicode."""
        encoded = text.encode()
        self.count(len(encoded) + 1)
        self.data += encoded
        self.data.append(0)

    def octets(self, octets: bytes) -> None:
        """A sequence of bytes."""
        self.count(len(octets))
        self.data += octets


class CdrReader:
    """Reads one message, field after field; all its methods raise DecodeError alone.

    `order` is the byte order of the message as struct has it, `at` the place of the next field.
    """

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.end = len(data)
        self.at = HEADER_SIZE
        self.order = "<" if _encoding(data) == _LITTLE_ENDIAN else ">"
        self._u32 = struct.Struct(f"{self.order}I")

    @property
    def left(self) -> int:
        """How many bytes are left."""
        return self.end - self.at

    def skip(self, size: int, align: int = 1) -> int:
        """Pass `size` bytes that begin at a multiple of `align`; where they begin."""
        start = self.at + (HEADER_SIZE - self.at) % align
        if size > self.end - start:
            raise DecodeError(
                f"the message ends too early: {counted(size, 'byte')} should begin at byte "
                f"{start}, and it has {self.end}"
            )
        self.at = start + size
        return start

    def u32(self) -> int:
        """An unsigned integer of 32 bits."""
        number: int = self._u32.unpack_from(self.data, self.skip(4, 4))[0]
        return number

    def count(self, least_size: int) -> int:
        """How many items of a sequence follow, each of at least `least_size` bytes."""
        count = self.u32()
        if count * least_size > self.left:
            raise DecodeError(
                f"a sequence of {count} items, and only {counted(self.left, 'byte')} left"
            )
        return count

    def text(self) -> str:
        """A text."""
        size = self.u32()
        start = self.skip(size)
        if size and self.data[self.at - 1]:
            raise DecodeError(f"the text at byte {start} does not end in a zero")
        # Without the zero. Some write an empty text as no bytes at all.
        text = self.data[start : start + max(size - 1, 0)]
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            shown = printable(text[:61].decode(errors="backslashreplace"), 60)
            raise DecodeError(f"the text '{shown}' at byte {start} is not UTF-8") from error

    def octets(self) -> bytes:
        """A sequence of bytes."""
        size = self.u32()
        start = self.skip(size)
        return self.data[start : start + size]

    def finish(self) -> None:
        """Raise DecodeError if more follows than bytes that fill up."""
        if self.left > _MOST_PADDING:
            raise DecodeError(f"the message has {counted(self.left, 'byte')} more than its type")


def _encoding(data: bytes) -> int:
    if len(data) < HEADER_SIZE:
        raise DecodeError(f"{len(data)} bytes are no CDR message: its header has {HEADER_SIZE}")
    kind = int.from_bytes(data[:2], "big")
    if kind in (_BIG_ENDIAN, _LITTLE_ENDIAN):
        return kind
    other = _OTHER_ENCODINGS.get(kind, f"0x{kind:04x}")
    raise DecodeError(
        f"the message is encoded as {other}: only plain CDR is read, as ROS 2 writes it"
    )
