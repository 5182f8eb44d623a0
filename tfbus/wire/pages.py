"""Pages of kept messages: answers to a query for earlier messages, one part at a time."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgpack

from tfbus.base.errors import DecodeError
from tfbus.wire.codec import decode_map, too_many_items, unpacked

# Pages of other versions are refused.
VERSION = 1

# A map that begins with this key is a page: no message of transforms does.
_BEGINS_WITH = b"\xa4page"

# A page unpacks to no more: the largest message, and some room around it.
_MOST_BYTES = 64_000_000

# Half the time of the default, for a tenth more bytes.
_LEVEL = 3


class KeptMessage(NamedTuple):
    """A message as it was sent: at which key, within the namespace of its publisher, and its
    payload. `log_ns` is when it was recorded, by the keeper's clock; 0 if it is not known.
    """

    key: str
    log_ns: int
    payload: bytes


class Page(NamedTuple):
    """A part of the kept messages, oldest first.

    `next` is where the next page begins, "" after the last. `left_s` is for how many seconds
    messages are left, and `now_ns` their keeper's clock; 0 if they are not known.
    """

    messages: Sequence[KeptMessage]
    next: str = ""
    left_s: float = 0.0
    now_ns: int = 0


def encode_page(page: Page) -> bytes:
    """The payload of a page."""
    import zlib  # 0.2 MB, and most nodes never send or read a page

    rows = zlib.compress(msgpack.packb([tuple(each) for each in page.messages]), _LEVEL)
    said = {"page": VERSION, "next": page.next, "left_s": page.left_s, "now": page.now_ns}
    packed: bytes = msgpack.packb({**said, "messages": rows})
    return packed


def is_page(payload: bytes) -> bool:
    """Whether an answer is a page; if not, it is one message, as earlier versions answer."""
    return payload[1:6] == _BEGINS_WITH


def decode_page(payload: bytes) -> Page:
    """The page in a payload. Raises DecodeError if it is none, or of another version."""
    said = decode_map(payload)
    version = said.get("page")
    if version != VERSION:
        raise DecodeError(f"a page of version {version!r}; this is version {VERSION}")
    after, packed = said.get("next", ""), said.get("messages")
    left_s, now_ns = said.get("left_s", 0.0), said.get("now", 0)
    if not (
        isinstance(after, str) and isinstance(left_s, (int, float)) and isinstance(now_ns, int)
    ):
        raise DecodeError("a page whose next, left_s or now is of another type")
    if not 0.0 <= left_s < math.inf or not 0 <= now_ns < 2**63:
        raise DecodeError("a page whose left_s or now is no time")
    if not isinstance(packed, bytes):
        raise DecodeError("a page without messages")
    return Page([_message(row) for row in _rows(packed)], after, float(left_s), now_ns)


def _rows(packed: bytes) -> list[Any]:
    import zlib  # as above

    inflating = zlib.decompressobj()
    try:
        plain = inflating.decompress(packed, _MOST_BYTES)
    except zlib.error as error:
        raise DecodeError(f"a page that cannot be unpacked ({error})") from error
    if not inflating.eof:
        raise DecodeError("a page that is cut short, or unpacks to more than 64 MB")
    if mistake := too_many_items(plain):
        raise DecodeError(mistake)
    try:
        rows = unpacked(plain)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise DecodeError(f"a page whose messages are not msgpack ({error})") from error
    if not isinstance(rows, list):
        raise DecodeError("a page whose messages are no array")
    return rows


def _message(row: Any) -> KeptMessage:
    match row:
        case [str(key), int(log_ns), bytes(payload)] if 0 <= log_ns < 2**63:
            return KeptMessage(key, log_ns, payload)
    raise DecodeError("a page with a message that is not its key, time and payload")
