"""A recorded stream on the bus again: its name, its epochs and its messages."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

from tfbus.base import scheduler
from tfbus.base.errors import BusError, InvalidArgumentException
from tfbus.bus.network_session import Declaration
from tfbus.bus.query import Query
from tfbus.bus.retained import declare_retained_publisher
from tfbus.geometry.columns import Columns
from tfbus.node.node import Node
from tfbus.recording.items import RecordedStream
from tfbus.streams.retained import (
    FrameAnnouncer,
    FrameRows,
    HistorySpan,
    SentHistory,
    answer_from_history,
)
from tfbus.streams.sender import KeyPerFrame, OneKey, RowsOfKey, StreamKeys
from tfbus.wire.descriptions import StreamDescription, encode_stream
from tfbus.wire.keys import (
    check_namespace,
    check_no_transforms,
    check_topic,
    escape,
    static_transforms_key_beside,
    transforms_key_beside,
)
from tfbus.wire.transforms import TransformEncoder, TransformMessage, encode_transforms


@dataclass(frozen=True)
class ReplayedNames:
    """`prefix` is a namespace that all names go into, "" for none. `remappings` have another name
    for some, which gets no prefix. Names are full, with or without a slash before them.

    Raises InvalidNameError if the prefix is no namespace, or nothing can have a new name.
    """

    prefix: str = ""
    remappings: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "prefix", check_namespace(self.prefix))
        pairs = {
            old.lstrip("/"): check_topic(new.lstrip("/"), kind="topic or stream")
            for old, new in self.remappings.items()
        }
        object.__setattr__(self, "remappings", pairs)

    def topic(self, name: str) -> str:
        """The name of a topic. Raises InvalidNameError if no topic can have it."""
        new = self.remappings.get(name) or self._below(name)
        return check_no_transforms(check_topic(new))

    def stream(self, stream: RecordedStream) -> str:
        """The name of a stream."""
        return self.remappings.get(stream.name) or self._below(stream.name)

    def stream_key(self, stream: RecordedStream) -> str:
        """The key of a stream's token and description, as `wire.keys.stream_key` with its namespace
        before it.
        """
        if new := self.remappings.get(stream.name):
            namespace, _, own = new.rpartition("/")
        else:
            namespace = self._below(stream.namespace) if stream.namespace else self.prefix
            own = stream.name.removeprefix(f"{stream.namespace}/" if stream.namespace else "")
        key = f"@tfbus/stream/{escape(own)}"
        return f"{check_namespace(namespace)}/{key}" if namespace else key

    def _below(self, name: str) -> str:
        return f"{self.prefix}/{name}" if self.prefix else name


# Epochs of one run: more than a stream has in a recording. In ns, a millisecond.
_APART_NS = 1_000_000


class StreamEpochs:
    """Gives each recorded epoch one of now, in the same order.

    Within a run, from one jump back to the next, a restart of a publisher is one again. Each run
    comes after the one before, so that listeners forget that. `recorded` are streams and their
    epochs.
    """

    def __init__(
        self,
        recorded: Iterable[tuple[str, int]],
        clock_ns: Callable[[], int] = lambda: scheduler.time_ns(),
    ) -> None:
        self._clock_ns = clock_ns
        self._run_ns = 0
        self._recorded: dict[str, list[int]] = {}
        for stream, epoch_ns in sorted(set(recorded)):
            self._recorded.setdefault(stream, []).append(epoch_ns)

    def begin_run(self) -> None:
        """From now on all epochs are later than the ones before."""
        self._run_ns = max(self._clock_ns(), self._run_ns + _APART_NS)

    def of(self, stream: str, epoch_ns: int) -> int:
        """The epoch now, in ns, of a recorded one."""
        return self._run_ns + bisect_left(self._recorded.get(stream, []), epoch_ns)


# How long a stream without a description keeps its messages, as a TransformBroadcaster does.
_HISTORY_S = 10.0

# The common parts of messages of the same frames are kept for this many tables of frames.
_MOST_TABLES = 1000


class ReplayedStream:
    """Publishes one recorded stream; `key` is its token's, as of `wire.keys.stream_key`.

    If it `is_described`, descriptions come by `describe`, and `description` only says how it
    sends: split or not, and for how long it keeps messages. Otherwise `description` is sent with
    the frames that were sent so far. Messages are kept by `time_ns`. Used by one thread at a time.
    """

    def __init__(
        self,
        name: str,
        key: str,
        description: StreamDescription,
        node: Node,
        *,
        is_described: bool,
        time_ns: Callable[[], int] = lambda: scheduler.monotonic_ns(),
    ) -> None:
        self.name = name
        self._key = key
        self._is_described = is_described
        self._node = node
        own_key = transforms_key_beside(key)
        keys = (KeyPerFrame if description.split else OneKey)(own_key, node.session)
        self._keys: StreamKeys = keys
        self._lock = scheduler.Lock()
        if not is_described:
            description = replace(description, history_s=_HISTORY_S)
        self._description = description
        self._history = SentHistory(description.history_s, clock_ns=time_ns)
        node.session.queryable(keys.expression, self._on_query, long=True)
        self._tables: dict[tuple[tuple[str, ...], bytes], Sequence[RowsOfKey]] = {}
        self._life: _Life | None = None
        self._epoch_ns = description.epoch
        self._is_gone = False

    @property
    def is_there(self) -> bool:
        """Whether it has its token."""
        return self._life is not None

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to its dynamic transforms now."""
        return self._keys.heard

    @property
    def is_unread(self) -> bool:
        """Whether it has sent dynamic transforms, and no process subscribes to them now."""
        return bool(self._tables) and not self._keys.heard

    def describe(self, description: StreamDescription) -> None:
        """It is there, with this description."""
        # Whether its frames have keys of their own was settled when it was declared.
        self._description = description = replace(description, split=self._description.split)
        self._is_gone = False
        self._living().describe(description)

    def vanish(self) -> None:
        """Its publisher is gone, with its kept messages."""
        self._is_gone = True
        if self._life is not None:
            self._life.end()
            self._life = None
            self._forget_sent()

    def withdraw(self, epoch_ns: int) -> None:
        """It has not been there yet: listeners forget all that it has sent.

        A stream without descriptions stays, since nothing says when it came.
        """
        if not self._is_described:
            self._begin_epoch(epoch_ns)
        elif self._life is not None:
            self._life.describe(replace(self._description, epoch=epoch_ns, frames=()))
            self._life.send_static(Columns((), 0), epoch_ns)
            self.vanish()
        self._is_gone = False

    def send(self, rows: Columns, epoch_ns: int) -> None:
        """Send dynamic transforms."""
        self._begin_epoch(epoch_ns)
        if not self._is_described:
            self._living()
        parts = self._parts(rows)
        for part in parts:
            payload = part.encode(rows)
            part.key.publisher.put(payload)
            with self._lock:
                self._history.append(part.key.key, payload)

    def send_static(self, rows: Columns, epoch_ns: int) -> None:
        """Send all its static transforms, in place of the former set."""
        self._begin_epoch(epoch_ns)
        if self._is_gone:
            return
        self._living().send_static(rows, epoch_ns)
        if not self._is_described:
            self._announce(rows, static=True)

    def _living(self) -> "_Life":
        if self._life is None:
            self._life = _Life(self._key, self._node, self._describe)
            if not self._is_described:
                self._life.frames.announce_soon()
        return self._life

    def _parts(self, rows: Columns) -> Sequence[RowsOfKey]:
        table = rows.frames, rows.edges_bytes()
        parts = self._tables.get(table)
        if parts is None:
            if len(self._tables) >= _MOST_TABLES:
                self._tables.clear()
            if not self._is_described:
                self._announce(rows, static=False)
            parts = self._tables[table] = self._keys.divide(
                rows, partial(TransformEncoder, self._epoch_ns)
            )
        return parts

    def _begin_epoch(self, epoch_ns: int) -> None:
        if epoch_ns == self._epoch_ns:
            return
        self._epoch_ns = epoch_ns
        self._forget_sent()
        if not self._is_described:
            self._description = replace(self._description, epoch=epoch_ns)
            if self._life is not None:
                self._life.frames.announce_soon()

    def _forget_sent(self) -> None:
        self._tables.clear()
        self._keys.restart()
        with self._lock:
            self._history.clear()

    def _announce(self, rows: Columns, *, static: bool) -> None:
        frames = rows.frames
        edges = {frames[child]: (frames[parent], static) for parent, child in rows.pairs()}
        # A name that no frame can have was recorded as it came, and is sent so.
        with suppress(InvalidArgumentException):
            self._living().frames.add(edges)

    def _describe(self, frames: FrameRows) -> bytes:
        """The description of a stream that was recorded without one."""
        return encode_stream(replace(self._description, frames=frames))

    def _on_query(self, query: Query) -> None:
        answer_from_history(query, transforms_key_beside(self._key), self._span)

    def _span(self, last_s: float, place: str) -> HistorySpan:
        with self._lock:
            return self._history.span(last_s, place)


class _Life:
    """The declarations of a stream on the bus from its first description until it is gone."""

    def __init__(self, key: str, node: Node, describe: Callable[[FrameRows], bytes]) -> None:
        session = node.session
        self._static_key = static_transforms_key_beside(key)
        self._descriptions = declare_retained_publisher(session, key)
        self._statics = declare_retained_publisher(session, self._static_key)
        self._static_payload = b""
        self._statics_sent = 0
        self._static_epoch_ns: int | None = None
        self.frames = FrameAnnouncer(key, self._descriptions, describe, node.executor)
        self._parts: list[Declaration] = [
            self._descriptions,
            self._statics,
            session.queryable(self._static_key, self._on_static_query, long=True),
            session.token(key),
        ]

    def describe(self, description: StreamDescription) -> None:
        """Send a description."""
        self._descriptions.put(encode_stream(description))

    def send_static(self, rows: Columns, epoch_ns: int) -> None:
        """Send the whole set."""
        if epoch_ns != self._static_epoch_ns:
            self._static_epoch_ns, self._statics_sent = epoch_ns, 0
        message = TransformMessage(rows, epoch_ns, self._statics_sent)
        self._statics_sent += 1
        self._static_payload = encode_transforms(message)
        self._statics.put(self._static_payload)

    def end(self) -> None:
        """The token goes first."""
        for part in reversed(self._parts):
            part.close()

    def _on_static_query(self, query: Query) -> None:
        with suppress(BusError), query.answering("the static transforms"):
            if self._static_payload:
                query.answer(self._static_key, self._static_payload)
