"""Zenoh's scouting messages as bytes: Scout, which looks for others, and Hello, its answer."""

from typing import NamedTuple

_VERSION = 9
_SCOUT = 0x01
_HELLO = 0x02
_KIND = 0x1F
_HAS_LOCATORS = 0x20

# As Hello numbers them; Scout has a bit for each.
_ROLES = ("router", "peer", "client")
_ROUTERS_AND_PEERS = 0b011

# A host has a few addresses; any host of the network can send more.
_MOST_LOCATORS = 64

LARGEST = 8192


class Hello(NamedTuple):
    """The id, the role ("router", "peer", "client") and the locators of a session."""

    zid: str
    role: str
    locators: tuple[str, ...]


def encode_scout() -> bytes:
    """The message that looks for peers and routers."""
    return bytes((_SCOUT, _VERSION, _ROUTERS_AND_PEERS))


def is_scout_for(message: bytes, role: str) -> bool:
    """Whether a message looks for sessions of a role."""
    is_scout = len(message) >= 3 and message[0] & _KIND == _SCOUT and message[1] == _VERSION
    return is_scout and bool(message[2] >> _ROLES.index(role) & 1)


def encode_hello(hello: Hello) -> bytes:
    """The answer of a session to a Scout."""
    digits = hello.zid if len(hello.zid) % 2 == 0 else f"0{hello.zid}"
    zid = bytes.fromhex(digits)[::-1]
    header = _HELLO | (_HAS_LOCATORS if hello.locators else 0)
    parts = [bytes((header, _VERSION, (len(zid) - 1) << 4 | _ROLES.index(hello.role))), zid]
    if hello.locators:
        parts.append(_length(len(hello.locators)))
    for locator in hello.locators:
        text = locator.encode()
        parts += (_length(len(text)), text)
    return b"".join(parts)


def decode_hello(message: bytes) -> Hello | None:
    """The Hello in a message; None for any other message, or one that is damaged."""
    try:
        if message[0] & _KIND != _HELLO or message[1] != _VERSION:
            return None
        role, at = _ROLES[message[2] & 0b11], 4 + (message[2] >> 4)
        zid = message[3:at][::-1].hex().lstrip("0")
        if len(message) < at or not zid:
            return None
        locators = _locators(message, at) if message[0] & _HAS_LOCATORS else ()
    except (IndexError, UnicodeDecodeError):
        return None
    return Hello(zid, role, locators)


def _locators(message: bytes, at: int) -> tuple[str, ...]:
    count, at = _read_length(message, at)
    found = []
    for _ in range(min(count, _MOST_LOCATORS)):
        size, at = _read_length(message, at)
        if at + size > len(message):
            raise IndexError
        found.append(message[at : at + size].decode())
        at += size
    return tuple(found)


def _length(number: int) -> bytes:
    """A number as Zenoh writes lengths: seven bits a byte, the lowest first."""
    encoded = bytearray()
    while number > 0x7F:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    encoded.append(number)
    return bytes(encoded)


def _read_length(message: bytes, at: int) -> tuple[int, int]:
    """A length, and the position behind it."""
    number = shift = 0
    while True:
        byte = message[at]
        number |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return number, at
        if shift > 28:
            raise IndexError
