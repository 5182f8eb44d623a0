"""Queries of a session: its queryables, and queries in and out, with their answers and ends."""

import itertools
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import zenoh

from tfbus.testing.callers import Handler, Payload, Reply, Sample, Source, guarded
from tfbus.testing.declarations import QUERYABLE, Undeclarable, intersect
from tfbus.testing.routing import Journey, Way

if TYPE_CHECKING:
    from tfbus.testing.links import Face
    from tfbus.testing.zenoh_session import ZenohSession

# Zenoh's own time for a query without one.
_TIMEOUT_S = 10.0

# Bytes around the payload of a query, and around that of an answer.
_AROUND, _AROUND_ANSWER = 100, 60


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

    def reply(
        self,
        key: str,
        payload: bytes,
        source: Source | None = None,
        *,
        priority: zenoh.Priority | None = None,
    ) -> None:
        session = self._session
        session.check_open()
        sample = Sample(session.names.full(key), payload, source=source)
        self._answer(Reply(sample, zid=session.zid_text))

    def reply_err(self, payload: bytes) -> None:
        self._session.check_open()
        self._answer(Reply(error=payload, zid=self._session.zid_text))

    def drop(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end()


class Asked:
    """A query of a session, or one that it passes on: whom it waits for, who gets the answers."""

    def __init__(
        self,
        queries: "Queries",
        number: int,
        on_reply: Callable[[Reply], object],
        on_end: Callable[[], object],
    ) -> None:
        self.number = number
        self._queries = queries
        self._on_reply = on_reply
        self._on_end = on_end
        self.waits_for: set[object] = set()
        self.went_by: list[Face] = []
        self.is_over = False

    def answer(self, reply: Reply) -> None:
        """An answer has come."""
        if not self.is_over:
            self._on_reply(reply)

    def end_of(self, target: object) -> None:
        """A queryable or session that it waits for has closed it; the last one ends it."""
        self.waits_for.discard(target)
        if not self.waits_for:
            self.end()

    def end(self) -> None:
        """Nothing more comes."""
        if not self.is_over:
            self.is_over = True
            self._queries.forget(self)
            self._on_end()


class Cancellation:
    """Ends the queries that were made with it, as Zenoh's CancellationToken."""

    def __init__(self) -> None:
        self.asked: list[Asked] = []

    def cancel(self) -> None:
        """End them, without a further answer. Twice is fine."""
        for each in self.asked:
            each.end()


class _AskedQuestion:
    """The key, parameters and payload of a query; the rank of it, and of its answers."""

    def __init__(self, full: str, parameters: str, payload: bytes | None, rank: int) -> None:
        self.full = full
        self.parameters = parameters
        self.payload = payload
        self.rank = rank


class _Queryable:
    def __init__(self, full: str, handler: Handler) -> None:
        self.full = full
        self.handler = handler


class Queries:
    """Queryables of one session, and the queries that it sends, gets and passes on."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._queryables: dict[int, _Queryable] = {}
        self.asked: dict[int, Asked] = {}

    def serve(self, full: str, handler: Handler) -> Undeclarable:
        """Call the handler for each query that meets a key."""
        number = next(self._numbers)
        self._queryables[number] = _Queryable(full, handler)
        declarations = self._session.declarations
        declarations.change(QUERYABLE, full, 1)

        def undeclare() -> None:
            if self._queryables.pop(number, None):
                declarations.change(QUERYABLE, full, -1)

        return Undeclarable(self._session, undeclare)

    def clear(self) -> None:
        """Serve nothing more, and end the queries that are under way."""
        self._queryables.clear()
        for asked in list(self.asked.values()):
            asked.end()

    def ask(
        self,
        full: str,
        parameters: str,
        payload: bytes | None,
        program: Handler,
        *,
        timeout_s: float | None,
        also_here: bool,
        cancellation: Cancellation | None = None,
        rank: int = 1,
    ) -> None:
        """Ask all that serve a key."""
        session = self._session

        def on_reply(reply: Reply) -> None:
            guarded(lambda: program.call(self._seen(reply)))

        def on_end() -> None:
            if program.drop is not None:
                guarded(program.drop)

        asked = self._begin(
            lambda reply: session.callers.post(asked, lambda: on_reply(reply)),
            lambda: session.callers.post(asked, on_end),
            _TIMEOUT_S if timeout_s is None else timeout_s,
        )
        if cancellation is not None:
            cancellation.asked.append(asked)
        here = object()
        asked.waits_for.add(here)
        question = _AskedQuestion(full, parameters, payload, rank)
        for way in session.routing.ways(QUERYABLE, full):
            self._pass_on(way, asked, question)
        if also_here:
            self._ask_here(question, asked)
        asked.end_of(here)

    def forget(self, asked: Asked) -> None:
        """A query has ended."""
        self.asked.pop(asked.number, None)
        for face in asked.went_by:
            face.asked.pop(asked.number, None)

    def end_of(self, face: "Face") -> None:
        """A face has ended, and the answers that were to come by it."""
        for asked in list(face.asked.values()):
            asked.end_of(face)
        face.asked.clear()

    def _begin(
        self,
        on_reply: Callable[[Reply], object],
        on_end: Callable[[], object],
        timeout_s: float,
    ) -> Asked:
        asked = Asked(self, next(self._numbers), on_reply, on_end)
        self.asked[asked.number] = asked
        process = self._session.process

        def time_out() -> None:
            if not asked.is_over and not process.is_dead:
                if asked.waits_for:
                    asked.answer(Reply(error=b"Timeout"))
                asked.end()

        self._session.tasks.call_after(timeout_s, lambda: process.receive(time_out))
        return asked

    def _pass_on(self, way: Way, asked: Asked, question: _AskedQuestion) -> None:
        face, journey = way
        asked.waits_for.add(face)
        asked.went_by.append(face)
        face.asked[asked.number] = asked
        number = asked.number
        size = len(question.payload or b"") + _AROUND

        def receive(far: "Face") -> None:
            far.session.queries.receive(far, number, question, journey)

        face.send(receive, size, rank=question.rank)

    def receive(
        self, face: "Face", number: int, question: _AskedQuestion, journey: Journey
    ) -> None:
        """A query comes in: answers go back by its face, and its end."""
        session = self._session

        def send_reply(reply: Reply) -> None:
            size = _AROUND_ANSWER + (len(reply.ok.payload) if reply.ok is not None else 0)

            def receive(far: "Face") -> None:
                far.session.queries.receive_reply(far, number, reply)

            face.send(receive, size, rank=question.rank)

        def send_end() -> None:
            face.send(
                lambda far: far.session.queries.receive_end(far, number),
                rank=question.rank,
            )

        asked = Asked(self, next(self._numbers), send_reply, send_end)
        self.asked[asked.number] = asked
        here = object()
        asked.waits_for.add(here)
        for way in session.routing.ways(QUERYABLE, question.full, journey, face):
            self._pass_on(way, asked, question)

        def ask() -> None:
            self._ask_here(question, asked)
            asked.end_of(here)

        if any(intersect(each.full, question.full) for each in self._queryables.values()):
            session.callers.post(face, ask)
        else:
            asked.end_of(here)

    def _ask_here(self, question: _AskedQuestion, asked: Asked) -> None:
        """Ask the queryables of this session; the query ends once they have closed it."""
        session = self._session
        seen = session.names.seen(question.full)
        if seen is None:
            return
        for queryable in list(self._queryables.values()):
            if intersect(queryable.full, question.full):
                one = object()
                asked.waits_for.add(one)
                query = Query(
                    session,
                    seen,
                    question.parameters,
                    question.payload,
                    asked.answer,
                    partial(asked.end_of, one),
                )
                guarded(partial(queryable.handler.call, query))

    def receive_reply(self, face: "Face", number: int, reply: Reply) -> None:
        """An answer comes back."""
        asked = face.asked.get(number)
        if asked is None:
            return
        if self._session.fabric.ends_short():
            face.asked.pop(number)
            asked.end_of(face)
        else:
            asked.answer(reply)

    def receive_end(self, face: "Face", number: int) -> None:
        """The far end of a face has closed a query."""
        if self._session.fabric.never_ends():
            return
        asked = face.asked.pop(number, None)
        if asked is not None:
            asked.end_of(face)

    def _seen(self, reply: Reply) -> Reply:
        """The answer with its key as the session names it."""
        if reply.ok is None:
            return reply
        key = self._session.names.seen(reply.ok.key_expr) or reply.ok.key_expr
        seen = Reply(Sample(key, reply.ok.payload.to_bytes(), source=reply.ok.source_info))
        seen.replier_id = reply.replier_id
        return seen
