"""The edges of a recording by its indices: of which streams, in which chunks, at which stamps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tfbus.recording.index import Edge
from tfbus.recording.part import StreamChannel
from tfbus.recording.reader import RecordingReader
from tfbus.recording.viewpoint import Viewpoint

# A stream in one epoch.
StreamKey = tuple[str, int]


@dataclass(frozen=True)
class EdgeFacts:
    """An edge of a stream in one epoch, by the index: its samples; stamps in nanoseconds."""

    key: StreamKey
    edge: Edge
    is_static: bool
    samples: int
    first_ns: int
    last_ns: int


class EdgeTable:
    """The edges of the streams that are seen from a viewpoint, by the indices of all files.

    `keys` and `edges` are numbered, as are the chunks by their place in `RecordingReader.chunks`.
    `static` and `dynamic` (N, 6) have a row for each edge of a stream in a chunk: chunk, key, edge,
    first and last stamp, and the number of samples.
    """

    def __init__(self, reader: RecordingReader, view: Viewpoint) -> None:
        self.edges: dict[Edge, int] = {}
        self.keys: dict[StreamKey, int] = {}
        # By the name of a child frame here: its names in the file.
        self._sent_names: dict[str, set[str]] = {}
        self._view = view
        table = self._read(reader)
        is_static = table[:, 0] == 1
        self.static, self.dynamic = table[is_static, 1:], table[~is_static, 1:]

    def key(self, channel: StreamChannel) -> int | None:
        """The number of the stream of a channel in its epoch; None where it is not seen."""
        return self.keys.get((channel.stream.name, channel.stream.epoch_ns))

    def sent_names(self, children: frozenset[str]) -> frozenset[str]:
        """The names in the files of child frames that are called so here."""
        return frozenset(name for child in children for name in self._sent_names.get(child, ()))

    def facts(self) -> list[EdgeFacts]:
        """The samples of each edge of each stream in each epoch, counted."""
        keys, edges = list(self.keys), list(self.edges)
        found = []
        for table, is_static in ((self.static, True), (self.dynamic, False)):
            rows = table[np.lexsort((table[:, 2], table[:, 1]))]
            if not len(rows):
                continue
            is_new = np.ones(len(rows), bool)
            is_new[1:] = (rows[1:, 1:3] != rows[:-1, 1:3]).any(axis=1)
            starts = np.flatnonzero(is_new)
            for row, first, last, count in zip(
                rows[starts].tolist(),
                np.minimum.reduceat(rows[:, 3], starts).tolist(),
                np.maximum.reduceat(rows[:, 4], starts).tolist(),
                np.add.reduceat(rows[:, 5], starts).tolist(),
                strict=True,
            ):
                found.append(EdgeFacts(keys[row[1]], edges[row[2]], is_static, count, first, last))
        return found

    def _read(self, reader: RecordingReader) -> NDArray[np.int64]:
        """The rows of all files, with whether they are static before the rest."""
        numbers = {(chunk.part.number, chunk.offset): at for at, chunk in enumerate(reader.chunks)}
        tables = [np.empty((0, 7), np.int64)]
        for part in reader.parts:
            index = part.index
            places = np.array([numbers[part.number, offset] for offset in index.offsets], np.int64)
            order = np.argsort(index.channel, kind="stable")
            ordered = index.channel[order]
            for channel in part.stream_channels.values():
                stream = channel.stream
                if self._view.called(stream.name, stream.namespace) is None:
                    continue
                start, end = np.searchsorted(ordered, [channel.id, channel.id + 1]).tolist()
                rows = order[start:end]
                key = self.keys.setdefault((stream.name, stream.epoch_ns), len(self.keys))
                table = np.empty((len(rows), 7), np.int64)
                table[:, 0], table[:, 2] = channel.is_static, key
                table[:, 1] = places[index.chunk[rows]]
                table[:, 3] = self._numbers(index.edges, index.edge[rows], stream.namespace)
                table[:, 4], table[:, 5] = index.first_ns[rows], index.last_ns[rows]
                table[:, 6] = index.count[rows]
                tables.append(table)
        return np.concatenate(tables)

    def _numbers(
        self, edges: tuple[Edge, ...], used: NDArray[np.uint32], namespace: str
    ) -> NDArray[np.int64]:
        """The numbers here of edges of a file."""
        outside = self._view.names(namespace).outside
        here = np.zeros(len(edges), np.int64)
        for at in np.unique(used).tolist():
            parent, child = edges[at]
            edge = outside(parent), outside(child)
            self._sent_names.setdefault(edge[1], set()).add(child)
            here[at] = self.edges.setdefault(edge, len(self.edges))
        return here[used]
