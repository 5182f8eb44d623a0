"""How a stream sends dynamic transforms: options, and one key for all or one for each frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import index
from struct import pack
from typing import Protocol, SupportsFloat, SupportsIndex

from tfbus.bus.handles import BytesPublisher
from tfbus.bus.session import Session
from tfbus.core.packed import EDGE_SIZE, ONE_EDGE, POSE_SIZE, STAMP_SIZE
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.columns import Columns, rows_of
from tfbus.wire.keys import escape
from tfbus.wire.transforms import TransformEncoder


@dataclass(frozen=True)
class StreamOptions:
    """How a stream sends its dynamic transforms; all its broadcasters have the same options.

    With `split` each frame has a key of its own. Of two publishers of one frame, listeners with
    `conflicts="priority"` accept the one of higher `priority`, a 32-bit integer. Messages of the
    last `history_s` seconds are kept for listeners that join later. Raises
    InvalidArgumentException if one is invalid.
    """

    split: bool = False
    priority: int = 0
    history_s: float = 10.0

    def __post_init__(self) -> None:
        history_s: object = self.history_s
        if not isinstance(history_s, SupportsFloat) or not 0.0 <= float(history_s) < math.inf:
            raise InvalidArgumentException(
                f"history_s must be a number of seconds, 0 or more, not {self.history_s!r}"
            )
        priority: object = self.priority
        if not isinstance(priority, SupportsIndex) or not -(2**31) <= index(priority) < 2**31:
            raise InvalidArgumentException(
                f"priority must be a 32-bit integer, not {self.priority!r}"
            )
        object.__setattr__(self, "priority", index(priority))

    def __str__(self) -> str:
        return f"split={self.split}, priority={self.priority}, history_s={self.history_s:g}"


class StreamKey:
    """A key; its messages are numbered from 0 in each epoch."""

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
            return self.encoder.encode(seq, columns.stamps_bytes(), columns.poses_bytes())
        stamps = rows_of(columns.stamps, columns.stamps_at, STAMP_SIZE, self.rows)
        poses = rows_of(columns.poses, columns.poses_at, POSE_SIZE, self.rows)
        return self.encoder.encode(seq, stamps, poses)


class StreamKeys(Protocol):
    """The keys of a stream; `expression` is a key expression that matches all of them."""

    expression: str

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of them now."""

    def divide(self, columns: Columns, epoch_ns: int) -> Sequence[RowsOfKey]:
        """Which rows go on which key, for these columns and all with the same edges."""

    def restart(self) -> None:
        """Number messages from 0 again."""

    def forget(self, child: str) -> None:
        """Forget the key of this frame."""

    def close(self) -> None:
        """End what it has declared. Twice is fine."""


# What a message takes besides its rows, and each row beside the names of its frames.
_HEAD_BYTES = 100
_ROW_BYTES = EDGE_SIZE + STAMP_SIZE + POSE_SIZE


def _name_bytes(frame: str) -> int:
    return len(frame.encode()) + 3


class OneKey:
    """All rows go on the stream's own key, as of `transforms_key`: in one message or, on a network
    that wants small ones, in as many as it takes.
    """

    def __init__(self, key: str, session: Session) -> None:
        self.expression = key
        self._most_bytes = session.network.message_bytes
        self._key = StreamKey(self.expression, session.publisher(self.expression, urgent=True))

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to it now."""
        return self._key.publisher.heard

    def divide(self, columns: Columns, epoch_ns: int) -> Sequence[RowsOfKey]:
        """All rows in one message, or in several."""
        if self._most_bytes and len(groups := self._groups(columns)) > 1:
            pairs = columns.pairs()
            return [
                _rows(self._key, columns.frames, [pairs[row] for row in rows], rows, epoch_ns)
                for rows in groups
            ]
        encoder = TransformEncoder(epoch_ns, columns.frames, columns.edges_bytes())
        return [RowsOfKey(self._key, None, encoder)]

    def _groups(self, columns: Columns) -> list[list[int]]:
        """The rows of each message; one row may be larger than a message should be."""
        groups: list[list[int]] = []
        left, named = 0, set[int]()
        for row, pair in enumerate(columns.pairs()):
            new = {*pair} - named
            size = _ROW_BYTES + sum(_name_bytes(columns.frames[each]) for each in new)
            if not groups or size > left:
                groups.append([])
                named = set()
                size = _ROW_BYTES + sum(_name_bytes(columns.frames[each]) for each in {*pair})
                left = self._most_bytes - _HEAD_BYTES
            groups[-1].append(row)
            named.update(pair)
            left -= size
        return groups

    def restart(self) -> None:
        """Number messages from 0 again."""
        self._key.sent = 0

    def forget(self, child: str) -> None:
        """It has no key of its own."""

    def close(self) -> None:
        """End what it has declared. Twice is fine."""
        self._key.publisher.close()


class KeyPerFrame:
    """Each child frame has a key below the stream's own: others can subscribe to it alone."""

    def __init__(self, key: str, session: Session) -> None:
        self._own_key = key
        self.expression = f"{self._own_key}/**"
        self._publishers = session.publishers_within(self.expression, urgent=True)
        self._keys: dict[str, StreamKey] = {}

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of them now."""
        return self._publishers.heard

    def divide(self, columns: Columns, epoch_ns: int) -> Sequence[RowsOfKey]:
        """A message a child frame."""
        pairs = columns.pairs()
        rows_by_child: dict[str, list[int]] = {}
        for row, (_, child) in enumerate(pairs):
            rows_by_child.setdefault(columns.frames[child], []).append(row)
        return [
            _rows(self._key(child), columns.frames, [pairs[row] for row in rows], rows, epoch_ns)
            for child, rows in rows_by_child.items()
        ]

    def restart(self) -> None:
        """Number messages from 0 again."""
        for key in self._keys.values():
            key.sent = 0

    def forget(self, child: str) -> None:
        """Forget the key of this frame; sent again, its messages are numbered from 0."""
        self._keys.pop(child, None)

    def close(self) -> None:
        """End what it has declared. Twice is fine."""
        self._publishers.close()

    def _key(self, child: str) -> StreamKey:
        if child not in self._keys:
            key = f"{self._own_key}/{escape(child)}"
            self._keys[child] = StreamKey(key, self._publishers.publisher(key))
        return self._keys[child]


def _rows(
    key: StreamKey,
    frames: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    rows: list[int],
    epoch_ns: int,
) -> RowsOfKey:
    """A message of some rows, with the names of their frames alone."""
    # On a key for each frame a frame nearly always has one row in a send.
    if len(rows) == 1:
        names = [frames[frame] for frame in pairs[0]]
        return RowsOfKey(key, rows, TransformEncoder(epoch_ns, names, ONE_EDGE))
    used = sorted({frame for pair in pairs for frame in pair})
    at = {frame: number for number, frame in enumerate(used)}
    edges = b"".join([pack("=2I", at[parent], at[below]) for parent, below in pairs])
    encoder = TransformEncoder(epoch_ns, [frames[frame] for frame in used], edges)
    return RowsOfKey(key, rows, encoder)
