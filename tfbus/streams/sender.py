"""Sends the dynamic transforms of a stream, on one key or one a frame, and keeps the last ones."""

import math
import sys
from array import array
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from operator import index
from struct import iter_unpack, pack
from typing import Protocol, SupportsFloat, SupportsIndex, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base import scheduler
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.structs import replace
from tfbus.bus.network_session import BytesPublisher
from tfbus.bus.query import Query
from tfbus.bus.session import Session
from tfbus.geometry import packed
from tfbus.geometry.columns import Columns, rows_of
from tfbus.geometry.packed import EDGE_SIZE, ONE_EDGE, POSE_SIZE, STAMP_SIZE
from tfbus.geometry.transform import TransformStamped
from tfbus.streams.retained import (
    Edges,
    FrameAnnouncer,
    HistorySpan,
    SentHistory,
    answer_from_history,
)
from tfbus.wire.descriptions import FLOAT32, FLOAT64, StreamDescription, check_poses
from tfbus.wire.keys import escape, transforms_key
from tfbus.wire.numbered import origin_of
from tfbus.wire.transforms import NumberedEncoder, TransformEncoder, in_order_of_messages


@dataclass(frozen=True)
class StreamOptions:
    """How a stream sends its dynamic transforms; all its broadcasters have the same options.

    With `split` each frame has a key of its own. Of two publishers of one frame, listeners with
    `conflicts="priority"` accept the one of higher `priority`, a 32-bit integer. Messages of the
    last `history_s` seconds are kept for listeners that join later. `poses` are "float64",
    "float32" or "compact". Raises InvalidArgumentException if one is invalid.
    """

    split: bool = False
    priority: int = 0
    history_s: float = 10.0
    poses: str = FLOAT64

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
        check_poses(self.poses)

    def __str__(self) -> str:
        poses = "" if self.poses == FLOAT64 else f", poses={self.poses}"
        return f"split={self.split}, priority={self.priority}, history_s={self.history_s:g}{poses}"


class EncoderOfOne(Protocol):
    """Writes messages of one transform between the same frames."""

    def encode(self, seq: int, transform: TransformStamped) -> bytes | None:
        """The payload of one message; None for a transform that takes `Encoder.encode`."""

    def encode_bytes(
        self, seq: int, frames: tuple[str, ...], stamp_ns: int, pose: bytes
    ) -> bytes | None:
        """The same of a pose as columns have it."""


class Encoder(Protocol):
    """Writes messages of the same rows."""

    def of_one(self, frame_id: str, child_frame_id: str) -> EncoderOfOne:
        """Writes the same messages, if they have one row, between these frames."""

    def encode(self, seq: int | None, stamps: bytes, poses: bytes) -> bytes:
        """The payload of one message, as of `TransformEncoder`."""


# Makes the encoder for rows with these frames and edges.
EncoderOf = Callable[[Sequence[str], bytes], Encoder]


class Numbering:
    """The numbers that a stream gives its frames, each a pair of parent and child, in one epoch;
    safe from any thread.

    A number is never given twice, also not in another epoch.
    """

    def __init__(self, epoch_ns: int, poses: str) -> None:
        self._poses = poses
        self._lock = scheduler.Lock()
        self._epoch_ns = epoch_ns
        self._next_number = 0
        # The number of each pair, and its origin.
        self._numbers: dict[tuple[str, str], tuple[int, bytes]] = {}

    @property
    def row_bytes(self) -> int:
        """How many bytes a row takes in a message."""
        return 29 if self._poses == FLOAT32 else 19

    @property
    def is_full(self) -> bool:
        """Whether `begin` should make room."""
        return len(self._numbers) > _MOST_EDGES

    def begin(self, epoch_ns: int) -> None:
        """An epoch begins, or goes on: all have other numbers from now on, and need encoders for
        them.
        """
        with self._lock:
            self._epoch_ns = epoch_ns
            self._numbers.clear()

    def add(self, columns: Columns) -> bool:
        """Give numbers to the pairs of these rows that have none; whether there were any."""
        poses = columns.poses_bytes()
        with self._lock:
            former = self._next_number
            for row, (parent, child) in enumerate(columns.pairs()):
                pair = columns.frames[parent], columns.frames[child]
                if pair not in self._numbers:
                    origin = origin_of(poses[POSE_SIZE * row : POSE_SIZE * (row + 1)])
                    self._numbers[pair] = self._next_number, origin
                    self._next_number += 1
            return self._next_number > former

    def remove(self, children: Collection[str]) -> None:
        """Child frames were removed: sent again, they have other numbers."""
        with self._lock:
            for pair in [pair for pair in self._numbers if pair[1] in children]:
                del self._numbers[pair]

    def encoder(self, frames: Sequence[str], edges: bytes) -> NumberedEncoder:
        """The encoder of rows that have numbers."""
        found = [
            self._numbers[frames[parent], frames[child]]
            for parent, child in iter_unpack("=2I", edges)
        ]
        return NumberedEncoder(
            self._epoch_ns,
            [number for number, _ in found],
            b"".join([origin for _, origin in found]),
            is_short=self._poses == FLOAT32,
        )

    def describe(self, description: StreamDescription) -> StreamDescription:
        """The description of the stream with the numbers of its epoch."""
        with self._lock:
            if description.epoch != self._epoch_ns:
                return replace(description, poses=self._poses)
            items = sorted(
                (number, parent, child, origin)
                for (parent, child), (number, origin) in self._numbers.items()
            )
            return replace(
                description,
                poses=self._poses,
                next_number=self._next_number,
                numbered=tuple(each[:3] for each in items),
                origins=in_order_of_messages(b"".join([each[3] for each in items])),
            )


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
    encoder: Encoder

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

    def divide(
        self, columns: Columns, encoder_of: EncoderOf, row_bytes: int = 0
    ) -> Sequence[RowsOfKey]:
        """The rows of each key, for these columns and all with the same edges; each takes
        `row_bytes`, 0 for that of one with names.
        """

    def restart(self) -> None:
        """Number messages from 0 again."""

    def forget(self, child: str) -> None:
        """Forget the key of this frame."""

    def close(self) -> None:
        """End its declarations. Twice is fine."""


# The bytes of a message besides its rows, and of each row beside the names of its frames.
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

    def divide(
        self, columns: Columns, encoder_of: EncoderOf, row_bytes: int = 0
    ) -> Sequence[RowsOfKey]:
        """All rows in one message, or in several."""
        if self._most_bytes and len(groups := self._groups(columns, row_bytes)) > 1:
            pairs = columns.pairs()
            return [
                _rows(self._key, columns.frames, [pairs[row] for row in rows], rows, encoder_of)
                for rows in groups
            ]
        encoder = encoder_of(columns.frames, columns.edges_bytes())
        return [RowsOfKey(self._key, None, encoder)]

    def _groups(self, columns: Columns, row_bytes: int) -> list[list[int]]:
        """The rows of each message; one row may be larger than a message should be."""
        groups: list[list[int]] = []
        left, named = 0, set[int]()
        for row, pair in enumerate(columns.pairs()):
            new = {*pair} - named
            size = row_bytes or _ROW_BYTES + sum(_name_bytes(columns.frames[each]) for each in new)
            if not groups or size > left:
                groups.append([])
                named = set()
                named_bytes = sum(_name_bytes(columns.frames[each]) for each in {*pair})
                size = row_bytes or _ROW_BYTES + named_bytes
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
        """End its declarations. Twice is fine."""
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

    def divide(
        self, columns: Columns, encoder_of: EncoderOf, row_bytes: int = 0
    ) -> Sequence[RowsOfKey]:
        """A message a child frame."""
        pairs = columns.pairs()
        rows_by_child: dict[str, list[int]] = {}
        for row, (_, child) in enumerate(pairs):
            rows_by_child.setdefault(columns.frames[child], []).append(row)
        return [
            _rows(self._key(child), columns.frames, [pairs[row] for row in rows], rows, encoder_of)
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
        """End its declarations. Twice is fine."""
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
    encoder_of: EncoderOf,
) -> RowsOfKey:
    """A message of some rows, with the names of their frames alone."""
    # On a key for each frame a frame nearly always has one row in a send.
    if len(rows) == 1:
        names = [frames[frame] for frame in pairs[0]]
        return RowsOfKey(key, rows, encoder_of(names, ONE_EDGE))
    used = sorted({frame for pair in pairs for frame in pair})
    at = {frame: number for number, frame in enumerate(used)}
    edges = b"".join([pack("=2I", at[parent], at[below]) for parent, below in pairs])
    encoder = encoder_of([frames[frame] for frame in used], edges)
    return RowsOfKey(key, rows, encoder)


# Stamps may go back by this much, as when a sensor's data comes twice or in bursts. By more, the
# clock itself was set back: a simulator was reset, or a recording starts again.
MOST_BACK_NS = 1_000_000_000

# No stamp is more than MOST_BACK_NS before it.
_NEVER = -(2**63) + MOST_BACK_NS

# Fewer stamps than this are judged one by one, more by numpy.
_MANY = 50

# Of 64 bits each.
Rows: TypeAlias = "array[int]"  # as a text, since Python 3.11 has no array[int]


class NewestStamps:
    """The newest stamp sent of each child frame. A caller names frames by rows, which are looked
    up together. Used by one thread at a time.
    """

    def __init__(self) -> None:
        self._row_of: dict[str, int] = {}
        self._free: list[int] = []
        self._newest = array("q")

    def rows(self, children: Sequence[str]) -> Rows:
        """The rows of these frames, valid until one of them is forgotten."""
        return array("q", [self._row(child) for child in children])

    def advance(self, rows: Rows, stamps_ns: Sequence[int]) -> int | None:
        """Note the stamps that are sent now, one a row; None if all are noted.

        `stamps_ns` has a buffer of signed integers of 64 bits. If one is more than 1 s older
        than the newest of its row, nothing is noted, and its position returned.
        """
        if len(rows) >= _MANY:
            return self._advance_many(rows, stamps_ns)
        newest = self._newest
        for position, (row, stamp_ns) in enumerate(zip(rows, stamps_ns, strict=True)):
            if stamp_ns < newest[row] - MOST_BACK_NS:
                return position
        for row, stamp_ns in zip(rows, stamps_ns, strict=True):
            # A row may come more than once.
            if stamp_ns > newest[row]:
                newest[row] = stamp_ns
        return None

    def _advance_many(self, rows: Rows, stamps_ns: Sequence[int]) -> int | None:
        # Views for this call only: an array with views cannot grow.
        newest, at = np.frombuffer(self._newest, np.int64), np.frombuffer(rows, np.int64)
        stamps = np.frombuffer(stamps_ns, np.int64)  # type: ignore[call-overload]
        too_old = stamps < newest[at] - MOST_BACK_NS
        if np.count_nonzero(too_old):
            return int(too_old.argmax())
        np.maximum.at(newest, at, stamps)
        return None

    def newest_ns(self, row: int) -> int:
        """The newest stamp of a row."""
        return self._newest[row]

    def forget(self, child: str) -> None:
        """Forget the stamp and the row of this frame."""
        row = self._row_of.pop(child, None)
        if row is not None:
            self._newest[row] = _NEVER
            self._free.append(row)

    def clear(self) -> None:
        """Forget all stamps; the rows stay valid."""
        self._newest = array("q", [_NEVER]) * len(self._newest)

    def advance_one(self, row: int, stamp_ns: int) -> int | None:
        """As `advance` of one row, in a fraction of the time."""
        newest_ns = self._newest[row]
        if stamp_ns < newest_ns - MOST_BACK_NS:
            return 0
        if stamp_ns > newest_ns:
            self._newest[row] = stamp_ns
        return None

    def _row(self, child: str) -> int:
        row = self._row_of.get(child)
        if row is None:
            row = self._row_of[child] = self._free.pop() if self._free else len(self._row_of)
            if row == len(self._newest):
                self._newest.append(_NEVER)
        return row


# The common parts of sends are cached for tables of at most this many edges in all.
_MOST_EDGES = 50_000

# New numbers are described after this time.
_ANNOUNCED_AFTER_S = 0.001

# Whether columns have the byte order of messages on this machine.
_AS_ON_THE_WIRE = sys.byteorder == "little"


@dataclass(slots=True, eq=False)
class _Table:
    """The part that sends of the same frames and edges share.

    `noted` is the announcer's count of `reparented` when these edges were last noted, `turn` the
    part that goes first next, on a bad network.
    """

    frames: tuple[str, ...]
    edges: bytes
    by_child: Edges
    noted: int
    stamp_rows: Rows
    first_stamp_row: int
    parts: Sequence[RowsOfKey]
    turn: int = 0


@dataclass(slots=True, eq=False)
class _Single:
    """The part that sends of one transform of the same frames share.

    `noted` is as in _Table. `sent_ns` is the newest stamp that was sent of the frame.
    """

    message: EncoderOfOne
    noted: int
    stamp_row: int
    key: StreamKey
    sent_ns: int


class TransformSender:
    """Sends the dynamic transforms of one stream, and answers queries for the last of them; safe
    from any thread.

    It calls `note(edges)` before it sends new edges, and `begin_epoch(child, back_ns)` if the
    stamps of a frame go back by more than 1 s: that returns the epoch of this send, in ns.
    """

    def __init__(
        self,
        stream: str,
        options: StreamOptions,
        epoch_ns: int,
        session: Session,
        frames: FrameAnnouncer,
        note: Callable[[Edges], None],
        begin_epoch: Callable[[str, int], int],
    ) -> None:
        self.options = options
        # The kinds of wrong stamps that were logged.
        self.warned_of: set[str] = set()
        self._epoch_ns = epoch_ns
        self._frames = frames
        self._note_edges = note
        self._begin_epoch = begin_epoch
        self._lock = scheduler.Lock()
        self._newest = NewestStamps()
        self._tables: dict[tuple[tuple[str, ...], bytes], _Table] = {}
        self._last_table: _Table | None = None
        # By their child frame.
        self._singles: dict[str, _Single] = {}
        self._edges_remembered = 0
        self._history = SentHistory(options.history_s) if options.history_s else None
        self._key = transforms_key(stream)
        self._takes_turns = session.network.is_bad
        self._keys: StreamKeys = (KeyPerFrame if options.split else OneKey)(self._key, session)
        is_numbered = options.poses != FLOAT64
        self.numbering = Numbering(epoch_ns, options.poses) if is_numbered else None
        self._queryable = (
            None
            if self._history is None
            else session.queryable(self._keys.expression, self._on_query, long=True)
        )

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of it now."""
        return self._keys.heard

    def send(self, columns: Columns) -> None:
        """Send transforms: one message a key.

        Raises InvalidArgumentException if a frame name is invalid, or parent and child are the
        same.
        """
        with self._lock:
            self._send(columns)

    def send_one(self, transform: TransformStamped) -> None:
        """Send one transform alone: as `send`, in a third of the time."""
        with self._lock:
            stamp_ns = transform.stamp_ns
            single = self._single(transform.child_frame_id, stamp_ns)
            payload = None
            if single is not None:
                payload = single.message.encode(single.key.sent, transform)
            if single is None or payload is None:
                frames = transform.frame_id, transform.child_frame_id
                self._send_first(frames, Columns.of_transforms((transform,)))
            else:
                self._send_again(single, payload, stamp_ns)

    def send_pose(self, frames: tuple[str, ...], stamp_ns: int, pose: bytes) -> None:
        """As `send_one`, of a transform of these frames, parent and child, with a pose as columns
        have it.
        """
        with self._lock:
            single = self._single(frames[1], stamp_ns)
            payload = None
            if single is not None:
                payload = single.message.encode_bytes(single.key.sent, frames, stamp_ns, pose)
            if single is None or payload is None:
                stamp = packed.stamp_bytes(stamp_ns)
                self._send_first(frames, Columns.of_bytes(frames, ONE_EDGE, stamp, pose))
            else:
                self._send_again(single, payload, stamp_ns)

    def _single(self, child: str, stamp_ns: int) -> _Single | None:
        """The part that sends of this frame alone share; None if that takes `send`."""
        single = self._singles.get(child)
        if single is None or stamp_ns < single.sent_ns or single.noted != self._frames.reparented:
            return None
        return single

    def _send_again(self, single: _Single, payload: bytes, stamp_ns: int) -> None:
        """Send a transform of the same frames as the last one.

        The put comes first and the rest after it: listeners need not wait for that.
        """
        key = single.key
        key.publisher.put(payload)
        key.sent += 1
        single.sent_ns = stamp_ns
        if self._history is not None:
            self._history.append(key.key, payload)
        self._newest.advance_one(single.stamp_row, stamp_ns)

    def _send_first(self, frames: tuple[str, ...], columns: Columns) -> None:
        """Send one transform, and keep the parts that the next ones of its frames share."""
        table = self._send(columns)
        if _AS_ON_THE_WIRE:
            self._singles[frames[1]] = _Single(
                table.parts[0].encoder.of_one(frames[0], frames[1]),
                table.noted,
                table.first_stamp_row,
                table.parts[0].key,
                columns.last_stamp_ns() or 0,
            )

    def _send(self, columns: Columns) -> _Table:
        table = self._table(columns)
        late = self._advance(table, columns)
        if late is not None:
            self._restart(columns, late, table.stamp_rows[late])
            table = self._table(columns)
            self._advance(table, columns)
        if not self._singles.keys().isdisjoint(table.by_child.keys()):
            for child in table.by_child:
                self._singles.pop(child, None)
        parts = table.parts
        if self._takes_turns and len(parts) > 1:
            # A link that is too narrow takes the first ones.
            parts = [*parts[table.turn :], *parts[: table.turn]]
            table.turn = (table.turn + 1) % len(parts)
        for part in parts:
            payload = part.encode(columns)
            part.key.publisher.put(payload)
            if self._history is not None:
                self._history.append(part.key.key, payload)
        return table

    def close(self) -> None:
        """Send and answer nothing from now on. Twice is fine."""
        with self._lock:
            if self._queryable is not None:
                self._queryable.close()
            self._keys.close()

    def wait_sent(self) -> None:
        """Wait for the end of a send on another thread."""
        with self._lock:
            pass

    def remove(self, *children: str) -> None:
        """Take frames out until they are sent again. Errors as FrameAnnouncer.remove."""
        self._frames.announce()
        with self._lock:
            self._frames.remove(*children, static=False)
            self._forget_tables()
            if self.numbering is not None:
                self.numbering.remove(children)
                self._frames.announce_soon()
            for child in children:
                self._newest.forget(child)
                self._keys.forget(child)
                if self._history is not None:
                    self._history.remove(child)

    def _advance(self, table: _Table, columns: Columns) -> int | None:
        """Note the stamps; if one is too far back, note none and return its row."""
        if columns.count == 1:
            return self._newest.advance_one(table.first_stamp_row, columns.last_stamp_ns() or 0)
        return self._newest.advance(table.stamp_rows, memoryview(columns.stamps_bytes()).cast("q"))

    def _table(self, columns: Columns) -> _Table:
        edges, frames = columns.edges, columns.frames
        last = self._last_table
        if last is None or last.edges != edges or last.frames != frames:
            known = self._tables.get((frames, edges))
            last = self._last_table = known or self._remember(columns, edges)
        if last.noted != self._frames.reparented:
            self._note_edges(last.by_child)
            last.noted = self._frames.reparented
        return last

    def _remember(self, columns: Columns, edges: bytes) -> _Table:
        frames = columns.frames
        rows = [(frames[parent], frames[child]) for parent, child in columns.pairs()]
        by_child = {child: (parent, False) for parent, child in rows}
        self._note_edges(by_child)
        if self._edges_remembered + len(rows) > _MOST_EDGES:
            self._forget_tables()
        if self.numbering is not None and self.numbering.is_full:
            self.numbering.begin(self._epoch_ns)
            # Their encoders have numbers that the description has no longer.
            self._forget_tables()
        self._edges_remembered += max(len(rows), 1)
        stamp_rows = self._newest.rows([child for _, child in rows])
        table = _Table(
            frames,
            edges,
            by_child,
            self._frames.reparented,
            stamp_rows,
            stamp_rows[0] if rows else 0,
            self._parts_of(columns),
        )
        self._tables[frames, edges] = table
        return table

    def _parts_of(self, columns: Columns) -> Sequence[RowsOfKey]:
        numbering = self.numbering
        if numbering is None:
            return self._keys.divide(columns, partial(TransformEncoder, self._epoch_ns))
        if numbering.add(columns):
            # Listeners hold messages back until it comes.
            self._frames.announce_soon(_ANNOUNCED_AFTER_S)
        return self._keys.divide(columns, numbering.encoder, numbering.row_bytes)

    def _forget_tables(self) -> None:
        self._tables.clear()
        self._singles.clear()
        self._last_table = None
        self._edges_remembered = 0

    def _restart(self, columns: Columns, late: int, stamp_row: int) -> None:
        stamp_ns = packed.stamp_at(columns.stamps, columns.stamps_at + STAMP_SIZE * late)
        back_ns = self._newest.newest_ns(stamp_row) - stamp_ns
        child = columns.frames[columns.pairs()[late][1]]
        self._epoch_ns = self._begin_epoch(child, back_ns)
        if self.numbering is not None:
            self.numbering.begin(self._epoch_ns)
        self._newest.clear()
        self._keys.restart()
        self._forget_tables()
        if self._history is not None:
            self._history.clear()

    def _on_query(self, query: Query) -> None:
        answer_from_history(query, self._key, self._span)

    def _span(self, last_s: float, place: str) -> HistorySpan:
        assert self._history is not None
        with self._lock:
            return self._history.span(last_s, place)
