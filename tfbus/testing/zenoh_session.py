"""A session of Zenoh in a simulated network, with the methods of Zenoh's own that the bus uses.

It does as eclipse-zenoh 1.10 does, as far as programs can tell; docs/internals/zenoh.md has the
faults of Zenoh's that are part of it.
"""

import itertools
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.links import Lane
from tfbus.testing.tasks import SimulationOver, Task, Tasks

if TYPE_CHECKING:
    from tfbus.testing.network import Network
    from tfbus.testing.processes import Process

SUBSCRIBER, QUERYABLE, TOKEN = "subscriber", "queryable", "token"

# Threads that Zenoh calls back on, of one session.
_THREADS = 3

# A message that must not be dropped closes a link that takes nothing for this long.
_CLOSE_AFTER_S = 5.0
_LOOK_FOR_ROOM_S = 0.005

_CLOSED = "session closed"


@lru_cache(maxsize=200_000)
def intersect(one: str, other: str) -> bool:
    """Whether two key expressions have a key in common."""
    if one == other:
        return True
    if "*" not in one and "*" not in other:
        return False
    return zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(other))


class Payload:
    """Bytes as Zenoh hands them out."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data

    def __bytes__(self) -> bytes:
        return self._data


class Source:
    """Whose message it is: the id of the session, that of the publisher, and its number."""

    def __init__(self, zid: str, eid: int, number: int) -> None:
        self.zid, self.eid = zid, eid
        self.source_id = self
        self.source_sn = number


class Sample:
    """A message, or the news of a token."""

    def __init__(
        self,
        key: str,
        payload: bytes = b"",
        kind: Any = zenoh.SampleKind.PUT,
        source: Source | None = None,
    ) -> None:
        self.key_expr = key
        self.payload = Payload(payload)
        self.kind = kind
        self.source_info = source


class _ReplyError:
    def __init__(self, payload: bytes) -> None:
        self.payload = Payload(payload)


class Reply:
    """An answer to a query, or the reason for none."""

    def __init__(
        self, ok: Sample | None = None, error: bytes | None = None, zid: str | None = None
    ) -> None:
        self.ok = ok
        self.err = None if error is None else _ReplyError(error)
        self.replier_id = None if zid is None else Source(zid, 0, 0)


class Query:
    """A query as it reaches a queryable; `answer(reply)` and `end()` take it back to the asker."""

    def __init__(
        self,
        session: "ZenohSession",
        key: str,
        parameters: str,
        payload: bytes | None,
        answer: Callable[[Reply], object],
        end: Callable[[], object],
    ) -> None:
        self.key_expr = key
        self.parameters = zenoh.Parameters(parameters)
        self.payload = None if payload is None else Payload(payload)
        self._session = session
        self._answer = answer
        self._end: Callable[[], object] | None = end

    def reply(self, key: str, payload: bytes, source: Source | None = None) -> None:
        session = self._session
        session.check_open()
        full = session.full(key)
        self._answer(Reply(Sample(full, payload, source=source), zid=session.zid_text))

    def reply_err(self, payload: bytes) -> None:
        self._session.check_open()
        self._answer(Reply(error=payload, zid=self._session.zid_text))

    def drop(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end()


class Handler:
    """A callback of the program, and what is called after the last."""

    def __init__(self, handler: Any) -> None:
        self.call = handler.callback
        self.drop = handler.drop


class Callers:
    """Zenoh's threads of one session: the calls of one origin come in order."""

    def __init__(self, tasks: Tasks, process: "Process", name: str) -> None:
        self._tasks = tasks
        self._process = process
        self._name = name
        self._calls: dict[object, deque[Callable[[], object]]] = {}
        self._waiting: deque[object] = deque()
        self._idle: list[Task] = []
        self._started = 0

    def post(self, origin: object, call: Callable[[], object]) -> None:
        """Make this call after the earlier ones of its origin."""
        calls = self._calls.get(origin)
        if calls is not None:
            calls.append(call)
            return
        self._calls[origin] = deque((call,))
        self._waiting.append(origin)
        if self._idle:
            self._tasks.wake(self._idle.pop(0))
        elif self._started < _THREADS:
            self._started += 1
            self._tasks.start(f"{self._name} {self._started}", self._process, self._run)

    def _run(self) -> None:
        tasks = self._tasks
        while True:
            while self._waiting:
                origin = self._waiting.popleft()
                calls = self._calls[origin]
                while calls:
                    guarded(calls.popleft())
                    tasks.step()
                del self._calls[origin]
            self._idle.append(tasks.current)
            tasks.wait("a call of Zenoh")


def guarded(call: Callable[[], object]) -> None:
    """Make a call as Zenoh does: exceptions are printed, and do nothing else."""
    try:
        call()
    except Exception:
        traceback.print_exc()


class Face:
    """The end of a link in one session: what the other end has declared, and the way to it."""

    def __init__(self, session: "ZenohSession", lane: Lane) -> None:
        self.session = session
        self.lane = lane
        self.far: Face
        self.is_open = True
        self.has_lost = False
        # What the far end has declared, by kind.
        self.declared: dict[str, dict[str, None]] = {SUBSCRIBER: {}, QUERYABLE: {}, TOKEN: {}}
        # How often the far end was told of a declaration, by kind and key.
        self.told: dict[str, Counter[str]] = {
            SUBSCRIBER: Counter(),
            QUERYABLE: Counter(),
            TOKEN: Counter(),
        }
        # The queries that went out by it and have not ended.
        self.asked: dict[int, _Asked] = {}

    def wants(self, kind: str, key: str) -> bool:
        """Whether the far end has declared something of this kind that a key meets."""
        declared = self.declared[kind]
        return key in declared or any(intersect(each, key) for each in declared)

    def send(self, call: Callable[["Face"], object], size: int = 100) -> None:
        """Make `call(far end)` there, in the order of the calls."""
        far = self.far

        def arrive() -> None:
            if far.is_open:
                call(far)

        self.lane.send(lambda: far.session.process.receive(arrive), size)

    def tell(self, kind: str, key: str, change: int) -> None:
        """One declaration more, or less: the far end hears of the first and of the last."""
        told = self.told[kind]
        former = told[key]
        told[key] += change
        if told[key] == 0:
            del told[key]
        if former == 0:
            if kind == QUERYABLE and not self.has_lost and self.session.network.loses_declaration():
                # More than one of a link was never seen to be lost.
                self.has_lost = True
                return
            self.send(lambda far: far.session.hears(far, kind, key, True))
        elif told[key] == 0:
            self.send(lambda far: far.session.hears(far, kind, key, False))


class _Asked:
    """A query of this session: whom it still waits for, and what its answers go to."""

    def __init__(
        self,
        session: "ZenohSession",
        number: int,
        on_reply: Callable[[Reply], object],
        on_end: Callable[[], object],
    ) -> None:
        self.number = number
        self._session = session
        self._on_reply = on_reply
        self._on_end = on_end
        self.waits_for: set[object] = set()
        self.is_over = False

    def answer(self, reply: Reply) -> None:
        if not self.is_over:
            self._on_reply(reply)

    def end_of(self, target: object) -> None:
        self.waits_for.discard(target)
        if not self.waits_for:
            self.end()

    def end(self) -> None:
        if not self.is_over:
            self.is_over = True
            self._session.forget_query(self)
            self._on_end()


class Cancellation:
    """Ends the queries that were made with it."""

    def __init__(self) -> None:
        self.asked: list[_Asked] = []

    def cancel(self) -> None:
        """End them, without a further answer. Twice is fine."""
        for each in self.asked:
            each.end()


class ZenohSession:
    """A session, as `zenoh.open` returns one."""

    def __init__(
        self,
        network: "Network",
        process: "Process",
        *,
        mode: str,
        namespace: str,
        zid: str,
        connect: tuple[str, ...],
        listen: tuple[str, ...],
    ) -> None:
        self.network = network
        self.tasks: Tasks = network.tasks
        self.process = process
        self.mode = mode
        self.zid_text = zid
        self.connect, self.listen = connect, listen
        self._prefix = f"{namespace}/" if namespace else ""
        self.faces: dict[ZenohSession, Face] = {}
        self.callers = Callers(self.tasks, process, "zenoh")
        self.info = _Info(self)
        self._is_closed = False
        self._numbers = itertools.count(1)
        self._subscribers: dict[int, _Subscriber] = {}
        self._queryables: dict[int, _Queryable] = {}
        self._liveliness_watches: dict[int, _Subscriber] = {}
        self._matchings: dict[int, _Matching] = {}
        self.link_watches: dict[int, Handler] = {}
        self._own: dict[str, Counter[str]] = {
            SUBSCRIBER: Counter(),
            QUERYABLE: Counter(),
            TOKEN: Counter(),
        }
        # By how many of itself and its faces each token is declared.
        self._tokens: Counter[str] = Counter()
        self._asked: dict[int, _Asked] = {}

    # What Zenoh's sessions have

    def zid(self) -> str:
        return self.zid_text

    def is_closed(self) -> bool:
        return self._is_closed

    def close(self) -> None:
        """Leave the network; others know at once."""
        if self._is_closed:
            return
        self._is_closed = True
        self._subscribers.clear()
        self._queryables.clear()
        self._liveliness_watches.clear()
        self._matchings.clear()
        for asked in list(self._asked.values()):
            asked.end()
        for face in list(self.faces.values()):
            face.send(lambda far: far.session.network.lose(far))
            self.network.close_face(face)
        self.network.forget(self)
        self.tasks.step()

    def declare_publisher(self, key: str, **options: Any) -> "Publisher":
        self.check_open()
        return Publisher(self, _checked(key), options)

    def declare_querier(self, key: str, **options: Any) -> "Querier":
        self.check_open()
        return Querier(self, _checked(key))

    def declare_subscriber(
        self, key: str, handler: Any = None, *, allowed_origin: Any = None
    ) -> "Declared":
        self.check_open()
        number = next(self._numbers)
        full = self.full(_checked(key))
        is_remote_only = allowed_origin == zenoh.Locality.REMOTE
        self._subscribers[number] = _Subscriber(full, Handler(handler), is_remote_only)
        self._declare(SUBSCRIBER, full, 1)

        def undeclare() -> None:
            if self._subscribers.pop(number, None):
                self._declare(SUBSCRIBER, full, -1)

        return Declared(self, undeclare)

    def declare_queryable(self, key: str, handler: Any = None, **options: Any) -> "Declared":
        self.check_open()
        number = next(self._numbers)
        full = self.full(_checked(key))
        self._queryables[number] = _Queryable(full, Handler(handler))
        self._declare(QUERYABLE, full, 1)

        def undeclare() -> None:
            if self._queryables.pop(number, None):
                self._declare(QUERYABLE, full, -1)

        return Declared(self, undeclare)

    def put(
        self,
        key: str,
        payload: bytes,
        *,
        congestion_control: Any = None,
        priority: Any = None,
        allowed_destination: Any = None,
        source_info: Source | None = None,
        **options: Any,
    ) -> None:
        self.check_open()
        self.tasks.step()
        full = self.full(str(key))
        data = bytes(payload)
        if allowed_destination != zenoh.Locality.REMOTE:
            self._deliver_here(full, data, source_info)
        must_arrive = congestion_control == zenoh.CongestionControl.BLOCK
        urgent = priority == zenoh.Priority.INTERACTIVE_HIGH
        for face in list(self.faces.values()):
            if face.is_open and face.wants(SUBSCRIBER, full):
                self._send_data(face, full, data, source_info, must_arrive, urgent)

    def get(
        self,
        selector: str,
        handler: Any = None,
        *,
        payload: bytes | None = None,
        timeout: float | None = None,
        allowed_destination: Any = None,
        cancellation_token: "Cancellation | None" = None,
        **options: Any,
    ) -> None:
        self.check_open()
        self.tasks.step()
        key, _, parameters = str(selector).partition("?")
        full = self.full(_checked(key))
        program = Handler(handler)

        def on_reply(reply: Reply) -> None:
            guarded(lambda: program.call(self._seen(reply)))

        def on_end() -> None:
            if program.drop is not None:
                guarded(program.drop)

        asked = self._begin_query(
            lambda reply: self.callers.post(asked, lambda: on_reply(reply)),
            lambda: self.callers.post(asked, on_end),
            10.0 if timeout is None else timeout,
        )
        if cancellation_token is not None:
            cancellation_token.asked.append(asked)
        here = object()
        asked.waits_for.add(here)
        data = None if payload is None else bytes(payload)
        for face in list(self.faces.values()):
            if face.is_open and face.wants(QUERYABLE, full):
                self._forward_query(face, asked, full, parameters, data)
        if allowed_destination != zenoh.Locality.REMOTE:
            self._ask_here(full, parameters, data, asked.answer)
        asked.end_of(here)

    def liveliness(self) -> "Liveliness":
        return Liveliness(self)

    # Keys

    def full(self, key: str) -> str:
        """A key of this session as the network has it."""
        return f"{self._prefix}{key}"

    def seen(self, full: str) -> str | None:
        """A key of the network as this session names it; None for one of another namespace."""
        if not self._prefix:
            return full
        return full.removeprefix(self._prefix) if full.startswith(self._prefix) else None

    def _seen(self, reply: Reply) -> Reply:
        if reply.ok is None:
            return reply
        key = self.seen(reply.ok.key_expr) or reply.ok.key_expr
        source = reply.ok.source_info
        seen = Reply(Sample(key, reply.ok.payload.to_bytes(), source=source))
        seen.replier_id = reply.replier_id
        return seen

    def check_open(self) -> None:
        """Raise Zenoh's error where the session is closed, end what belongs to a dead process."""
        if self.tasks.is_over and self.tasks.current is not self.tasks.main:
            raise SimulationOver
        if self._is_closed:
            raise zenoh.ZError(_CLOSED)

    # Declarations

    def _declare(self, kind: str, full: str, change: int) -> None:
        self._own[kind][full] += change
        if self._own[kind][full] == 0:
            del self._own[kind][full]
        for face in self.faces.values():
            face.tell(kind, full, change)
        if kind == TOKEN:
            self._count_token(full, change, self)
        elif not self._is_closed:
            self.look_at_matchings()
        self.tasks.step()

    def hears(self, face: Face, kind: str, key: str, is_new: bool) -> None:
        """The far end of a face declares something, or ends it."""
        declared = face.declared[kind]
        if is_new == (key in declared):
            return
        if is_new:
            declared[key] = None
        else:
            del declared[key]
        self._has_heard(face, kind, key, 1 if is_new else -1)
        if kind != TOKEN:
            self.look_at_matchings()

    def _has_heard(self, face: Face, kind: str, key: str, change: int) -> None:
        if kind == TOKEN:
            self._count_token(key, change, face)
        if self.mode == "router":
            for other in self.faces.values():
                if other is not face:
                    other.tell(kind, key, change)

    def _count_token(self, key: str, change: int, origin: object) -> None:
        former = self._tokens[key]
        self._tokens[key] += change
        if self._tokens[key] == 0:
            del self._tokens[key]
        is_there = key in self._tokens
        if is_there != bool(former):
            kind = zenoh.SampleKind.PUT if is_there else zenoh.SampleKind.DELETE
            for watch in list(self._liveliness_watches.values()):
                self._report_token(watch, key, kind, origin)

    def _report_token(self, watch: "_Subscriber", key: str, kind: Any, origin: object) -> None:
        seen = self.seen(key)
        if seen is not None and intersect(watch.key, key):
            sample = Sample(seen, kind=kind)
            self.callers.post(("token", origin), lambda: watch.give(sample))

    def look_at_matchings(self) -> None:
        """Tell publishers and queriers whether they have a counterpart now."""
        for matching in list(self._matchings.values()):
            matching.look()

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of this kind meets a key, here or at another session."""
        if any(intersect(each, full) for each in self._own[kind]):
            return True
        return any(face.wants(kind, full) for face in self.faces.values())

    def watch_matching(self, kind: str, full: str, handler: Any) -> "Declared":
        """Call the handler whenever `has` changes."""
        number = next(self._numbers)
        self._matchings[number] = _Matching(self, kind, full, Handler(handler))
        return Declared(self, lambda: self._matchings.pop(number, None))

    # Links

    def greet(self, face: Face) -> None:
        """Tell the far end of a new face all that it has to know."""
        self.faces[face.far.session] = face
        for kind, keys in self._own.items():
            for key in list(keys):
                face.tell(kind, key, 1)
        if self.mode == "router":
            for other in list(self.faces.values()):
                if other is not face:
                    for kind, declared in other.declared.items():
                        for key in list(declared):
                            face.tell(kind, key, 1)
        self._report_link()

    def part(self, face: Face) -> None:
        """A face has ended: what its far end had declared ends, and so do queries."""
        if self.faces.get(face.far.session) is face:
            del self.faces[face.far.session]
        for kind, declared in face.declared.items():
            for key in list(declared):
                del declared[key]
                self._has_heard(face, kind, key, -1)
        self.look_at_matchings()
        for asked in list(face.asked.values()):
            asked.end_of(face)
        face.asked.clear()
        self._report_link()

    def _report_link(self) -> None:
        for handler in list(self.link_watches.values()):
            self.callers.post("links", partial(handler.call, None))

    # Messages

    def _send_data(
        self,
        face: Face,
        full: str,
        data: bytes,
        source: Source | None,
        must_arrive: bool,
        urgent: bool,
    ) -> None:
        if not face.lane.has_room(urgent):
            if not must_arrive:
                self.network.dropped += 1
                return
            waited_s = 0.0
            while not face.lane.has_room(urgent) and face.is_open:
                self.tasks.wait("room on a link", _LOOK_FOR_ROOM_S)
                waited_s += _LOOK_FOR_ROOM_S
                if waited_s > _CLOSE_AFTER_S:
                    self.network.lose(face)
                    return
        size = len(data) + 60
        face.send(lambda far: far.session._on_data(far, full, data, source, urgent), size)

    def _on_data(
        self, face: Face, full: str, data: bytes, source: Source | None, urgent: bool
    ) -> None:
        if self.mode == "router":
            for other in list(self.faces.values()):
                if other is not face and other.wants(SUBSCRIBER, full):
                    if other.lane.has_room(urgent):
                        size = len(data) + 60
                        other.send(
                            lambda far: far.session._on_data(far, full, data, source, urgent), size
                        )
                    else:
                        self.network.dropped += 1
        if any(intersect(each.key, full) for each in self._subscribers.values()):
            self.callers.post(face, lambda: self._deliver(full, data, source, True))

    def _deliver_here(self, full: str, data: bytes, source: Source | None) -> None:
        self._deliver(full, data, source, False)

    def _deliver(self, full: str, data: bytes, source: Source | None, is_remote: bool) -> None:
        for subscriber in list(self._subscribers.values()):
            if (is_remote or not subscriber.is_remote_only) and intersect(subscriber.key, full):
                seen = self.seen(full)
                if seen is not None:
                    subscriber.give(Sample(seen, data, source=source))

    # Queries

    def _begin_query(
        self,
        on_reply: Callable[[Reply], object],
        on_end: Callable[[], object],
        timeout_s: float,
    ) -> _Asked:
        asked = _Asked(self, next(self._numbers), on_reply, on_end)
        self._asked[asked.number] = asked

        def time_out() -> None:
            if not asked.is_over and not self.process.is_dead:
                if asked.waits_for:
                    asked.answer(Reply(error=b"Timeout"))
                asked.end()

        self.tasks.call_after(timeout_s, lambda: self.process.receive(time_out))
        return asked

    def forget_query(self, asked: _Asked) -> None:
        """A query has ended."""
        self._asked.pop(asked.number, None)
        for face in self.faces.values():
            face.asked.pop(asked.number, None)

    def _forward_query(
        self, face: Face, asked: _Asked, full: str, parameters: str, data: bytes | None
    ) -> None:
        asked.waits_for.add(face)
        face.asked[asked.number] = asked
        number = asked.number
        size = len(data or b"") + 100
        face.send(lambda far: far.session._on_query(far, number, full, parameters, data), size)

    def _on_query(
        self, face: Face, number: int, full: str, parameters: str, data: bytes | None
    ) -> None:
        """A query comes in: answers go back by its face, and its end."""

        def send_reply(reply: Reply) -> None:
            size = 60 + (len(reply.ok.payload) if reply.ok is not None else 0)
            face.send(lambda far: far.session._on_reply(far, number, reply), size)

        def send_end() -> None:
            face.send(lambda far: far.session._on_final(far, number))

        asked = _Asked(self, next(self._numbers), send_reply, send_end)
        self._asked[asked.number] = asked
        here = object()
        asked.waits_for.add(here)
        if self.mode == "router":
            for other in list(self.faces.values()):
                if other is not face and other.wants(QUERYABLE, full):
                    self._forward_query(other, asked, full, parameters, data)

        def ask() -> None:
            self._ask_here(full, parameters, data, asked.answer, asked)
            asked.end_of(here)

        if any(intersect(each.key, full) for each in self._queryables.values()):
            self.callers.post(face, ask)
        else:
            asked.end_of(here)

    def _ask_here(
        self,
        full: str,
        parameters: str,
        data: bytes | None,
        answer: Callable[[Reply], object],
        asked: _Asked | None = None,
    ) -> None:
        for queryable in list(self._queryables.values()):
            if not intersect(queryable.key, full):
                continue
            seen = self.seen(full)
            if seen is None:
                continue
            one = object()
            if asked is not None:
                asked.waits_for.add(one)
                end: Callable[[], object] = partial(asked.end_of, one)
            else:
                end = _nothing
            query = Query(self, seen, parameters, data, answer, end)
            guarded(partial(queryable.handler.call, query))

    def _on_reply(self, face: Face, number: int, reply: Reply) -> None:
        asked = face.asked.get(number)
        if asked is not None:
            asked.answer(reply)

    def _on_final(self, face: Face, number: int) -> None:
        asked = face.asked.pop(number, None)
        if asked is not None:
            asked.end_of(face)


def _nothing() -> None:
    pass


def _checked(key: str) -> str:
    """The key expression in its one form. Raises Zenoh's error where it is none."""
    return str(zenoh.KeyExpr.autocanonize(key)) if "*" in key else str(zenoh.KeyExpr(key))


class Declared:
    """What a session has declared, until `undeclare()`."""

    def __init__(self, session: ZenohSession, end: Callable[[], object]) -> None:
        self._session = session
        self._end: Callable[[], object] | None = end

    @property
    def is_of_ended_simulation(self) -> bool:
        """Whether there is nothing left to end."""
        return self._session.tasks.is_over

    def undeclare(self) -> None:
        end, self._end = self._end, None
        if end is not None and not self._session.is_closed():
            end()


class _Subscriber:
    def __init__(self, key: str, handler: Handler, is_remote_only: bool = False) -> None:
        self.key = key
        self.handler = handler
        self.is_remote_only = is_remote_only

    def give(self, sample: Sample) -> None:
        guarded(lambda: self.handler.call(sample))


class _Queryable:
    def __init__(self, key: str, handler: Handler) -> None:
        self.key = key
        self.handler = handler


class _MatchingStatus:
    def __init__(self, matching: bool) -> None:
        self.matching = matching


class _Matching:
    """Reports whether a declaration has counterparts."""

    def __init__(self, session: ZenohSession, kind: str, full: str, handler: Handler) -> None:
        self._session = session
        self._kind = kind
        self._full = full
        self._handler = handler
        self._former = session.has(kind, full)

    def look(self) -> None:
        now = self._session.has(self._kind, self._full)
        if now != self._former:
            self._former = now
            status = _MatchingStatus(now)
            self._session.callers.post(self, lambda: self._handler.call(status))


class _Matched(Declared):
    """A publisher or querier: it knows whether it has a counterpart."""

    _kind = SUBSCRIBER

    def __init__(self, session: ZenohSession, key: str) -> None:
        super().__init__(session, _nothing)
        self._key = key

    @property
    def matching_status(self) -> _MatchingStatus:
        self._session.check_open()
        return _MatchingStatus(self._session.has(self._kind, self._session.full(self._key)))

    def declare_matching_listener(self, handler: Any) -> Declared:
        full = self._session.full(self._key)
        return self._session.watch_matching(self._kind, full, handler)


class Publisher(_Matched):
    """A publisher of one key."""

    def __init__(self, session: ZenohSession, key: str, options: dict[str, Any]) -> None:
        super().__init__(session, key)
        self._options = options

    def put(self, payload: bytes) -> None:
        if self._end is None:
            raise zenoh.ZError("Undeclared publisher")
        self._session.put(self._key, payload, **self._options)


class Querier(_Matched):
    """Asks at one key."""

    _kind = QUERYABLE


class Liveliness:
    """The tokens of a session, and those that it sees."""

    def __init__(self, session: ZenohSession) -> None:
        self._session = session

    def declare_token(self, key: str) -> Declared:
        session = self._session
        session.check_open()
        full = session.full(_checked(key))
        session._declare(TOKEN, full, 1)
        return Declared(session, lambda: session._declare(TOKEN, full, -1))

    def declare_subscriber(self, key: str, handler: Any, *, history: bool = False) -> Declared:
        session = self._session
        session.check_open()
        number = next(session._numbers)
        watch = _Subscriber(session.full(_checked(key)), Handler(handler))
        session._liveliness_watches[number] = watch
        if history:
            # By where they are from: news of one end come in order.
            for origin, keys in self._by_origin():
                for token in keys:
                    session._report_token(watch, token, zenoh.SampleKind.PUT, origin)
        session.tasks.step()
        return Declared(session, lambda: session._liveliness_watches.pop(number, None))

    def get(self, key: str, handler: Any, *, timeout: float | None = None) -> None:
        session = self._session
        session.check_open()
        full = session.full(_checked(key))
        program = Handler(handler)
        delay_s = session.network.round_trip_s(session)

        def answer() -> None:
            for token in list(session._tokens):
                seen = session.seen(token)
                if seen is not None and intersect(full, token):
                    reply = Reply(Sample(seen))
                    guarded(partial(program.call, reply))
            if program.drop is not None:
                guarded(program.drop)

        session.tasks.call_after(
            min(delay_s, 10.0 if timeout is None else timeout),
            lambda: session.process.receive(lambda: session.callers.post(object(), answer)),
        )

    def _by_origin(self) -> Iterator[tuple[object, list[str]]]:
        session = self._session
        reported: set[str] = set()
        yield session, list(session._own[TOKEN])
        reported.update(session._own[TOKEN])
        for face in session.faces.values():
            fresh = [token for token in face.declared[TOKEN] if token not in reported]
            reported.update(fresh)
            yield face, fresh


class _LinkInfo:
    def __init__(self, zid: str) -> None:
        self.zid = zid
        self.auth_identifier = None


class _Info:
    """What a session says of itself and its links."""

    def __init__(self, session: ZenohSession) -> None:
        self._session = session

    def zid(self) -> str:
        return self._session.zid_text

    def routers_zid(self) -> list[str]:
        return [far.zid_text for far in self._session.faces if far.mode == "router"]

    def peers_zid(self) -> list[str]:
        return [far.zid_text for far in self._session.faces if far.mode == "peer"]

    def links(self) -> list[_LinkInfo]:
        return [_LinkInfo(far.zid_text) for far in self._session.faces]

    def declare_transport_events_listener(self, handler: Any) -> Declared:
        session = self._session
        session.check_open()
        number = next(session._numbers)
        session.link_watches[number] = Handler(handler)
        return Declared(session, lambda: session.link_watches.pop(number, None))
