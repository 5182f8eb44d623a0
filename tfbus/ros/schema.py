"""Messages of topics as messages of ROS: a definition for each type, and the bytes in both
directions.
"""

import struct
from collections.abc import Mapping
from typing import Any

from tfbus import messages
from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.ros.cdr import CdrWriter
from tfbus.ros.counterparts import AS_IN_ROS, COUNTERPARTS, Counterpart, fitted
from tfbus.ros.definition_text import definition_of, message_of
from tfbus.ros.definitions import Definition
from tfbus.ros.inferred import (
    have_same_keys,
    merged_fields,
    packed_in,
    type_of_dataclass,
    type_of_values,
)
from tfbus.ros.message_type import FLOAT, MSGPACK, NUMBER, MessageType, TypeNames
from tfbus.ros.value_codec import UnfitError, ValueReader, codec_of
from tfbus.wire.codec import type_name as name_of
from tfbus.wording import printable

# Of one type of message. A publisher that sends more forms than these has no type to speak of.
_MOST_CODECS = 8


class MessageCodec:
    """Writes and reads the messages of one type, as maps of their fields.

    `definition` is the type as ROS 2 has it. A value comes back as it was: integers of 64 bits,
    floats, texts, bytes, lists and maps with the order of their keys, bit by bit. Only if the
    type is that of a dataclass, an integer in a field of floats comes back as the float that is the
    same number.
    """

    def __init__(
        self, message: MessageType, definition: Definition, counterpart: Counterpart | None = None
    ) -> None:
        self._message = message
        self._codec = codec_of(message)
        self._counterpart = counterpart
        self.definition = definition

    @staticmethod
    def of_type(message_type: type, names: TypeNames | None = None) -> "MessageCodec":
        """The codec of a dataclass, that of ROS's own type if it has one that says the same.
        Messages get names of their own among `names`.
        """
        name = name_of(message_type)
        if message_type is getattr(messages, message_type.__name__, None):  # not one of its name
            if (as_in_ros := AS_IN_ROS.get(name)) is not None:
                return MessageCodec.of_definition(as_in_ros.definition)
            if (counterpart := COUNTERPARTS.get(name)) is not None:
                return MessageCodec.of_definition(counterpart.definition, counterpart)
        return _codec(type_of_dataclass(message_type), names)

    @staticmethod
    def of_values(
        type_name: str, values: Mapping[str, Any], names: TypeNames | None = None
    ) -> "MessageCodec":
        """The codec that the values of one message of an unknown type suggest; RAW if ROS
        cannot express them as fields.
        """
        return _codec(type_of_values(type_name, values), names)

    @staticmethod
    def of_definition(
        definition: Definition, counterpart: Counterpart | None = None
    ) -> "MessageCodec":
        """The codec of a type of a file: any type of ROS 2, or one of ours. Its values are those of
        our `counterpart`, if there is one.

        Raises DecodeError if the definition is not valid, or has a wstring.
        """
        return MessageCodec(message_of(definition), definition, counterpart)

    @property
    def is_of_ros(self) -> bool:
        """Whether the type is ROS's own, which has our values under other names."""
        return self._counterpart is not None

    def encode(self, values: Mapping[str, Any]) -> bytes | None:
        """The message with these values; None if they are not of this type."""
        writer = CdrWriter()
        try:
            if self._counterpart is not None:
                values = self._counterpart.to_ros(values)
            self._codec.write(writer, values if type(values) is dict else dict(values))
        except (UnfitError, struct.error, OverflowError, UnicodeEncodeError):
            return None
        return bytes(writer.data)

    def encode_fitted(self, values: Mapping[str, Any]) -> bytes | None:
        """As `encode`, of values of a program, which may be made to fit: floats are rounded to 32
        bits, and fields that are not there are zero.
        """
        data = self.encode(values)
        if data is not None:
            return data
        try:
            return self.encode(fitted(values, self._message))
        except UnfitError:
            return None

    def decode(self, data: bytes) -> dict[str, Any]:
        """The values of a message by field. Raises DecodeError if the bytes are none."""
        reader = ValueReader(data)
        if self._codec.least_size > reader.left:
            raise DecodeError(
                f"the message has {reader.left} bytes, and its type at least "
                f"{self._codec.least_size}"
            )
        values = self._codec.read(reader)
        reader.finish()
        if not isinstance(values, dict):
            raise DecodeError("the message is no map of fields")
        return values if self._counterpart is None else self._counterpart.of_ros(values)


def _codec(message: MessageType, names: TypeNames | None) -> MessageCodec:
    message = (names or TypeNames()).named(message)
    return MessageCodec(message, definition_of(message))


# Any message, in MessagePack: what is left where no type fits.
RAW = MessageCodec(MSGPACK, definition_of(MSGPACK))


# Those that nodes publish.
_KNOWN = {
    name_of(each): each for each in (messages.Clock, messages.Color, messages.Pose, messages.Twist)
}


class MessageCodecs:
    """The codecs of all messages of one file, made as messages come. Not thread-safe.

    A type of tfbus.messages has its own definition from the start. Any other has that of its first
    message, and another one, under a name with a number, once a message does not fit; after eight,
    and if ROS cannot express a message at all, it is RAW.

    Without `exact`, for eyes, numbers that are integers and floats in turn are all floats, so that
    the definition stays.
    """

    def __init__(self, *, exact: bool = True) -> None:
        self._names = TypeNames()
        self._floats = FLOAT if exact else NUMBER
        # Of each type the one used last first, each with its message as it would be named alone.
        self._of_type: dict[str, list[tuple[MessageCodec, MessageType]]] = {}

    def encode(self, type_name: str, values: Mapping[str, Any]) -> tuple[MessageCodec, bytes]:
        """A message of a type of this name, `Pose`, and the codec that reads it.

        If the name is not known, that of the topic will do. Raises InvalidArgumentException for
        a text that is not valid Unicode, and an integer of more than 64 bits.
        """
        codecs = self._of_type.get(type_name)
        if codecs is None:
            codecs = self._of_type[type_name] = []
            if (known := COUNTERPARTS.get(type_name)) is not None:
                message = message_of(known.definition)
                codecs.append((MessageCodec(message, known.definition, known), message))
            elif type_name in _KNOWN:
                self._add(codecs, type_of_dataclass(_KNOWN[type_name]))
        for at, (codec, _) in enumerate(codecs):
            if (data := codec.encode(values)) is not None:
                if at:
                    codecs.insert(0, codecs.pop(at))
                return codec, data
        return self._encode_new(type_name, codecs, values)

    def _encode_new(
        self,
        type_name: str,
        codecs: list[tuple[MessageCodec, MessageType]],
        values: Mapping[str, Any],
    ) -> tuple[MessageCodec, bytes]:
        message = type_of_values(type_name, values, self._floats)
        if message.kind == "fields" and len(codecs) < _MOST_CODECS:
            codec = self._add(codecs, self._wider(message, codecs))
            if (data := codec.encode(values)) is not None:
                return codec, data
        if (data := RAW.encode(values)) is None:
            raise InvalidArgumentException(
                f"a message of type '{printable(type_name, 60)}' cannot be written: it has a text "
                "that is not valid Unicode, or an integer of more than 64 bits"
            )
        return RAW, data

    def _wider(
        self, message: MessageType, codecs: list[tuple[MessageCodec, MessageType]]
    ) -> MessageType:
        """A type that takes the messages of a known one as well, if ROS can express both; for
        the last of a type anyhow. A type of ROS's own stays as it is.
        """
        for codec, before in codecs:
            if not codec.is_of_ros and have_same_keys(before, message):
                both = merged_fields(before, message)
                is_clear = packed_in(both) <= max(packed_in(before), packed_in(message))
                if is_clear or len(codecs) + 1 == _MOST_CODECS:
                    return both
        return message

    def _add(
        self, codecs: list[tuple[MessageCodec, MessageType]], message: MessageType
    ) -> MessageCodec:
        codec = _codec(message, self._names)
        codecs.insert(0, (codec, message))
        return codec
