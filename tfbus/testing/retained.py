"""Zenoh's advanced publishers and subscribers in a simulated network.

A publisher keeps its last samples, numbers what it sends and says half a second after a message
which number was the last; a subscriber asks each publisher for what it has missed.
"""

from collections import deque
from contextlib import suppress
from typing import Any

import zenoh

from tfbus.testing.callers import Handler, Reply, Sample, Source
from tfbus.testing.declarations import Declared
from tfbus.testing.publications import Publisher
from tfbus.testing.queries import Query
from tfbus.testing.tasks import SimulationOver
from tfbus.testing.zenoh_session import ZenohSession

_BELOW = "/@adv/pub/"
_HEARTBEAT_S = 0.5
_QUERY_S = 10.0


class AdvancedPublisher(Publisher):
    """A publisher with a cache and a heartbeat."""

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


class AdvancedSubscriber(Declared):
    """A subscriber that asks for what publishers keep, and for what it has missed."""

    def __init__(self, session: ZenohSession, key: str, handler: Any, allowed_origin: Any) -> None:
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
        if "@" not in key.split("/")[0]:
            self._parts.append(
                session.liveliness().declare_subscriber(below, direct(self._on_token), history=True)
            )
        self._parts.append(session.declare_subscriber(below, direct(self._on_beat)))
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
    session: ZenohSession, key: str, handler: Any, *, allowed_origin: Any = None, **options: Any
) -> _Held:
    """As Zenoh's, with a history of one sample."""
    session.check_open()
    callback = handler[0] if isinstance(handler, tuple) else handler
    subscriber = AdvancedSubscriber(session, key, callback, allowed_origin)
    # An object that comes with the callback lives for as long as the subscriber does.
    subscriber.handler = handler
    return _Held(subscriber)
