"""The listener: transforms from the bus go into a buffer."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, get_args

from tfbus.buffer.buffer import Buffer
from tfbus.bus.handles import Declaration
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.discover.other_namespaces import frames_elsewhere, where_to_look
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.transform import check_frame_id
from tfbus.listen.claims import Claimant, Rule, name_some
from tfbus.listen.clock_offset import ClockOffsets
from tfbus.listen.conflicts import Conflicts
from tfbus.listen.info import StreamInfo, stream_info
from tfbus.listen.interest import Interest
from tfbus.listen.names import StreamNames
from tfbus.listen.past import AskedHistory
from tfbus.listen.reading import Everything, Reading
from tfbus.listen.reception import DynamicReception, StaticReception, StreamReception
from tfbus.listen.static_recovery import StaticRecovery
from tfbus.listen.watch import MOST_GONE, StreamState, StreamWatch
from tfbus.node.node import Node
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.runtime.executor import Executor
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import (
    STATIC_TRANSFORMS,
    stream_of,
    transforms_key_beside,
)

# Names come from the bus: of more keys than these no dynamic transforms are taken.
MOST_KEYS = 200_000

# A stream without a token that says nothing for so long may be forgotten.
_SILENT_NS = 60 * 10**9

# What a listener reads.
Reads = Literal["everything", "needed"]


class TransformListener:
    """Fills a buffer with the transforms that others send, and keeps it up to date.

    It works on threads of its own: there is nothing to spin, and a lookup may wait anywhere.
    The authority of a transform is the stream that it came in. A message that cannot be read is
    counted by its stream, reported once, and dropped; a transform that the buffer refuses is
    counted there, and reported once a stream. `dropped` counts messages on keys that were too many.

    Frames whose publisher is gone are marked so in the buffer. With `history_s` each stream is
    asked for what it sent in so many seconds before it was met; lookups of the past that have a
    timeout wait for that. `conflicts` is what wins where two living publishers send one frame:
    "latest", whoever sent last, as in tf2; "first", who was started first; or "priority", whose
    stream has the higher priority, or else was first.

    With `reads="needed"` only those streams are read that lookups in the buffer need, by what the
    streams say of their frames. The first lookup of two frames has to wait for them, so give it a
    `timeout_s`; or say with `need` what will be looked up.

    With a `fleet` the robots in the namespaces below the node's are read too, and their frames
    have the namespace in front: `robot7/base_link`.
    """

    def __init__(
        self,
        buffer: Buffer,
        node: Node,
        *,
        history_s: float = 0.0,
        conflicts: Rule = "latest",
        reads: Reads = "everything",
        fleet: Fleet | None = None,
    ) -> None:
        if not 0.0 <= history_s < float("inf"):
            raise InvalidArgumentException(
                f"history_s is {history_s!r}; it is a number of seconds, 0 or more"
            )
        if reads not in get_args(Reads):
            raise InvalidArgumentException(
                f"reads={reads!r} is not known; choose one of {', '.join(get_args(Reads))}"
            )
        self.buffer = buffer
        self._node = node
        self._log = node.log
        self._names = StreamNames(fleet)
        self._is_fleet = fleet is not None
        self._streams: dict[str, StreamReception] = {}
        self._conflicts = Conflicts(conflicts, buffer, self._streams, node.log)
        self._receptions: dict[str, DynamicReception | StaticReception] = {}
        # Of each split stream the keys of the frames that it has.
        self._split_keys: dict[str, set[str]] = {}
        self.dropped = 0
        self._seen: dict[str, StreamState] = {}
        self._lost: set[str] = set()
        self._forget_from = 2 * MOST_GONE
        # The keys that are read, where not everything is.
        self._read: set[str] = set()
        # The streams whose static transforms are read; "" are all.
        self._static_streams: set[str] = set()
        self._executor = Executor(f"{node.full_name} streams", node.log)
        self._history = AskedHistory(node.session, buffer, self._executor, history_s)
        self._recovery = StaticRecovery(node.session, node.log, self._executor)
        self._closed = False
        if buffer.clock is SYSTEM_CLOCK:
            buffer.clock = node.clock
        # Under simulated time no stamp is made by a system's clock.
        self._offsets = ClockOffsets(node.session, node.log, warns=not node.clock.is_simulated)
        node.clock.add_jump_callback(self._on_jump_back)
        node.tell_of_buffer(self._describe_buffer)
        everywhere = fleet is not None
        self._reading: Reading = (
            Interest(buffer, self._subscribe, self._forget, log=node.log)
            if reads == "needed"
            else Everything(self._subscribe, everywhere=everywhere)
        )
        self._watch = StreamWatch(
            node.session,
            self._on_stream,
            everywhere=everywhere,
            log=node.log,
            executor=self._executor,
        )
        self._forget_close = node.session.at_close(self.close)

    def __enter__(self) -> "TransformListener":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Listen no more; the buffer keeps what it has. Twice is fine."""
        if not self._closed:
            self._closed = True
            self._forget_close()
            self._watch.close()
            self._reading.close()
            self._recovery.close()
            self._history.close()
            self._executor.close()
            self._offsets.close()
            self._node.clock.remove_jump_callback(self._on_jump_back)
            self._node.forget_buffer(self._describe_buffer)

    def _describe_buffer(self) -> dict[str, Any]:
        short = self.buffer.expired_lookups
        return {
            "cache_time_s": self.buffer.cache_time_s,
            "too_old": short.count,
            "missed_by_s": short.missed_by_ns / 1e9,
            "dropped": self.dropped,
        }

    def need(self, target_frame: str, source_frame: str) -> None:
        """Read what a lookup of these frames needs, from now until the listener is closed.

        So the first lookup has it already, and nothing of it is left where there is none for long.
        """
        self._reading.need(check_frame_id(target_frame), check_frame_id(source_frame))

    def where_to_look(self, frame: str = "") -> str:
        """Which namespaces below know a frame, or any frame at all, in words; "" where none does,
        or where a fleet is listened to. Asks all streams, and so takes a moment.
        """
        return "" if self._is_fleet else where_to_look(frames_elsewhere(self._node.session), frame)

    @property
    def rejected(self) -> Counter[str]:
        """How many messages could not be read, by their stream."""
        streams = list(self._streams.values())
        return Counter({stream.name: stream.rejected for stream in streams if stream.rejected})

    def streams(self) -> list[StreamInfo]:
        """What is known of each stream, sorted by name."""
        states = {name: self._names.called(state) for name, state in self._watch.streams().items()}
        receptions = dict(self._streams)
        infos = [
            stream_info(name, states.get(name), receptions.get(name))
            for name in sorted(states.keys() | receptions.keys())
        ]
        offsets = [self._offsets.of(info.session) for info in infos]
        return [
            info if offset is None else replace(info, clock_offset_s=offset.offset_s)
            for info, offset in zip(infos, offsets, strict=True)
        ]

    def _on_message(self, key: str, payload: bytes) -> None:
        reception = self._receptions.get(key) or self._meet(key)
        if reception is not None:
            reception.receive(payload)

    def _meet(self, key: str) -> DynamicReception | StaticReception | None:
        is_static = STATIC_TRANSFORMS in key.split("/")
        if len(self._receptions) >= MOST_KEYS and not is_static:
            self._drop(key)
            return None
        stream = self._stream(key)
        if not is_static:
            self._history.meet(stream.name)
        made = (StaticReception if is_static else DynamicReception)(stream)
        # Two threads may come here at once: one of theirs is kept.
        return self._receptions.setdefault(key, made)

    def _drop(self, key: str) -> None:
        self.dropped += 1
        if self.dropped == 1:
            self._log.warning(
                "Dropped a message on %r: transforms come on more than %d keys, and no more are "
                "taken. Let streams of many frames not be split. More of them are only counted",
                key,
                MOST_KEYS,
            )

    def _stream(self, key: str) -> StreamReception:
        name = stream_of(key)
        known = self._streams.get(name)
        if known is None and len(self._streams) >= self._forget_from:
            self._executor.submit("streams", self._forget_strangers, limit=1)
        return known or self._streams.setdefault(
            name,
            StreamReception(
                name,
                self.buffer,
                self._log,
                self._node.now_ns,
                self._names.reader(key),
                self._on_overlap,
                self._on_takeover,
            ),
        )

    def _on_overlap(self, name: str, frames: frozenset[str]) -> None:
        self._executor.submit("conflicts", lambda: self._conflicts.restore(name, frames))

    def _on_takeover(self, name: str, epoch_ns: int) -> None:
        self._executor.submit("streams", lambda: self._learn_again(name, epoch_ns))

    def _learn_again(self, name: str, epoch_ns: int) -> None:
        """Another process is it that sends the stream now: what was known is of the former."""
        state = self._seen.get(name)
        if state is not None and not self._closed:
            self._seen[name] = replace(state, description=None)
            self._watch.ask_again(state.key, epoch_ns)

    def _on_jump_back(self, now_ns: int) -> None:
        """The clock was set back: what lies in its future now has not happened."""
        self.buffer.clear(after_ns=now_ns)

    # Who is there

    def _on_stream(self, state: StreamState) -> None:
        """Called for one change of one stream at a time."""
        described, state = state, self._names.called(state)
        former = self._seen.get(state.name, StreamState(state.name))
        self._seen[state.name] = state
        stream = self._stream(state.key)
        description = state.description
        if former.alive and not state.alive:
            self._history.leave(self._reading.keys_of(state.key), state.name)
            self._offsets.forget(state.name)
            self._lost.add(state.name)
            stream.vanish()
            self._tell_gone(state)
        elif state.alive and not former.alive:
            stream.appear()
            if state.name in self._lost:
                self._lost.discard(state.name)
                self._log.info("Stream %s is back", _who(state))
        if description is not None and description != former.description:
            children = frozenset(child for _, child, _ in description.frames)
            statics = frozenset(child for _, child, static in description.frames if static)
            publisher = (description.node, description.pid, description.session)
            stream.describe(
                description.epoch, children, statics, publisher if description.session else None
            )
            self._forget_removed(described)
        if state.alive and self._static_streams & {"", state.name}:
            self._recovery.check(state.key, stream)
        self._conflicts.judge(state.name, description if state.alive else None)
        for key in self._reading.keys_of(state.key):
            self._get_to_know(state, key)
        self._reading.update(described, self._names.at(state.key))

    def _forget_removed(self, described: StreamState) -> None:
        """The keys of frames that a split stream has no more make room for others."""
        description = described.description
        if description is not None and description.split:
            keys = {
                transforms_key_beside(described.key, child)
                for _, child, static in description.frames
                if not static
            }
            for key in self._split_keys.get(described.name, set()) - keys:
                self._receptions.pop(key, None)
            self._split_keys[described.name] = keys

    def _tell_gone(self, state: StreamState) -> None:
        frames = sorted(self.buffer.sent_by(state.name))
        if frames and self._node.ok:
            self._log.warning(
                "Stream %s is gone; what it sent last stays, marked as gone: %s",
                _who(state),
                name_some(frames),
            )

    def _forget_strangers(self) -> None:
        """Streams that went long ago, or never had a token and are silent, are not counted any
        more: their names come from the bus.
        """
        if len(self._streams) < self._forget_from:
            return
        known = self._watch.streams()
        silent_since_ns = time.time_ns() - _SILENT_NS
        for name, stream in list(self._streams.items()):
            is_silent = (stream.last_heard_ns or 0) < silent_since_ns
            if name not in known and (name in self._seen or is_silent):
                self._seen.pop(name, None)
                self._lost.discard(name)
                self._streams.pop(name, None)
                self._split_keys.pop(name, None)
        for key, reception in list(self._receptions.items()):
            if reception.stream.name not in self._streams:
                self._receptions.pop(key, None)
        self._forget_from = len(self._streams) + MOST_GONE

    def _get_to_know(self, state: StreamState, key: str) -> None:
        """Learn of a living stream, one of whose keys is read, what its messages do not say."""
        description = state.description
        if not state.alive or description is None:
            return
        self._offsets.watch(state.name, description)
        if description.history_s > 0.0:
            self._history.ask(key, self._streams[state.name])
        elif any(not static for _, _, static in description.frames):
            self._history.keeps_nothing(state.name)

    # What is read

    def _subscribe(self, stream: str, key: str, static: bool) -> Declaration:
        session = self._node.session
        state = self._seen.get(stream)
        on_message = self._while_read(key) if stream else self._on_message
        if static:
            self._static_streams.add(stream)
            declaration = declare_retained_subscriber(session, key, on_message)
            if state is not None and state.alive:
                self._recovery.check(state.key, self._streams[stream])
            return declaration
        if state is not None:
            self._history.expect(state.name)
        declaration = session.subscriber(key, on_message)
        if state is not None:
            self._get_to_know(state, key)
        return declaration

    def _while_read(self, key: str) -> Callable[[str, bytes], None]:
        """What takes the messages of a key: some may still be on their way when it is left."""
        self._read.add(key)

        def on_message(at: str, payload: bytes) -> None:
            if key in self._read:
                self._on_message(at, payload)

        return on_message

    def _forget(self, stream: str, key: str, frames: set[str]) -> None:
        """A key is read no more: what it brought would only grow old."""
        self._read.discard(key)
        self._history.leave([key], stream)
        reception = self._stream(key)
        self._receptions.pop(key, None)
        if STATIC_TRANSFORMS in key.split("/"):
            self._static_streams.discard(stream)
            self._recovery.leave(stream)
            reception.forget_statics()
        self.buffer.remove_sent(frames, stream)


def _who(state: StreamState) -> str:
    """A stream, and as far as it is known who publishes it."""
    return str(Claimant(state.name, state.description)) if state.description else repr(state.name)
