"""The listener: transforms from the bus go into a buffer."""

import math
from collections import Counter
from collections.abc import Set
from typing import Any, Literal, SupportsFloat, get_args

from tfbus.base import scheduler
from tfbus.base.arguments import called_as
from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.structs import replace
from tfbus.base.wording import is_printable, quoted
from tfbus.buffer.buffer import Buffer
from tfbus.bus.callbacks import OnSample
from tfbus.bus.network_session import Declaration
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.geometry.transform import check_frame_id
from tfbus.node.node import Node
from tfbus.streams.clock_offset import ClockOffsets
from tfbus.streams.conflicts import Claimant, Conflicts, Rule
from tfbus.streams.frame_names import StreamNames, StreamRights
from tfbus.streams.history import AskedHistory
from tfbus.streams.info import StreamInfo, StreamState, described_stream
from tfbus.streams.interest import Everything, Interest, Reading
from tfbus.streams.queries import StaticRecovery
from tfbus.streams.reception import (
    DynamicReception,
    StaticReception,
    StreamReception,
)
from tfbus.streams.registry import (
    FRAME_BYTES,
    JUDGED_BYTES,
    KEY_BYTES,
    ROW_BYTES,
    STREAM_BYTES,
    Budget,
    KnownStream,
    Registry,
    StillSending,
    UnlistedFrames,
    is_static,
)
from tfbus.streams.stream_facts import ReceptionHooks
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import is_of_ros
from tfbus.wire.fleet import Fleet
from tfbus.wire.keys import is_foreign, static_transforms_key_beside, stream_of

# Whether a listener reads all streams, or the ones that lookups need.
Reads = Literal["everything", "needed"]


# The description of new frames follows their first message at once, unless it is lost.
_NAMED_WITHIN_S = 0.25

# Streams that are long gone, where there are many, are forgotten within this time.
_TIDY_EVERY_S = 30.0


class TransformListener:
    """Fills a buffer with the transforms on the bus, and keeps it up to date.

    It works on its own threads: there is nothing to spin, and a lookup may wait on any thread. The
    authority of a transform is the name of its stream. A message that cannot be read is dropped and
    counted by its stream; a transform that the buffer refuses is counted there. The first of each
    is logged for every stream.

    Frames whose publisher is gone are marked as gone in the buffer. With `history_s`, the listener
    queries the last `history_s` seconds of each stream when the stream appears; lookups of the past
    with a timeout wait for them. `conflicts` decides which of two live publishers of one frame
    wins: "latest", the last to send, as in tf2; "first", the first started; "priority", the stream
    with the higher priority, and of equal ones the first started.

    With `reads="needed"`, it subscribes only to the streams that lookups in the buffer need. The
    first lookup of two frames has to wait for their streams, so give it a `timeout_s`, or name the
    frames in advance with `need`.

    With a `fleet`, it also receives the robots in the namespaces below the node's, and prefixes
    their frames with the namespace: `robot7/base_link`. Together with `reads="needed"`, it asks
    only the robots that are looked up for their frames, and who lists a shared frame.

    Raises InvalidArgumentException for any other value of an argument.
    """

    # Whether it takes its own session's transforms.
    _hears_itself = True

    @called_as("TransformListener(buffer, node)")
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
        if not isinstance(buffer, Buffer) or not isinstance(node, Node):
            raise InvalidArgumentException(
                "a TransformListener takes a Buffer and a Node, in this order: "
                "TransformListener(buffer, node), not "
                f"({type(buffer).__name__}, {type(node).__name__})"
            )
        if not isinstance(history_s, SupportsFloat) or not 0.0 <= float(history_s) < math.inf:
            raise InvalidArgumentException(
                f"history_s must be a number of seconds, 0 or more, not {history_s!r}"
            )
        if reads not in get_args(Reads):
            raise InvalidArgumentException(
                f"reads must be one of {', '.join(get_args(Reads))}, not {reads!r}"
            )
        if fleet is not None and not isinstance(fleet, Fleet):
            raise InvalidArgumentException(
                f"fleet must be a tfbus.Fleet, or None, not a {type(fleet).__name__}"
            )
        self.buffer = buffer
        self._node = node
        self._log = node.log
        self._names = StreamNames(fleet)
        self._is_fleet = fleet is not None
        self._rights = StreamRights.of_settings(node.settings)
        # Kinds with names of streams may crowd each other out, so these have a log of their own.
        self._refusals = LogOnce(node.log)
        self._around = _ListenerHooks(self)
        self._budget = Budget()
        self._registry = Registry(
            self._make_reception, self._forget_unconfirmed, self._on_forgotten
        )
        self._conflicts = Conflicts(conflicts, buffer, self._registry.reception, node.log)
        self._reads_everything = reads == "everything"
        self._executor = Executor(f"{node.full_name} streams", node.log)
        self._history = AskedHistory(node.session, buffer, self._executor, history_s)
        self._recovery = StaticRecovery(node.session, node.log, self._executor)
        self._unlisted = UnlistedFrames(self._registry, self._executor)
        # Streams with messages that wait for the names of their frames.
        self._unnamed: set[str] = set()
        self._foreign = 0
        self._closed = False
        if buffer.clock is SYSTEM_CLOCK:
            buffer.clock = node.clock
        # Under simulated time no stamp comes from a system's clock.
        self._offsets = ClockOffsets(node.session, node.log, warns=not node.clock.is_simulated)
        node.clock.add_jump_callback(self._on_jump_back)
        node.describers.append(self._describe_buffer)
        node.buffers.append(buffer)
        everywhere = fleet is not None
        self._reading: Reading = (
            Everything(self._subscribe, everywhere=everywhere)
            if self._reads_everything
            else Interest(buffer, self._subscribe, self._forget, log=node.log)
        )
        self._watch = StreamWatch(
            node.session,
            self._on_stream,
            everywhere=everywhere,
            only_wanted=everywhere and not self._reads_everything,
            log=node.log,
            executor=self._executor,
            is_heard=self._is_heard,
            on_unwanted=self._on_unwanted,
        )
        if fleet is not None:
            self._reading.find(fleet, self._want)
        self._still_sending = StillSending(self._registry, self._watch, self._executor)
        self._executor.every(_TIDY_EVERY_S, self._forget_unconfirmed)
        self._forget_close = node.session.at_close(self.close)

    def __enter__(self) -> "TransformListener":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        closed = ", closed" if self._closed else ""
        return f"<TransformListener of {self._node.full_name}{closed}>"

    def close(self) -> None:
        """Stop listening; the buffer keeps its transforms. Twice is fine."""
        if not self._closed:
            self._closed = True
            self._forget_close()
            self._watch.close()
            self._reading.close()
            for stream in self._registry.streams().values():
                stream.reception.statics.close()
            self._recovery.close()
            self._history.close()
            self._executor.close()
            self._offsets.close()
            self._node.clock.remove_jump_callback(self._on_jump_back)
            self._node.describers.remove(self._describe_buffer)
            self._node.buffers.remove(self.buffer)

    def _describe_buffer(self) -> dict[str, list[Any]]:
        short = self.buffer.expired_lookups
        described = {
            "cache_time_s": self.buffer.cache_time_s,
            "too_old": short.count,
            "missed_by_s": short.missed_by_ns / 1e9,
            **({"mistaken": short.mistaken, "mistake": short.mistake} if short.mistaken else {}),
            "dropped": self.dropped,
        }
        return {"buffers": [described]}

    def need(self, target_frame: str, source_frame: str) -> None:
        """Read the streams that lookups of these frames need, until the listener is closed.

        So the first lookup need not wait, and the streams are kept when lookups pause for long.
        Raises InvalidArgumentException if a name is no frame id.
        """
        self._reading.need(check_frame_id(target_frame), check_frame_id(source_frame))

    def where_to_look(self, frame: str = "") -> str:
        """A sentence that names the namespaces below that have a frame, or any frame at all; or,
        if no frame has come, a bus here that this process does not get into; "" for neither. It
        asks all streams, and scouts, which takes a moment.
        """
        # Slow to import, and only asked when a lookup fails.
        from tfbus.bus.graph import where_to_look
        from tfbus.bus.presence import bus_out_of_reach, frames_in_other_namespaces

        session = self._node.session
        hint = "" if self._is_fleet else where_to_look(frames_in_other_namespaces(session), frame)
        return hint or ("" if self.buffer.frames() else bus_out_of_reach(session))

    @property
    def rejected(self) -> Counter[str]:
        """How many messages could not be read, by their stream."""
        counts = {
            name: it.reception.counts.rejected for name, it in self._registry.streams().items()
        }
        return Counter({name: count for name, count in counts.items() if count})

    @property
    def dropped(self) -> int:
        """How many messages came on keys beyond the limit of 200,000."""
        return self._refusals.counts["dropped"]

    @property
    def foreign(self) -> int:
        """The number of messages of others, such as ROS 2, at the keys of streams."""
        return self._foreign

    def streams(self) -> list[StreamInfo]:
        """All streams that are or were there, sorted by name."""
        states = {name: self._names.called(state) for name, state in self._watch.streams().items()}
        receptions = {name: it.reception for name, it in self._registry.streams().items()}
        infos = [
            receptions[name].report(states.get(name))
            if name in receptions
            else described_stream(name, states[name])
            for name in sorted(states.keys() | receptions.keys())
        ]
        offsets = [self._offsets.last_of(info.session) for info in infos]
        return [
            info if offset is None else replace(info, clock_offset_s=offset.offset_s)
            for info, offset in zip(infos, offsets, strict=True)
        ]

    # Messages

    def _on_message(self, key: str, payload: bytes) -> None:
        reception = self._registry.receptions.get(key) or self._meet(key, payload)
        if reception is not None:
            reception.receive(payload)

    def _meet(self, key: str, payload: bytes) -> DynamicReception | StaticReception | None:
        if is_foreign(key) or is_of_ros(payload):
            self._foreign += 1
            return None
        if not is_static(key):
            if self._registry.is_full and not self._makes_room(stream_of(key)):
                self._refusals.warning(
                    "dropped",
                    "Dropped a message on %r: transforms come on more than %d keys, the limit. Do "
                    "not split streams of many frames",
                    key,
                    self._registry.most_keys,
                )
                return None
            self._history.meet(stream_of(key))
        name = stream_of(key)
        if not is_printable(name):
            self._refusals.warning(
                "name", "Dropped a message: the name %r of its stream cannot be shown", name[:300]
            )
            return None
        reception = self._registry.meet(key)
        self._weigh(name)
        return reception

    # Memory

    def _weigh(self, name: str) -> None:
        """Note how much memory a stream takes now; some may have to go."""
        stream = self._registry.get(name)
        if stream is None:
            return
        state, statics = stream.state, stream.reception.statics.batch
        described = None if state is None else state.description
        frames = max(self.buffer.count_sent_by(name), 0 if statics is None else len(statics))
        size = (
            STREAM_BYTES
            + KEY_BYTES * len(stream.keys)
            + JUDGED_BYTES * stream.reception.contest.judged_rows
            + FRAME_BYTES * frames
            + ROW_BYTES
            * (0 if described is None else len(described.frames) + len(described.numbered))
        )
        owner = "" if state is None else state.owner
        for each in self._budget.resize(name, owner, size):
            self._give_up(each)

    def _on_forgotten(self, name: str) -> None:
        """The stream is long gone: remove its transforms."""
        self._budget.forget(name)
        self.buffer.remove_sent(self.buffer.sent_by(name), name)

    def _makes_room(self, name: str) -> bool:
        """Whether a stream of another peer, which takes more, goes for this one."""
        largest = self._budget.oldest_of_the_largest()
        stream = self._registry.get(name)
        owner = "" if stream is None or stream.state is None else stream.state.owner
        if largest is None or largest == name or self._budget.peer_of(largest) == owner:
            return False
        self._budget.forget(largest)
        self._give_up(largest)
        return not self._registry.is_full

    def _give_up(self, name: str) -> None:
        """Forget a stream, since its peer takes too much memory."""
        stream = self._registry.forget(name)
        if stream is None:
            return
        self.buffer.remove_sent(self.buffer.sent_by(name), name)
        state = stream.state
        self._around.lines.warning(
            ("memory", "" if state is None else state.owner),
            "Forgot stream %s and its frames: what its process sends takes too much memory",
            repr(name) if state is None else _name(state),
        )
        if state is not None:
            self._executor.submit("streams", self._forget_stream, state)

    def _forget_stream(self, state: StreamState) -> None:
        self._leave_stream(state)
        self._watch.forget(state.key)

    def _leave_stream(self, state: StreamState) -> None:
        self._conflicts.judge(state.name, None)
        self._history.leave(self._reading.keys_of(state.key), state.name)
        self._recovery.leave(state.name)
        self._offsets.forget(state.name)

    def _on_unwanted(self, state: StreamState) -> None:
        """No lookup needs a stream any longer: no more than its token is known."""
        self._leave_stream(state)
        self._reading.update(state, None)
        stream = self._registry.get(state.name)
        if stream is not None and not stream.read_keys:
            self._registry.forget(state.name)
            self._on_forgotten(state.name)

    def _make_reception(self, name: str, key: str) -> StreamReception:
        reception = StreamReception(
            name,
            self.buffer,
            self._log,
            self._node.clock.now_ns,
            self._names.reader(key),
            around=self._around,
        )
        if self._rights is not None:
            reception.rights = self._rights.frames(key, reception.facts, is_fleet=self._is_fleet)
        return reception

    def _ask_for_description(self, name: str, epoch_ns: int) -> None:
        """Another process publishes the stream now: the last description is not its own."""
        stream = self._registry.get(name)
        if stream is not None and stream.state is not None and not self._closed:
            stream.state = replace(stream.state, description=None)
            self._watch.ask_again(stream.state.key, epoch_ns)

    def _ask_for_names(self, name: str, epoch_ns: int) -> None:
        """Ask for the description again if it has not come by itself in a while, as on a link
        that loses it.
        """
        self._unnamed.discard(name)
        reception = self._registry.reception(name)
        if self._closed or reception is None or not self._around.pending.has(name):
            return
        self._watch.ask_for_epoch(name, epoch_ns)

    def _forget_unconfirmed(self) -> None:
        self._executor.submit(
            "streams", lambda: self._registry.forget_unconfirmed(self._watch.streams()), limit=1
        )

    def _on_jump_back(self, now_ns: int) -> None:
        """The clock was set back: transforms in its future have not happened."""
        self.buffer.clear(after_ns=now_ns)

    # Tokens and descriptions

    def _want(self, namespaces: Set[str], frames: Set[str]) -> None:
        self._executor.submit("streams", self._watch.want, namespaces, frames)

    def _on_stream(self, state: StreamState) -> None:
        """Called for one change of one stream at a time."""
        described, state = state, self._names.called(state)
        stream = self._registry.stream(state.key)
        former, stream.state = stream.state or StreamState(state.name), state
        self._take_token(stream, former, state)
        description = state.description
        is_confirmed = state.confirmed and state.alive
        was_confirmed = former.confirmed and former.alive
        if description is not former.description:
            self._weigh(state.name)
        if description is not None and (
            description != former.description or is_confirmed > was_confirmed
        ):
            stream.reception.take_description(description, confirmed=is_confirmed)
            self._registry.forget_removed(described)
        if state.alive and not former.alive:
            # By what it says of itself now: frames that a new process has not sent are not back.
            stream.reception.marks.update()
        if state.alive and not state.silent and self._reads_statics(stream, state):
            self._recovery.check(state.key, stream.reception)
        self._conflicts.judge(state.name, description if state.alive else None)
        for key in self._reading.keys_of(state.key):
            self._get_to_know(stream, state, key)
        self._reading.update(described, self._names.at(state.key))

    def _is_heard(self, name: str, last_s: float) -> bool:
        """Whether a message of a stream came in the last seconds."""
        reception = self._registry.reception(name)
        heard_ns = None if reception is None else reception.counts.last_heard_ns
        return heard_ns is not None and scheduler.time_ns() - heard_ns < last_s * 1e9

    def _take_token(self, stream: KnownStream, former: StreamState, state: StreamState) -> None:
        if former.alive and not state.alive:
            heard_ns = stream.reception.counts.last_heard_ns
            silent_s = None if heard_ns is None else _seconds_since(heard_ns)
            self._history.leave(self._reading.keys_of(state.key), state.name, silent_s)
            self._offsets.forget(state.name)
            stream.lost_s = scheduler.monotonic()
            stream.reception.vanish()
            self._warn_gone(state)
        elif state.silent and not former.silent:
            self._history.leave(self._reading.keys_of(state.key), state.name)
            stream.reception.fall_silent()
            self._around.lines.info(
                ("silent", state.name),
                "Stream %s is silent: its link is lost, or it has ended; it is gone in seconds",
                _name(state),
            )
        elif state.alive and not former.alive:
            stream.reception.arrive()
            if stream.lost_s is not None:
                stream.lost_s = None
                self._around.lines.info(("back", state.name), "Stream %s is back", _name(state))

    def _warn_gone(self, state: StreamState) -> None:
        frames = sorted(self.buffer.sent_by(state.name))
        if frames and self._node.ok:
            self._around.lines.warning(
                ("gone", state.name),
                "Stream %s is gone; its last transforms stay, marked as gone: %s",
                _name(state),
                quoted(frames),
            )

    def _get_to_know(self, stream: KnownStream, state: StreamState, key: str) -> None:
        """Request the clock's offset and kept transforms of a stream, one of whose keys is read."""
        description = state.description
        if not state.alive or state.silent or description is None:
            return
        self._offsets.watch(state.name, description)
        if description.history_s > 0.0:
            self._history.ask(key, stream.reception)
        elif any(not static for _, _, static in description.frames):
            self._history.keeps_nothing(state.name)

    def _miss(self, name: str, silent_s: float) -> None:
        """The link was silent, and messages of the stream are lost."""
        stream = self._registry.get(name)
        if stream is not None and stream.state is not None and stream.state.alive:
            for key in self._reading.keys_of(stream.state.key):
                self._history.miss(key, stream.reception, silent_s)

    # Subscriptions

    def _subscribe(self, name: str, key: str, static: bool) -> Declaration:
        session = self._node.session
        if not name:
            if static:
                return declare_retained_subscriber(
                    session, key, self._on_message, others=not self._hears_itself, urgent=True
                )
            return session.subscriber(key, self._on_message, others=not self._hears_itself)
        stream = self._registry.stream(key)
        on_message = self._while_read(stream, key)
        state = stream.state
        if static:
            declaration = declare_retained_subscriber(session, key, on_message, urgent=True)
            if state is not None and state.alive:
                self._recovery.check(state.key, stream.reception)
            return declaration
        if state is not None:
            self._history.expect(state.name)
        declaration = session.subscriber(key, on_message)
        if state is not None:
            self._get_to_know(stream, state, key)
        return declaration

    def _reads_statics(self, stream: KnownStream, state: StreamState) -> bool:
        return self._reads_everything or (
            static_transforms_key_beside(state.key) in stream.read_keys
        )

    def _while_read(self, stream: KnownStream, key: str) -> OnSample:
        """Takes the messages of a key; some may still come after it is left."""
        stream.read_keys.add(key)

        def on_message(at: str, payload: bytes) -> None:
            if key in stream.read_keys:
                self._on_message(at, payload)

        return on_message

    def _forget(self, name: str, key: str, frames: set[str]) -> None:
        """A key is no longer read: its transforms would only grow old."""
        stream = self._registry.stream(key)
        stream.read_keys.discard(key)
        self._history.leave([key], name)
        self._registry.forget_key(key)
        if is_static(key):
            self._recovery.leave(name)
            stream.reception.statics.forget()
        self.buffer.remove_sent(frames, name)


class _ListenerHooks(ReceptionHooks):
    """A listener, as the receptions of its streams see it."""

    def __init__(self, listener: TransformListener) -> None:
        super().__init__(listener._log)
        self._listener = listener

    def claimed_by_others(self, stream: str, children: frozenset[str]) -> frozenset[str]:
        return self._listener._conflicts.claimed_by_others(stream, children)

    def on_overlap(self, stream: str, frames: frozenset[str]) -> None:
        listener = self._listener
        listener._executor.submit("conflicts", listener._conflicts.restore, stream, frames)

    def on_unlisted(self, stream: str, frames: frozenset[str]) -> None:
        self._listener._unlisted.hear(stream, frames)

    def on_takeover(self, stream: str, epoch_ns: int) -> None:
        listener = self._listener
        listener._executor.submit("streams", listener._ask_for_description, stream, epoch_ns)

    def on_dispute(self, stream: str, epoch_ns: int) -> None:
        self._listener._watch.ask_for_epoch(stream, epoch_ns)

    def on_unnamed(self, stream: str, epoch_ns: int) -> None:
        listener = self._listener
        if stream not in listener._unnamed:
            listener._unnamed.add(stream)
            listener._executor.after(_NAMED_WITHIN_S, listener._ask_for_names, stream, epoch_ns)

    def on_growth(self, stream: str) -> None:
        self._listener._weigh(stream)

    def on_gap(self, stream: str, silent_s: float) -> None:
        self._listener._executor.submit("history", self._listener._miss, stream, silent_s)

    def on_message_while_gone(self, stream: str) -> None:
        self._listener._still_sending.hear_message(stream)


def _seconds_since(time_ns: int) -> float:
    return max(0.0, (scheduler.time_ns() - time_ns) / 1e9)


def _name(state: StreamState) -> str:
    """The name of a stream, and its publisher if it is known."""
    return str(Claimant(state.name, state.description)) if state.description else repr(state.name)
