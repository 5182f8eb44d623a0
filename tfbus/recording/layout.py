"""How items stand in an MCAP file: topics, channels, events. docs/reference/recording.md tells."""

import base64
import json
import math
import re
from collections.abc import Mapping
from typing import Any, get_args

from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.recording.items import EventItem, EventKind, RecordedStream, TopicItem
from tfbus.wording import printable

PROFILE = "ros2"
ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"

# The metadata records of a file: who wrote it, and what happened.
ABOUT = "tfbus"
EVENT = "tfbus.event"

# Before the keys of ABOUT that its user chose.
CUSTOM = "custom."

# The number of a message of a topic that was in force already; the others count from the next.
REPEATED = 0

TF, TF_STATIC = "tf", "tf_static"

# As rosbag2 writes them; readers of /tf_static need its durability, transient local.
_QOS = """\
- history: 1
  depth: {depth}
  reliability: 1
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
_VOLATILE = _QOS.format(depth=100, durability=2)
_TRANSIENT_LOCAL = _QOS.format(depth=1, durability=1)
_TRANSIENT = re.compile(r"^[ -]*durability: *(1|transient_local)\b", re.MULTILINE)

_KINDS: frozenset[str] = frozenset(get_args(EventKind))

_LAST_NS = 2**63 - 1


def stream_topic(stream: RecordedStream, static: bool) -> str:
    """The topic of a stream's channel, as ROS names it: `/tf`, `/robot7/tf_static`."""
    base = f"/{stream.namespace}" if stream.namespace else ""
    return f"{base}/{TF_STATIC if static else TF}"


def stream_metadata(stream: RecordedStream, static: bool, *, has_seq: bool) -> dict[str, str]:
    """The facts that the channel of a stream in one epoch says of it."""
    return {
        "tfbus.stream": stream.name,
        "tfbus.node": stream.node,
        "tfbus.namespace": stream.namespace,
        "tfbus.epoch": str(stream.epoch_ns),
        "tfbus.split": _bool_text(stream.split),
        "tfbus.seq": _bool_text(has_seq),
        "offered_qos_profiles": _TRANSIENT_LOCAL if static else _VOLATILE,
    }


def stream_of(topic: str, metadata: Mapping[str, str]) -> RecordedStream:
    """The stream of a channel with transforms. If others wrote it, it is named `ros`, below the
    namespace that its topic has.

    Raises DecodeError for a name that no stream has, and for an epoch that is no number.
    """
    if "tfbus.stream" not in metadata:
        namespace = topic.strip("/").rpartition("/")[0]
        return RecordedStream(f"{namespace}/ros" if namespace else "ros", namespace=namespace)
    name = metadata["tfbus.stream"]
    for said in (name, metadata.get("tfbus.node", ""), metadata.get("tfbus.namespace", "")):
        if said and not said.isprintable():
            raise DecodeError(f"a stream named {printable(said, 60)!r}")
    try:
        epoch_ns = int(metadata.get("tfbus.epoch", "0"))
    except ValueError as error:
        raise DecodeError(f"the epoch of stream {printable(name)!r} is no number") from error
    return RecordedStream(
        name,
        metadata.get("tfbus.node", ""),
        metadata.get("tfbus.namespace", ""),
        epoch_ns,
        metadata.get("tfbus.split") == "true",
    )


def has_seq(metadata: Mapping[str, str]) -> bool:
    """Whether the sequence numbers of a channel are those of its publisher."""
    return metadata.get("tfbus.seq") == "true"


def is_static_topic(topic: str) -> bool:
    """Whether transforms on this topic are static."""
    return topic.rpartition("/")[2] == TF_STATIC


def topic_metadata(item: TopicItem) -> dict[str, str]:
    """The facts that the channel of a topic says of it."""
    return {
        "tfbus.topic": item.topic,
        "tfbus.type": item.type_name,
        "offered_qos_profiles": _TRANSIENT_LOCAL if item.retained else _VOLATILE,
    }


def is_retained(metadata: Mapping[str, str]) -> bool:
    """Whether the messages of a topic's channel are retained: transient local in ROS, by its number
    or, in newer files of rosbag2, by its name.
    """
    return _TRANSIENT.search(metadata.get("offered_qos_profiles", "")) is not None


def is_numbered(metadata: Mapping[str, str]) -> bool:
    """Whether the messages of a topic's channel are numbered as tfbus does: others may give all of
    theirs the number 0.
    """
    return "tfbus.topic" in metadata


def topic_of(topic: str, metadata: Mapping[str, str]) -> str:
    """The name of a topic as tfbus has it: without the slash that ROS puts before it."""
    return metadata.get("tfbus.topic") or topic.removeprefix("/")


def event_metadata(item: EventItem) -> dict[str, str]:
    """The metadata record of an event. Raises InvalidArgumentException if its facts cannot be
    written as JSON.
    """
    try:
        facts = json.dumps(_plain(item.facts), allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InvalidArgumentException(
            f"the facts of {item.kind!r} {printable(item.name)!r} are not JSON: {error}"
        ) from error
    check_text(item.name)
    check_log_time(item.log_ns)
    return {
        "log_time": str(item.log_ns),
        "kind": item.kind,
        "name": item.name,
        "facts": facts,
    }


def event_of(metadata: Mapping[str, str]) -> EventItem | None:
    """The event of a metadata record; None for a kind that this version does not know.

    Raises DecodeError if it says no time, or its facts are no JSON.
    """
    kind = metadata.get("kind", "")
    if kind not in _KINDS:
        return None
    try:
        log_ns = int(metadata["log_time"])
        facts = _original(json.loads(metadata.get("facts", "{}")))
    except (KeyError, ValueError, RecursionError) as error:
        raise DecodeError(f"an event of kind {kind!r} cannot be read") from error
    if not isinstance(facts, dict) or not 0 <= log_ns <= _LAST_NS:
        raise DecodeError(f"an event of kind {kind!r} cannot be read")
    name = metadata.get("name", "")
    return EventItem(log_ns, kind, name, facts)  # type: ignore[arg-type]  # it is one of _KINDS


def check_log_time(log_ns: int) -> None:
    """Raise InvalidArgumentException for a log time that no recording has."""
    if not 0 <= log_ns <= _LAST_NS:
        raise InvalidArgumentException(
            f"a recording cannot hold the log time {log_ns}: nanoseconds from 1970 to 2262 are"
            " allowed"
        )


def check_text(text: str) -> None:
    """Raise InvalidArgumentException for a text that UTF-8 does not have."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise InvalidArgumentException(f"{printable(text)!r} is not valid Unicode") from error


def _bool_text(value: bool) -> str:
    return "true" if value else "false"


# JSON has no bytes and no numbers that are not finite: they stand as a map of one key.
_BYTES, _NUMBER, _MAP = "$bytes", "$number", "$map"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        plain = {key: _plain(each) for key, each in value.items()}
        is_ours = len(plain) == 1 and plain.keys() <= {_BYTES, _NUMBER, _MAP}
        return {_MAP: plain} if is_ours else plain
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, bytes):
        return {_BYTES: base64.b64encode(value).decode()}
    if isinstance(value, float) and not math.isfinite(value):
        return {_NUMBER: repr(value)}
    return value


def _original(value: Any) -> Any:
    if isinstance(value, list):
        return [_original(each) for each in value]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        [(key, inner)] = value.items()
        if key == _BYTES:
            return base64.b64decode(inner)
        if key == _NUMBER:
            return float(inner)
        if key == _MAP and isinstance(inner, dict):
            return {name: _original(each) for name, each in inner.items()}
    return {name: _original(each) for name, each in value.items()}
