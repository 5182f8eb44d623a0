"""Foxglove's protocol, foxglove.sdk.v1: its values, and the messages of a server as bytes.

Its specification: https://github.com/foxglove/ws-protocol and the foxglove-sdk. A text is JSON with
the name of an operation in `op`; a binary message begins with a byte that says its kind.
"""

import base64
import binascii
import json
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

SUBPROTOCOL = "foxglove.sdk.v1"

# Numbers beyond are no integers of 64 bits.
_INT64 = 1 << 63

# An id has 32 bits in binary messages.
_LARGEST_ID = (1 << 32) - 1

_MESSAGE = struct.Struct("<BIQ")
_TIME = struct.Struct("<BQ")
_ANSWER = struct.Struct("<BIII")
_FILE = struct.Struct("<BIBI")
_STATE = struct.Struct("<BBQfBI")
_CONTROL = struct.Struct("<BBfBQI")
_CALL = struct.Struct("<BIII")
_PUBLISHED = struct.Struct("<BI")

# The kinds of binary messages of clients.
PUBLISHED, CALLED, CONTROLLED = 1, 2, 3


class Capability(StrEnum):
    """A capability of a server, as its clients learn of it."""

    PUBLISH = "clientPublish"
    PARAMETERS = "parameters"
    PARAMETERS_SUBSCRIBE = "parametersSubscribe"
    TIME = "time"
    SERVICES = "services"
    ASSETS = "assets"
    GRAPH = "connectionGraph"
    PLAYBACK = "playbackControl"


class Level(IntEnum):
    """How bad a status is."""

    WARNING = 1
    ERROR = 2


class PlaybackStatus(IntEnum):
    """Whether a recording plays."""

    PLAYING, PAUSED, BUFFERING, ENDED = range(4)


@dataclass(frozen=True, slots=True)
class ShownParameter:
    """A parameter, with None one that does not exist. Raises ValueError for a value that JSON or 64
    bits do not hold.
    """

    name: str
    value: Any = None

    def __post_init__(self) -> None:
        _check_value(self.value)

    def as_map(self) -> dict[str, Any]:
        """As it is in a message; a float says that it is one, since JSON's 1.0 is 1 to others."""
        found: dict[str, Any] = {"name": self.name}
        if isinstance(self.value, float):
            found["type"] = "float64"
        elif isinstance(self.value, list) and any(isinstance(each, float) for each in self.value):
            found["type"] = "float64_array"
        elif isinstance(self.value, bytes):
            return {**found, "type": "byte_array", "value": base64.b64encode(self.value).decode()}
        return found if self.value is None else {**found, "value": self.value}

    @classmethod
    def from_map(cls, given: Mapping[str, Any]) -> "ShownParameter":
        """From a client's message. Raises KeyError, TypeError or ValueError for others."""
        name, kind, value = _text(given["name"]), given.get("type"), given.get("value")
        if kind == "float64":
            value = _float(value)
        elif kind == "float64_array":
            value = [_float(each) for each in _list(value)]
        elif kind == "byte_array":
            value = _bytes_of(value)
        return cls(name, value)


@dataclass(frozen=True, slots=True)
class ClientChannel:
    """A topic that a client is going to publish on."""

    id: int
    topic: str
    encoding: str
    schema_name: str

    @classmethod
    def from_map(cls, given: Mapping[str, Any]) -> "ClientChannel":
        """From a client's message. Raises KeyError, TypeError or ValueError for others."""
        texts = (_text(given[name]) for name in ("topic", "encoding", "schemaName"))
        return cls(number(given["id"]), *texts)


@dataclass(frozen=True, slots=True)
class PlaybackControl:
    """A client's wish: play or pause, at a speed, from a time if there is one."""

    is_play: bool
    speed: float
    seek_ns: int | None
    request_id: str

    @classmethod
    def from_bytes(cls, data: bytes) -> "PlaybackControl":
        """From a client's message. Raises ValueError or struct.error for others."""
        _, command, speed, has_seek, seek_ns, length = _CONTROL.unpack_from(data)
        if command > 1:
            raise ValueError(f"there is no playback command {command}")
        request_id = _part(data, _CONTROL.size, length).decode()
        return cls(command == 0, speed, seek_ns if has_seek else None, request_id)


@dataclass(frozen=True, slots=True)
class PlaybackState:
    """How a recording plays."""

    status: PlaybackStatus
    time_ns: int
    speed: float
    did_seek: bool = False
    request_id: str | None = None

    def as_bytes(self) -> bytes:
        """The message."""
        name = (self.request_id or "").encode()
        head = _STATE.pack(5, self.status, self.time_ns, self.speed, self.did_seek, len(name))
        return head + name


# Messages of clients


def called(data: bytes) -> tuple[int, int, str, bytes]:
    """The service, the call, the encoding and the request of a call. Raises ValueError or
    struct.error.
    """
    _, service, call, length = _CALL.unpack_from(data)
    encoding = _part(data, _CALL.size, length).decode()
    return service, call, encoding, data[_CALL.size + length :]


def published(data: bytes) -> tuple[int, bytes]:
    """The channel and the message that a client publishes. Raises struct.error."""
    return _PUBLISHED.unpack_from(data)[1], data[_PUBLISHED.size :]


def number(value: Any) -> int:
    """An id of a message. Raises TypeError if it is none, ValueError if it has no 32 bits."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError("an id must be an integer")
    if not 0 <= value <= _LARGEST_ID:
        raise ValueError(f"an id must be an integer from 0 to {_LARGEST_ID}")
    return value


def numbers(values: Any) -> list[int]:
    """Ids of a message. Raises as `number` if they are none."""
    return [number(each) for each in _list(values)]


def texts(values: Any) -> list[str]:
    """Names of a message. Raises TypeError if they are none."""
    return [_text(each) for each in _list(values)]


def request_id(given: Mapping[str, Any]) -> str | None:
    """The id of a request, None if it has none. Raises TypeError if it is no text."""
    value = given.get("id")
    return None if value is None else _text(value)


# Messages of the server


def text(op: str, **fields: Any) -> str:
    """An operation in JSON; fields that are None are left out."""
    present = {name: value for name, value in fields.items() if value is not None}
    return json.dumps({"op": op, **present}, separators=(",", ":"), allow_nan=False)


def parameter_values(parameters: Sequence[ShownParameter], request_id: str | None = None) -> str:
    """Parameters, as the answer to a request if it has an id."""
    return text("parameterValues", parameters=[each.as_map() for each in parameters], id=request_id)


def message_head(subscription: int, log_ns: int) -> bytes:
    """The head of a message on a channel, before its bytes."""
    return _MESSAGE.pack(1, subscription, log_ns)


def time_of(now_ns: int) -> bytes:
    """The time."""
    return _TIME.pack(2, now_ns)


def answer(service: int, call: int, encoding: str, response: bytes) -> bytes:
    """The response of a service."""
    return _ANSWER.pack(3, service, call, len(encoding)) + encoding.encode() + response


def file_of(request: int, content: bytes) -> bytes:
    """A file that was asked for."""
    return _FILE.pack(4, request, 0, 0) + content


def no_file(request: int, reason: str) -> bytes:
    """Why a file that was asked for does not come."""
    data = reason.encode()
    return _FILE.pack(4, request, 1, len(data)) + data


def stamp_of(time_ns: int) -> dict[str, int]:
    """A time as JSON has it."""
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def _check_value(value: Any) -> None:
    if isinstance(value, list | tuple):
        for each in value:
            _check_value(each)
    elif isinstance(value, dict):
        for name, each in value.items():
            _text(name)
            _check_value(each)
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a number in JSON")
    elif isinstance(value, int):
        if not -_INT64 <= value < _INT64:
            raise ValueError(f"{value} has more than 64 bits")
    elif not isinstance(value, str | bytes | None):
        raise ValueError(f"a {type(value).__name__} is no value of a parameter")


def _list(values: Any) -> list[Any]:
    if not isinstance(values, list):
        raise TypeError("expected a list")
    return values


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("expected a str")
    return value


def _float(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise TypeError("expected a number")
    return float(value)


def _bytes_of(value: Any) -> bytes:
    try:
        return base64.b64decode(_text(value), validate=True)
    except binascii.Error as error:
        raise ValueError("expected base64") from error


def _part(data: bytes, begin: int, length: int) -> bytes:
    if len(data) < begin + length:
        raise ValueError("the message is too short")
    return data[begin : begin + length]
