"""How items stand in an MCAP file: topics, channels, events, and an index of stamps.

docs/reference/recording.md tells. By the index, of each frame in each chunk, a lookup finds its
samples. A file without one, as of another program, or one that was cut short, is read once to make
it.
"""

import base64
import json
import math
import re
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import msgpack

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError, InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.base.wording import printable
from tfbus.geometry.columns import Columns
from tfbus.recording.items import EventItem, EventKind, RecordedStream, TopicItem
from tfbus.recording.records import of_zstd
from tfbus.wire.codec import too_many_items

if TYPE_CHECKING:
    from mcap.writer import Writer


PROFILE = "ros2"
ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"

# The metadata records of a file: its writer, and the events.
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
    """Whether the sequence numbers of a channel are its publisher's."""
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
    except (KeyError, TypeError, ValueError, RecursionError) as error:
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


ATTACHMENT = "tfbus.index"
_MEDIA_TYPE = "application/zstd"
_VERSION = 1

# An index that is larger is not read: it is made again.
_MOST_BYTES = 2**30

# The columns and their types in the file; a row for each frame that a chunk has of a channel.
_COLUMNS = {
    "chunk": "<u4",
    "channel": "<u2",
    "edge": "<u4",
    "from": "<i8",
    "to": "<i8",
    "count": "<u4",
}

Edge = tuple[str, str]


@dataclass(frozen=True)
class Index:
    """The transforms that a file holds.

    Row i says that the chunk that begins at `offsets[chunk[i]]` has `count[i]` transforms of
    `edges[edge[i]]`, parent and child, in messages of `channel[i]`, with stamps from `first_ns[i]`
    to `last_ns[i]`. `changes` are the log times at which a channel of static transforms got another
    set: pairs of channel and time.
    """

    offsets: tuple[int, ...]
    edges: tuple[Edge, ...]
    chunk: "NDArray[np.uint32]"
    channel: "NDArray[np.uint16]"
    edge: "NDArray[np.uint32]"
    first_ns: "NDArray[np.int64]"
    last_ns: "NDArray[np.int64]"
    count: "NDArray[np.uint32]"
    changes: tuple[tuple[int, int], ...]


class IndexBuilder:
    """Makes the index, chunk after chunk."""

    def __init__(self) -> None:
        self._offsets: list[int] = []
        self._edges: dict[Edge, int] = {}
        self._rows: list[NDArray[np.int64]] = []
        self._changes: list[tuple[int, int]] = []
        # Of the chunk that is not at its end: the stamps of messages with the same frames.
        self._stamps: dict[tuple[int, tuple[str, ...], bytes], list[bytes]] = {}
        # The numbers of edges by frames and the edges of a message.
        self._numbers: dict[tuple[tuple[str, ...], bytes], NDArray[np.int64]] = {}

    def add(self, channel: int, rows: Columns, messages: int = 1) -> None:
        """Note a message in the chunk, or several with the same edges, one after the other."""
        edges = rows.edges_bytes()
        key = (channel, rows.frames, edges[: len(edges) // messages])
        self._stamps.setdefault(key, []).append(rows.stamps_bytes())

    def add_change(self, channel: int, log_ns: int) -> None:
        """Note that a channel of static transforms has another set from now on."""
        self._changes.append((channel, log_ns))

    def end_chunk(self, offset: int) -> None:
        """The chunk ends; it begins at this place of the file."""
        number = len(self._offsets)
        self._offsets.append(offset)
        for (channel, frames, edges), stamps in self._stamps.items():
            numbers = self._edge_numbers(frames, edges)
            if not len(numbers):
                continue
            table = np.frombuffer(b"".join(stamps), np.int64).reshape(-1, len(numbers))
            rows = np.empty((len(numbers), 6), np.int64)
            rows[:, 0], rows[:, 1], rows[:, 2] = number, channel, numbers
            rows[:, 3], rows[:, 4] = table.min(axis=0), table.max(axis=0)
            rows[:, 5] = len(table)
            self._rows.append(rows)
        self._stamps.clear()

    def build(self) -> Index:
        """The index of the chunks that have ended."""
        rows = _united(np.concatenate([np.empty((0, 6), np.int64), *self._rows]))
        return Index(
            tuple(self._offsets),
            tuple(self._edges),
            rows[:, 0].astype(np.uint32),
            rows[:, 1].astype(np.uint16),
            rows[:, 2].astype(np.uint32),
            rows[:, 3].copy(),
            rows[:, 4].copy(),
            rows[:, 5].astype(np.uint32),
            tuple(self._changes),
        )

    def write(self, mcap: "Writer") -> None:
        """Write the index into the file, at its end."""
        index = self.build()
        mcap.add_attachment(0, 0, ATTACHMENT, _MEDIA_TYPE, encode_index(index))

    def _edge_numbers(self, frames: tuple[str, ...], edges: bytes) -> "NDArray[np.int64]":
        numbers = self._numbers.get((frames, edges))
        if numbers is None:
            pairs = np.frombuffer(edges, np.uint32).reshape(-1, 2).tolist()
            names = [(frames[parent], frames[child]) for parent, child in pairs]
            of = [self._edges.setdefault(name, len(self._edges)) for name in names]
            numbers = np.array(of, np.int64)
            if len(self._numbers) >= 1024:
                self._numbers.clear()
            self._numbers[frames, edges] = numbers
        return numbers


def _united(rows: "NDArray[np.int64]") -> "NDArray[np.int64]":
    """The rows, joined and ordered by chunk, channel and edge."""
    if not len(rows):
        return rows
    rows = rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
    is_new = np.ones(len(rows), bool)
    is_new[1:] = (rows[1:, :3] != rows[:-1, :3]).any(axis=1)
    starts = np.flatnonzero(is_new)
    united = rows[starts]
    united[:, 3] = np.minimum.reduceat(rows[:, 3], starts)
    united[:, 4] = np.maximum.reduceat(rows[:, 4], starts)
    united[:, 5] = np.add.reduceat(rows[:, 5], starts)
    return united


def encode_index(index: Index) -> bytes:
    """The bytes of the attachment."""
    import zstandard

    columns: tuple[NDArray[Any], ...] = (
        index.chunk,
        index.channel,
        index.edge,
        index.first_ns,
        index.last_ns,
        index.count,
    )
    said = {
        "v": _VERSION,
        "chunks": np.array(index.offsets, "<u8").tobytes(),
        "edges": [list(edge) for edge in index.edges],
        "changes": [list(change) for change in index.changes],
        **{
            name: column.astype(kind).tobytes()
            for (name, kind), column in zip(_COLUMNS.items(), columns, strict=True)
        },
    }
    found: bytes = zstandard.compress(msgpack.packb(said))
    return found


def decode_index(data: bytes, offsets: Collection[int], channels: Collection[int]) -> Index:
    """The index in an attachment of a file with these chunks and channels.

    Raises DecodeError if it is none, or not this file's.
    """
    try:
        plain = of_zstd(data, _MOST_BYTES)
        if mistake := too_many_items(plain):
            raise DecodeError(mistake)
        said = msgpack.unpackb(plain)
        return _index_of(said, offsets, channels)
    except (
        msgpack.UnpackException,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise DecodeError("the index cannot be read") from error


def _index_of(
    said: Mapping[str, Any], offsets: Collection[int], channels: Collection[int]
) -> Index:
    if said["v"] != _VERSION:
        raise DecodeError("the index has another version")
    columns = [np.frombuffer(said[name], kind) for name, kind in _COLUMNS.items()]
    if sys.byteorder != "little":
        columns = [column.astype(column.dtype.newbyteorder("=")) for column in columns]
    chunk, channel, edge, first, last, count = columns
    found = np.frombuffer(said["chunks"], "<u8")
    edges = tuple((str(parent), str(child)) for parent, child in said["edges"])
    is_ours = (
        set(found.tolist()) == set(offsets)
        and len({len(column) for column in columns}) == 1
        and set(np.unique(channel).tolist()) <= set(channels)
        and (not len(chunk) or (int(chunk.max()) < len(found) and int(edge.max()) < len(edges)))
        and (first <= last).all()
    )
    if not is_ours:
        raise DecodeError("the index is not that of this file")
    changes = tuple((int(number), int(log_ns)) for number, log_ns in said["changes"])
    return Index(tuple(found.tolist()), edges, chunk, channel, edge, first, last, count, changes)
