"""Which definition and codec the messages of each topic have in a recording."""

from collections.abc import Callable
from typing import Any

from tfbus.recording.items import TopicItem
from tfbus.ros.definitions import MSGPACK, Definition
from tfbus.wire.codec import decode_map, encode_map


class TopicCodecs:
    """The codecs of the topics in one file."""

    def encode(self, item: TopicItem) -> tuple[Definition, bytes]:
        """A message as CDR, and its definition."""
        return MSGPACK, _encode_raw(item.values)


def decoder_of(name: str, definition: bytes) -> Callable[[bytes], dict[str, Any]] | None:
    """What reads messages of this type; None where tfbus cannot."""
    return _decode_raw if name == MSGPACK.name else None


def _encode_raw(values: Any) -> bytes:
    data = encode_map(values)
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def _decode_raw(data: bytes) -> dict[str, Any]:
    return decode_map(data[8:])
