"""Publications of a session: its publishers and subscribers, and messages in and out.

A congested link drops a message, or makes its publisher wait, as the message asks for.
"""

from __future__ import annotations

import itertools
from collections import deque
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.callers import Handler, Reply, Sample, Source, guarded
from tfbus.testing.declarations import QUERYABLE, SUBSCRIBER, Undeclarable, intersect
from tfbus.testing.links import PACKET_BYTES
from tfbus.testing.queries import Query
from tfbus.testing.routing import Journey
from tfbus.testing.tasks import SimulationOver

if TYPE_CHECKING:
    from tfbus.testing.links import Face
    from tfbus.testing.zenoh_session import ZenohSession

# A message that must not be dropped closes a link that takes nothing for this long.
_CLOSE_AFTER_S = 5.0
_LOOK_FOR_ROOM_S = 0.005

# Bytes around a payload.
_AROUND = 60


class SentMessage:
    """A message on its way: `must_arrive` if it waits for room on a link."""

    def __init__(
        self, full: str, data: bytes, source: Source | None, *, must_arrive: bool, rank: int
    ) -> None:
        self.full = full
        self.data = data
        self.source = source
        self.must_arrive = must_arrive
        self.rank = rank


class _Subscriber:
    def __init__(self, full: str, handler: Handler, is_remote_only: bool) -> None:
        self.full = full
        self.handler = handler
        self.is_remote_only = is_remote_only


class Publications:
    """Subscribers of one session, and the messages that it sends and gets."""

    def __init__(self, session: ZenohSession) -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._subscribers: dict[int, _Subscriber] = {}
        # The subscribers that a key meets, until one comes or goes.
        self._met: dict[str, list[_Subscriber]] = {}

    def subscribe(self, full: str, handler: Handler, *, is_remote_only: bool) -> Undeclarable:
        """Call the handler for each message that meets a key."""
        number = next(self._numbers)
        self._subscribers[number] = _Subscriber(full, handler, is_remote_only)
        self._met.clear()
        declarations = self._session.declarations
        declarations.change(SUBSCRIBER, full, 1)

        def undeclare() -> None:
            if self._subscribers.pop(number, None):
                self._met.clear()
                declarations.change(SUBSCRIBER, full, -1)

        return Undeclarable(self._session, undeclare)

    def clear(self) -> None:
        """Hear nothing more."""
        self._subscribers.clear()
        self._met.clear()

    def _of(self, full: str) -> list[_Subscriber]:
        """The subscribers that a key meets, in the order of their declarations."""
        found = self._met.get(full)
        if found is None:
            found = [each for each in self._subscribers.values() if intersect(each.full, full)]
            self._met[full] = found
        return found

    def send(self, message: SentMessage, *, also_here: bool) -> None:
        """Send a message of this session; waits for room if it must arrive."""
        if also_here:
            self._deliver(message, is_remote=False)
        for face, journey in self._session.routing.ways(SUBSCRIBER, message.full):
            if face.is_open and self._has_room(face, message):
                self._pass_on(face, message, journey)

    def receive(self, face: "Face", message: SentMessage, journey: Journey) -> None:
        """A message comes in by a face: routers pass it on."""
        session = self._session
        for way, onwards in session.routing.ways(SUBSCRIBER, message.full, journey, face):
            if self._drops(way, message):
                session.fabric.dropped += 1
            else:
                self._pass_on(way, message, onwards)
        if self._of(message.full):
            session.callers.post(face, lambda: self._deliver(message, is_remote=True))

    def _pass_on(self, face: "Face", message: SentMessage, journey: Journey) -> None:
        size = len(message.data) + _AROUND

        def receive(far: "Face") -> None:
            far.session.publications.receive(far, message, journey)

        face.send(receive, size, rank=message.rank)

    def _has_room(self, face: "Face", message: SentMessage) -> bool:
        """Whether a link takes a message, after a wait if it must arrive."""
        session = self._session
        if not message.must_arrive:
            is_dropped = self._drops(face, message)
            session.fabric.dropped += is_dropped
            return not is_dropped
        waited_s = 0.0
        while not face.lane.has_room(message.rank) and face.is_open:
            session.tasks.wait("room on a link", _LOOK_FOR_ROOM_S)
            waited_s += _LOOK_FOR_ROOM_S
            if waited_s > _CLOSE_AFTER_S:
                session.fabric.lose(face)
                return False
        return True

    def _drops(self, face: "Face", message: SentMessage) -> bool:
        """Whether a link drops a message; on a bad network it carries a part of a large one."""
        size = len(message.data) + _AROUND
        if not self._session.has_bad_network or size <= PACKET_BYTES:
            return not face.lane.has_room(message.rank)
        carried = face.lane.bytes_carried(size, message.rank)
        if 0 < carried < size:
            face.send(lambda far: None, carried, rank=message.rank)
        return carried < size

    def _deliver(self, message: SentMessage, *, is_remote: bool) -> None:
        seen = self._session.names.seen(message.full)
        if seen is None:
            return
        for subscriber in self._of(message.full):
            if is_remote or not subscriber.is_remote_only:
                sample = Sample(seen, message.data, source=message.source)
                guarded(partial(subscriber.handler.call, sample))


class MatchingStatus:
    """Whether there is a counterpart."""

    def __init__(self, matching: bool) -> None:
        self.matching = matching


class _MatchingWatch:
    """Reports whether a declaration has counterparts."""

    def __init__(self, session: ZenohSession, kind: str, full: str, handler: Handler) -> None:
        self._session = session
        self._kind = kind
        self._full = full
        self._handler = handler
        self._former = session.declarations.has(kind, full)

    def is_of(self, kind: str, key: str) -> bool:
        """Whether a declaration of this kind and key may change its answer."""
        return kind == self._kind and intersect(key, self._full)

    def report_changes(self) -> None:
        now = self._session.declarations.has(self._kind, self._full)
        if now != self._former:
            self._former = now
            status = MatchingStatus(now)
            self._session.callers.post(self, lambda: self._handler.call(status))


class Matchings:
    """The watches of one session."""

    def __init__(self, session: ZenohSession) -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._watches: dict[int, _MatchingWatch] = {}

    def watch(self, kind: str, full: str, handler: Any) -> Undeclarable:
        """Call the handler whenever `has` of the declarations changes."""
        number = next(self._numbers)
        self._watches[number] = _MatchingWatch(self._session, kind, full, Handler(handler))
        return Undeclarable(self._session, lambda: self._watches.pop(number, None))

    def report_changes(self, kind: str, key: str) -> None:
        """A declaration has come or ended: report the changes."""
        for watch in list(self._watches.values()):
            if watch.is_of(kind, key):
                watch.report_changes()

    def clear(self) -> None:
        """Watch nothing more."""
        self._watches.clear()


class _Matched(Undeclarable):
    """A publisher or querier: it knows whether it has a counterpart."""

    _kind = SUBSCRIBER

    def __init__(self, session: ZenohSession, key: str) -> None:
        super().__init__(session, lambda: None)
        self._key = key
        self._full = session.names.full(key)

    @property
    def matching_status(self) -> MatchingStatus:
        self._session.check_open()
        return MatchingStatus(self._session.declarations.has(self._kind, self._full))

    def declare_matching_listener(self, handler: Any) -> Undeclarable:
        return self._session.matchings.watch(self._kind, self._full, handler)


class Publisher(_Matched):
    """A publisher of one key."""

    def __init__(self, session: ZenohSession, key: str, options: dict[str, Any]) -> None:
        super().__init__(session, key)
        self._options = options

    def put(self, payload: bytes, **options: Any) -> None:
        if self._end is None:
            raise zenoh.ZError("Undeclared publisher")
        self._session.put(self._key, payload, **self._options)


class Querier(_Matched):
    """Asks at one key."""

    _kind = QUERYABLE


_BELOW = "/@adv/pub/"
_HEARTBEAT_S = 0.5
_QUERY_S = 10.0


class AdvancedPublisher(Publisher):
    """A publisher with a cache and a heartbeat: it keeps its last samples, numbers its messages,
    and says half a second after a message which number was the last.
    """

    def __init__(
        self, session: ZenohSession, key: str, cache: int, options: dict[str, Any]
    ) -> None:
        super().__init__(session, key, options)
        self._sent: deque[tuple[int, bytes]] = deque(maxlen=cache)
        self.id = Source(session.zid_text, next(session.publisher_numbers), 0)
        self._own_key = f"{key}{_BELOW}{self.id.zid}/{self.id.eid}/_"
        self._number = 0
        self._beats = 0
        self._queryable = session.declare_queryable(
            self._own_key, zenoh.handlers.Callback(self._on_query, None, indirect=False)
        )

    def put(self, payload: bytes, **options: Any) -> None:
        session = self._session
        session.check_open()
        if self._end is None:
            raise zenoh.ZError("Undeclared publisher")
        number = self._number
        self._number += 1
        data = bytes(payload)
        self._sent.append((number, data))
        self._beats += 1
        beat = self._beats
        session.put(
            self._key, data, source_info=Source(self.id.zid, self.id.eid, number), **self._options
        )
        session.tasks.call_after(
            _HEARTBEAT_S, lambda: session.process.receive(lambda: self._beat(beat))
        )

    def undeclare(self) -> None:
        if self._end is not None:
            self._queryable.undeclare()
        super().undeclare()

    def _beat(self, beat: int) -> None:
        session = self._session
        if beat == self._beats and self._end is not None and not session.is_closed():
            number = str(self._number - 1).encode()
            session.callers.post(self, lambda: self._send_beat(number))

    def _send_beat(self, number: bytes) -> None:
        if self._end is not None and not self._session.is_closed():
            self._session.put(self._own_key, number)

    def _on_query(self, query: Query) -> None:
        first = int(query.parameters.get("_from") or 0)
        for number, data in list(self._sent):
            if number >= first:
                query.reply(self._key, data, Source(self.id.zid, self.id.eid, number))
        query.drop()


class AdvancedSubscriber(Undeclarable):
    """A subscriber that asks publishers for their kept messages, and for missed ones."""

    def __init__(
        self, session: ZenohSession, key: str, handler: Any, allowed_origin: Any, history: Any
    ) -> None:
        super().__init__(session, self._close)
        self._handler = Handler(handler)
        self.handler: Any = None
        self._key = key
        # The last number given of each publisher, by session and publisher.
        self._last: dict[tuple[str, int], int] = {}

        def direct(call: Any) -> Any:
            return zenoh.handlers.Callback(call, None, indirect=False)

        below = f"{key}{_BELOW}**"
        self._parts = [
            session.declare_subscriber(key, direct(self._on_sample), allowed_origin=allowed_origin)
        ]
        if history is not None and "@" not in key.split("/")[0]:
            self._parts.append(
                session.liveliness().declare_subscriber(below, direct(self._on_token), history=True)
            )
        self._parts.append(session.declare_subscriber(below, direct(self._on_beat)))
        if history is not None:
            self._ask(below, "")

    def _close(self) -> None:
        for part in self._parts:
            part.undeclare()

    def _on_token(self, sample: Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._ask(str(sample.key_expr), "")

    def _on_beat(self, sample: Sample) -> None:
        key = str(sample.key_expr)
        zid, eid, _ = key.rpartition(_BELOW)[2].split("/")
        if self._last.get((zid, int(eid)), -1) < int(sample.payload.to_bytes()):
            self._ask(key, "")

    def _ask(self, key: str, parameters: str) -> None:
        if self._session.is_closed():
            return

        def on_reply(reply: Reply) -> None:
            if reply.ok is not None:
                self._on_sample(reply.ok)

        self._session.get(
            f"{key}?{parameters}" if parameters else key,
            zenoh.handlers.Callback(on_reply, None, indirect=False),
            timeout=_QUERY_S,
        )

    def _on_sample(self, sample: Sample) -> None:
        if self._end is None:
            return
        source = sample.source_info
        if source is not None:
            publisher = source.zid, source.eid
            if source.source_sn <= self._last.get(publisher, -1):
                return
            self._last[publisher] = source.source_sn
        self._handler.call(sample)


class _Held:
    """The handle of the program: when it lets go of it, the publisher or subscriber ends."""

    def __init__(self, core: AdvancedPublisher | AdvancedSubscriber) -> None:
        self._core = core

    def __del__(self) -> None:
        if not self._core.is_of_ended_simulation:
            with suppress(SimulationOver):  # it may end meanwhile
                self._core.undeclare()

    def undeclare(self) -> None:
        self._core.undeclare()


class _HeldPublisher(_Held):
    def __init__(self, core: AdvancedPublisher) -> None:
        super().__init__(core)
        self.put = core.put
        self.id = core.id


def declare_advanced_publisher(
    session: ZenohSession, key: str, *, cache: Any = None, **options: Any
) -> _HeldPublisher:
    """As Zenoh's, with a cache of one sample."""
    options.pop("sample_miss_detection", None)
    options.pop("publisher_detection", None)
    session.check_open()
    return _HeldPublisher(AdvancedPublisher(session, key, 1, options))


def declare_advanced_subscriber(
    session: ZenohSession,
    key: str,
    handler: Any,
    *,
    allowed_origin: Any = None,
    history: Any = None,
    **options: Any,
) -> _Held:
    """As Zenoh's, with a history of one sample or none."""
    session.check_open()
    callback = handler[0] if isinstance(handler, tuple) else handler
    subscriber = AdvancedSubscriber(session, key, callback, allowed_origin, history)
    # An object that comes with the callback lives for as long as the subscriber does.
    subscriber.handler = handler
    return _Held(subscriber)
