"""How large messages may be: larger ones are dropped, or refused, before they are read.

A message is reached by its key, which also says its kind: `kind_of`.
"""

import re

from tfbus.base.errors import DecodeError, SettingsError
from tfbus.base.structs import Struct, fields_of
from tfbus.base.wording import printable
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS

_UNITS = {"": 1, "B": 1, "kB": 1_000, "MB": 1_000_000, "GB": 1_000_000_000}
_SIZE = r"(\d{1,12})\s*(|B|kB|MB|GB)"

# Zenoh counts message sizes in 32 bits.
_MOST = 2_000_000_000

# The chunks of a key, below a namespace, that say its kind.
_KIND_OF_CHUNK = {
    TRANSFORMS: "transforms",
    STATIC_TRANSFORMS: "transforms",
    "@tfbus/stream": "description",
    "@tfbus/node": "description",
    "@tfbus/param": "parameter",
    "@tfbus/set": "parameter",
    "@tfbus/clock": "clock",
}
_KIND_CHUNK = re.compile(r"(?:^|/)(tf|tf_static|@tfbus/[a-z]+)(?:/|$)")


class Limits(Struct):
    """The largest payload of each kind of message that a process reads, in bytes.

    `transforms` are dynamic and static ones (16 MB are 190,000 of them), `description` a stream's
    or node's description, `parameter` a parameter's value, `topic` a message of a topic,
    `service` a request, response, goal or feedback, `clock` an answer about a host's clock. Raises
    SettingsError for a size that is not from 1 to 2 GB.
    """

    transforms: int = 16_000_000
    description: int = 16_000_000
    parameter: int = 1_000_000
    topic: int = 32_000_000
    service: int = 32_000_000
    clock: int = 1_000

    def __post_init__(self) -> None:
        for kind in KINDS:
            size = getattr(self, kind)
            if not isinstance(size, int) or not 1 <= size <= _MOST:
                raise SettingsError(
                    f"the limit of {kind} must be from 1 to {_MOST} bytes, not {size!r}"
                )

    @property
    def largest(self) -> int:
        """The largest of them."""
        return max(map(self.limit_of, KINDS))

    def limit_of(self, kind: str) -> int:
        """The limit of a kind, one of KINDS."""
        most: int = getattr(self, kind)
        return most

    def mistake_in(self, kind: str, size: int) -> str:
        """Why a payload of this size is not read, as the end of a sentence; "" if it is."""
        most = self.limit_of(kind)
        if size <= most:
            return ""
        enough = size_text(_rounded_up(size)).replace(" ", "")
        return (
            f"it has {size_text(size)}, and the limit of {kind} is {size_text(most)}; to raise it, "
            f"set TFBUS_LIMITS={kind}={enough} for all that send or read it"
        )

    @classmethod
    def parse(cls, text: str) -> "Limits":
        """The limits that a text such as `topic=64MB, service=8MB` sets; others by default.

        Raises SettingsError if it is of another form.
        """
        return cls(**dict(_parsed(part.strip()) for part in text.split(",") if part.strip()))


KINDS = tuple(each.name for each in fields_of(Limits))

DEFAULT_LIMITS = Limits()


def kind_of_query(key: str) -> str:
    """The kind of the queries of a key or key expression, and of their answers."""
    kind = kind_of(key)
    return "service" if kind == "topic" else kind


def check_size(kind: str, payload: bytes, limits: Limits = DEFAULT_LIMITS) -> None:
    """Raise DecodeError if the payload is larger than the limit of its kind."""
    if mistake := limits.mistake_in(kind, len(payload)):
        raise DecodeError(mistake)


def kind_of(key: str) -> str:
    """The kind of the messages at a key or key expression: "topic" if it is none of tfbus's
    own.
    """
    if key.startswith("tf/"):  # the keys that come most often
        return "transforms"
    found = _KIND_CHUNK.search(key)
    return _KIND_OF_CHUNK.get(found[1], "topic") if found else "topic"


def size_text(size: int) -> str:
    """A size as people say it: `512 B`, `1.5 kB`, `32 MB`."""
    for unit in ("GB", "MB", "kB"):
        if size >= _UNITS[unit]:
            return f"{size / _UNITS[unit]:.3g} {unit}"
    return f"{size} B"


def size_in(text: str) -> int | None:
    """The bytes in a text such as `512 B`, `64MB` or `1000`; None if it is of another form."""
    found = re.fullmatch(_SIZE, text.strip())
    return int(found[1]) * _UNITS[found[2]] if found else None


def _rounded_up(size: int) -> int:
    """The size with one digit that is not 0, and not less."""
    digit = 10 ** (len(str(size)) - 1)
    rounded: int = -(-size // digit) * digit
    return min(rounded, _MOST)


def _parsed(text: str) -> tuple[str, int]:
    kind, _, text_of_size = map(str.strip, text.partition("="))
    size = size_in(text_of_size)
    if kind not in KINDS or size is None:
        raise SettingsError(
            f"'{printable(text, 60)}' is not a limit: write kind=size, as in topic=64MB, where the "
            f"kind is one of {', '.join(KINDS)} and the unit one of B, kB, MB, GB"
        )
    return kind, size
