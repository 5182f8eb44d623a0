"""The index of a file: the stamps of each frame in each chunk, so that a lookup finds its samples.

docs/reference/recording.md describes the attachment that holds it. A file without one, as of
another program, or one that was cut short, is read once to make it.
"""

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgpack

from tfbus.core import lazy_numpy as np
from tfbus.core.lazy_numpy import NDArray
from tfbus.errors import DecodeError
from tfbus.geometry.columns import Columns
from tfbus.recording.records import of_zstd
from tfbus.wire.codec import too_many_items

if TYPE_CHECKING:
    from mcap.writer import Writer

ATTACHMENT = "tfbus.index"
_MEDIA_TYPE = "application/zstd"
_VERSION = 1

# An index that is larger is not read: it is made again.
_MOST_BYTES = 2**30

# The columns and what they are in the file; a row for each frame that a chunk has of a channel.
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
    """Which transforms a file holds.

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
    """The rows with those of the same chunk, channel and edge as one, in this order."""
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

    Raises DecodeError if it is none, or is not that of this file.
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
