"""Messages of one topic, most of which differ from the one before in their stamp and bytes only.

To make a map of a cloud or an image, pack it, read it and check each field takes longer than all
else that is done with the message. A message of the form of a former one is that one's bytes
around a stamp and an array of the same length, and needs none of that.
"""

from collections.abc import Callable
from operator import attrgetter
from typing import Any, Generic, NamedTuple, TypeVar

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError
from tfbus.wire.codec import bytes_that_change, decode_message, encode_message

M = TypeVar("M")

# The parts of a stamp as msgpack has them after 1970, in 4 bytes each; others have no form.
_SEC, _NANOSEC = b"\xa3sec\xce", b"\xa7nanosec\xce"
_LEAST, _MOST = 2**16, 2**32
_STAMP_SIZE = 4 + len(_NANOSEC) + 4
_SECOND_NS = 1_000_000_000

# A stamp is among the first bytes.
_LATEST = 200

# Forms are worth nothing where each message has another, and little of large messages.
_MOST_FORMS = 20
_LARGEST = 1_000_000


class _Form(NamedTuple):
    """Messages of `size` bytes: `head`, the stamp, `middle`, the array of `length` bytes, `tail`;
    `others` are the values of their other fields, and `kinds` the types of these.
    """

    size: int
    head: bytes
    middle: bytes
    length: int
    tail: bytes
    others: tuple[Any, ...]
    kinds: tuple[type, ...]


class _Forms(Generic[M]):
    """The last form of messages of a type; of types without an array that changes there is none."""

    def __init__(self, message_type: type[M]) -> None:
        self._type = message_type
        self._array, self._kind, self._names = bytes_that_change(message_type)
        self._form: _Form | None = None
        self._left = _MOST_FORMS if self._array else 0

    def _learn(self, data: bytes, message: M) -> None:
        """Take the form of a message; none if its stamp or its array are there in another way."""
        self._left -= 1
        head = data.find(_SEC, 0, _LATEST) + len(_SEC)
        key = data.find(bytes((0xA0 + len(self._array),)) + self._array.encode(), head)
        begin = key + 1 + len(self._array)
        begin += {0xC4: 2, 0xC5: 3, 0xC6: 5}.get(data[begin], 0)
        length = len(getattr(message, self._array))
        middle, tail = data[head + _STAMP_SIZE : begin], data[begin + length :]
        others = tuple(getattr(message, name) for name in self._names)
        kinds = tuple(map(type, others))
        form = _Form(len(data), data[:head], middle, length, tail, others, kinds)
        self._form = form if self._holds(form, data[begin : begin + length]) else None

    def _holds(self, form: _Form, array: bytes) -> bool:
        """Whether `decode_message` reads another stamp, and the opposite of all bytes of the array,
        from where they are in this form.
        """
        changed = np.bitwise_not(np.frombuffer(array, np.uint8))
        data = _joined(form, b"\x12\x34\x56\x78", b"\x00\x12\x34\x56", changed)
        try:
            return len(data) == form.size and bool(
                decode_message(self._type, data) == self._read(form, data)
            )
        except DecodeError:
            return False

    def _read(self, form: _Form, data: bytes) -> M:
        at = len(form.head)
        after = at + _STAMP_SIZE
        sec = int.from_bytes(data[at : at + 4], "big")
        nanosec = int.from_bytes(data[after - 4 : after], "big")
        made = object.__new__(self._type)
        put: Callable[[Any, str, Any], None] = object.__setattr__
        for name, value in zip(self._names, form.others):  # noqa: B905  # slower if strict
            put(made, name, value)
        put(made, "stamp_ns", sec * _SECOND_NS + nanosec)
        begin = after + len(form.middle)
        put(made, self._array, np.frombuffer(data, self._kind, form.length, begin))
        return made


def _joined(form: _Form, sec: bytes, nanosec: bytes, array: Any) -> bytes:
    return b"".join((form.head, sec, _NANOSEC, nanosec, form.middle, array, form.tail))


class Decoder(_Forms[M]):
    """Reads the messages of a topic, as `decode_message` does; safe from any thread."""

    def decode(self, data: bytes) -> M:
        """The message in the bytes. Raises DecodeError as `decode_message`."""
        form = self._form
        if (
            form is not None
            and len(data) == form.size
            and data.startswith(form.head)
            and data.startswith(form.middle, len(form.head) + _STAMP_SIZE)
            and data.startswith(_NANOSEC, len(form.head) + 4)
            and data.endswith(form.tail)
        ):
            return self._read(form, data)
        message = decode_message(self._type, data)
        if self._left and len(data) <= _LARGEST:
            self._learn(data, message)
        return message


class Encoder(_Forms[M]):
    """Makes the bytes of messages of a topic, as `encode_message` does; safe from any thread."""

    def __init__(self, message_type: type[M]) -> None:
        super().__init__(message_type)
        self._others_of = attrgetter(*self._names, self._array) if self._array else None

    def encode(self, message: M) -> bytes:
        """The bytes of a message. Raises BusError as `encode_message`."""
        if self._others_of is None or message.__class__ is not self._type:
            return encode_message(message)
        form = self._form
        if form is not None:
            *others, array = self._others_of(message)
            if (
                len(array) == form.length
                and (*others,) == form.others
                and (*map(type, others),) == form.kinds
            ):
                stamp_ns: Any = message.stamp_ns  # type: ignore[attr-defined]
                sec, nanosec = divmod(stamp_ns, _SECOND_NS)
                if type(stamp_ns) is int and _LEAST <= sec < _MOST and nanosec >= _LEAST:
                    stamp = sec.to_bytes(4, "big"), nanosec.to_bytes(4, "big")
                    return _joined(form, *stamp, array)
        data = encode_message(message)
        if self._left and len(data) <= _LARGEST:
            self._learn(data, message)
        return data
