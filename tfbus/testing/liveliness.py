"""Liveliness: the tokens that a session knows of, and its watches of them."""

import itertools
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.callers import Handler, Reply, Sample, guarded
from tfbus.testing.declarations import TOKEN, Declared, intersect

if TYPE_CHECKING:
    from tfbus.testing.zenoh_session import ZenohSession


class _Watch:
    def __init__(self, full: str, handler: Handler) -> None:
        self.full = full
        self.handler = handler
        self.is_over = False
        # When the latest news of a token come that come late.
        self.late: dict[str, int] = {}


class Tokens:
    """All tokens that one session knows, and its watches."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._watches: dict[int, _Watch] = {}
        # By how many sources each token is declared.
        self._count: Counter[str] = Counter()

    def __iter__(self) -> Any:
        return iter(list(self._count))

    def count(self, key: str, change: int, source: object) -> None:
        """Count a source of a token more, or less: the first and the last are news."""
        former = self._count[key]
        self._count[key] += change
        if self._count[key] == 0:
            del self._count[key]
        is_there = key in self._count
        if is_there != bool(former):
            self.report(key, alive=is_there, source=source)

    def report(self, key: str, *, alive: bool, source: object = None) -> None:
        """Report that a token is there, or is not, whether or not it is: as by half a link."""
        kind = zenoh.SampleKind.PUT if alive else zenoh.SampleKind.DELETE
        for watch in list(self._watches.values()):
            self._report(watch, key, kind, source)

    def watch(self, full: str, handler: Handler, *, history: bool) -> Declared:
        """Report tokens as they come and end; with `history` those that are there first."""
        number = next(self._numbers)
        watch = self._watches[number] = _Watch(full, handler)
        if history:
            # By their sources: news of one source come in order.
            for source, keys in self._by_source():
                for key in keys:
                    self._report(watch, key, zenoh.SampleKind.PUT, source)

        def undeclare() -> None:
            watch.is_over = True
            self._watches.pop(number, None)

        return Declared(self._session, undeclare)

    def clear(self) -> None:
        """Watch nothing more."""
        self._watches.clear()

    def _report(self, watch: _Watch, key: str, kind: Any, source: object) -> None:
        session = self._session
        seen = session.names.seen(key)
        if seen is None or not intersect(watch.full, key):
            return
        sample = Sample(seen, kind=kind)

        def tell() -> None:
            if not watch.is_over:
                guarded(partial(watch.handler.call, sample))

        def post() -> None:
            session.callers.post(("token", source), tell)

        for _ in range(session.fabric.times_of_a_token()):
            late_s = session.fabric.late_of_a_token_s()
            # The news of one token stay in order.
            due_ns = max(session.tasks.now_ns + round(late_s * 1e9), watch.late.get(key, 0))
            if due_ns <= session.tasks.now_ns:
                post()
            else:
                # By two threads of Zenoh they would change places at one instant.
                watch.late[key] = due_ns + 1_000_000
                session.tasks.call_at(due_ns, lambda: session.process.receive(post))

    def _by_source(self) -> list[tuple[object, list[str]]]:
        found: list[tuple[object, list[str]]] = []
        reported: set[str] = set()
        for source, declared in self._session.routing.sources():
            fresh = [key for key in declared[TOKEN] if key not in reported]
            reported.update(fresh)
            found.append((source, fresh))
        return found


class Liveliness:
    """Liveliness of a session, with the methods of Zenoh's own."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session

    def declare_token(self, key: str) -> Declared:
        session = self._session
        session.check_open()
        full = session.names.full(key)
        session.declarations.change(TOKEN, full, 1)
        return Declared(session, lambda: session.declarations.change(TOKEN, full, -1))

    def declare_subscriber(self, key: str, handler: Any, *, history: bool = False) -> Declared:
        session = self._session
        session.check_open()
        declared = session.tokens.watch(session.names.full(key), Handler(handler), history=history)
        session.tasks.step()
        return declared

    def get(self, key: str, handler: Any, *, timeout: float | None = None) -> None:
        session = self._session
        session.check_open()
        full = session.names.full(key)
        program = Handler(handler)
        delay_s = session.fabric.round_trip_s(session)

        def answer() -> None:
            for token in session.tokens:
                seen = session.names.seen(token)
                if seen is not None and intersect(full, token):
                    guarded(partial(program.call, Reply(Sample(seen))))
            if program.drop is not None:
                guarded(program.drop)

        session.tasks.call_after(
            min(delay_s, 10.0 if timeout is None else timeout),
            lambda: session.process.receive(lambda: session.callers.post(object(), answer)),
        )
