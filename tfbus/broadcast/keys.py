"""The keys on which a stream sends its dynamic transforms: one for all, or one for each frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tfbus.bus.handles import BytesPublisher
from tfbus.bus.session import Session
from tfbus.core.packed import POSE_SIZE, STAMP_SIZE
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.wire.keys import escape, transforms_key
from tfbus.wire.transforms import TransformEncoder

# A frame nearly always has one row in a send: the first name is its parent, the second itself.
_ONE_EDGE = np.array([[0, 1]], dtype=np.uint32)


class StreamKey:
    """One key; its messages are numbered from 0 in each epoch."""

    def __init__(self, key: str, publisher: BytesPublisher) -> None:
        self.key = key
        self.publisher = publisher
        self.sent = 0


@dataclass(frozen=True, slots=True, eq=False)
class RowsOfKey:
    """The rows of a send that go on one key, in one message; `rows` is None for all."""

    key: StreamKey
    rows: Sequence[int] | None
    encoder: TransformEncoder

    def encode(self, columns: Columns) -> bytes:
        """The next message of the key, with these rows."""
        seq = self.key.sent
        self.key.sent += 1
        if self.rows is None:
            return self.encoder.encode(seq, columns.stamps, columns.poses)
        stamps = _rows_of(columns.stamps, STAMP_SIZE, self.rows)
        return self.encoder.encode(seq, stamps, _rows_of(columns.poses, POSE_SIZE, self.rows))


class StreamKeys(Protocol):
    """The keys of a stream; `expression` is a key expression that matches all of them."""

    expression: str

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of them now."""

    def divide(self, batch: TransformBatch, epoch_ns: int) -> Sequence[RowsOfKey]:
        """Which rows go on which key, for this batch and all with the same edges."""

    def restart(self) -> None:
        """Number messages from 0 again."""

    def forget(self, child: str) -> None:
        """Forget the key of this frame."""


class OneKey:
    """All rows go on the stream's own key."""

    def __init__(self, stream: str, session: Session) -> None:
        self.expression = transforms_key(stream)
        self._key = StreamKey(self.expression, session.publisher(self.expression, urgent=True))

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to it now."""
        return self._key.publisher.heard

    def divide(self, batch: TransformBatch, epoch_ns: int) -> Sequence[RowsOfKey]:
        """All rows in one message."""
        encoder = TransformEncoder(epoch_ns, batch.frames, batch.edges)
        return [RowsOfKey(self._key, None, encoder)]

    def restart(self) -> None:
        """Number messages from 0 again."""
        self._key.sent = 0

    def forget(self, child: str) -> None:
        """It has no key of its own."""


class KeyPerFrame:
    """Each child frame has a key below the stream's: others can subscribe to it alone."""

    def __init__(self, stream: str, session: Session) -> None:
        self._own_key = transforms_key(stream)
        self.expression = f"{self._own_key}/**"
        self._publishers = session.publishers_within(self.expression, urgent=True)
        self._keys: dict[str, StreamKey] = {}

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of them now."""
        return self._publishers.heard

    def divide(self, batch: TransformBatch, epoch_ns: int) -> Sequence[RowsOfKey]:
        """One message a child frame."""
        rows_of: dict[str, list[int]] = {}
        for row, child in enumerate(batch.edges[:, 1].tolist()):
            rows_of.setdefault(batch.frames[child], []).append(row)
        return [self._rows(batch, child, rows, epoch_ns) for child, rows in rows_of.items()]

    def restart(self) -> None:
        """Number messages from 0 again."""
        for key in self._keys.values():
            key.sent = 0

    def forget(self, child: str) -> None:
        """Forget the key of this frame; sent again, its messages are numbered from 0."""
        self._keys.pop(child, None)

    def _rows(self, batch: TransformBatch, child: str, rows: list[int], epoch_ns: int) -> RowsOfKey:
        if child not in self._keys:
            key = f"{self._own_key}/{escape(child)}"
            self._keys[child] = StreamKey(key, self._publishers.publisher(key))
        if len(rows) == 1:
            names = [batch.frames[batch.edges[rows[0], 0]], child]
            encoder = TransformEncoder(epoch_ns, names, _ONE_EDGE)
            return RowsOfKey(self._keys[child], rows, encoder)
        used, edges = np.unique(batch.edges[rows], return_inverse=True)
        names = [batch.frames[frame] for frame in used.tolist()]
        encoder = TransformEncoder(epoch_ns, names, edges.reshape(-1, 2).astype(np.uint32))
        return RowsOfKey(self._keys[child], rows, encoder)


def _rows_of(column: bytes, size: int, rows: Sequence[int]) -> bytes:
    return b"".join([column[size * row : size * (row + 1)] for row in rows])
