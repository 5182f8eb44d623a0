"""Declarations of a session, its own and ones it has heard of, and which of their keys meet.

Each has a source: the session itself, the face of a peer or client, or the table of another router.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import zenoh

from tfbus.testing.callers import Handler, Reply, Sample, guarded

if TYPE_CHECKING:
    from tfbus.testing.links import Face
    from tfbus.testing.zenoh_session import ZenohSession

Holder = TypeVar("Holder")


@lru_cache(maxsize=200_000)
def intersect(one: str, other: str) -> bool:
    """Whether two key expressions have a key in common."""
    if one == other:
        return True
    if "*" not in one and "*" not in other:
        return False
    return zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(other))


@lru_cache(maxsize=200_000)
def checked(key: str) -> str:
    """The key expression in its one form. Raises Zenoh's error if it is none."""
    return str(zenoh.KeyExpr.autocanonize(key)) if "*" in key else str(zenoh.KeyExpr(key))


class Keys(dict[str, None]):
    """Keys and key expressions that somebody has declared, in their order."""

    def __init__(self, keys: Iterable[str] = ()) -> None:
        super().__init__()
        # Of thousands of keys only these can meet one that is not the same.
        self._expressions: dict[str, None] = {}
        for key in keys:
            self[key] = None

    def __setitem__(self, key: str, value: None) -> None:
        super().__setitem__(key, value)
        if "*" in key:
            self._expressions[key] = None

    def __delitem__(self, key: str) -> None:
        super().__delitem__(key)
        self._expressions.pop(key, None)

    def meets(self, key: str) -> bool:
        """Whether one of them has a key in common with a key or expression."""
        if key in self:
            return True
        others = self if "*" in key else self._expressions
        return bool(others) and any(intersect(each, key) for each in others)


class KeyHolders(Generic[Holder]):
    """By key all that have declared it; says which of them a key or expression meets."""

    def __init__(self) -> None:
        self._holders: dict[str, dict[Holder, None]] = {}
        # The keys by their first two names, of thousands of which an expression meets few.
        self._below: dict[str, dict[str, None]] = {}
        self._expressions: dict[str, None] = {}
        # The found holders, until a holder comes or goes.
        self._found: dict[str, dict[Holder, None]] = {}

    def add(self, key: str, holder: Holder) -> None:
        """It has declared this key."""
        holders = self._holders.get(key)
        if holders is None:
            holders = self._holders[key] = {}
            self._keys_beside(key)[key] = None
        holders[holder] = None
        self._found.clear()

    def discard(self, key: str, holder: Holder) -> None:
        """It has ended the declaration of this key."""
        holders = self._holders.get(key, {})
        holders.pop(holder, None)
        if not holders and self._holders.pop(key, None) is not None:
            del self._keys_beside(key)[key]
        self._found.clear()

    def met_by(self, key: str) -> dict[Holder, None]:
        """All that have declared something that a key or expression meets."""
        found = self._found.get(key)
        if found is None:
            found = self._found[key] = dict(self._holders.get(key, ()))
            for each in [*self._expressions, *(self._near(key) if "*" in key else ())]:
                if each != key and intersect(each, key):
                    found.update(self._holders[each])
        return found

    def _keys_beside(self, key: str) -> dict[str, None]:
        return self._expressions if "*" in key else self._below.setdefault(_first_two(key), {})

    def _near(self, expression: str) -> Iterable[str]:
        """The keys that an expression may meet."""
        first_two = _first_two(expression)
        if "*" not in first_two:
            return self._below.get(first_two, ())
        return (key for keys in self._below.values() for key in keys)


def _first_two(key: str) -> str:
    return "/".join(key.split("/", 2)[:2])


class SessionNames:
    """Names of one session: its namespace is before all its keys on the network."""

    def __init__(self, namespace: str) -> None:
        self._prefix = f"{namespace}/" if namespace else ""

    def full(self, key: str) -> str:
        """A key of the session as the network has it. Raises Zenoh's error if it is none."""
        return f"{self._prefix}{checked(key)}"

    def seen(self, full: str) -> str | None:
        """A key of the network, or an expression of keys, as the session names it; None for one of
        other namespaces only.
        """
        if not self._prefix:
            return full
        if "*" in full:
            return _without(self._prefix.rstrip("/").split("/"), full.split("/"))
        return full.removeprefix(self._prefix) if full.startswith(self._prefix) else None


def _without(namespace: list[str], chunks: list[str]) -> str | None:
    """An expression without the chunks that stand for a namespace; None if none can."""
    for number, name in enumerate(namespace):
        chunk = chunks[number] if number < len(chunks) else ""
        if chunk == "**":
            return "/".join(chunks[number:])
        if not chunk or not intersect(chunk, name):
            return None
    return "/".join(chunks[len(namespace) :]) or None


SUBSCRIBER, QUERYABLE, TOKEN = "subscriber", "queryable", "token"
KINDS = SUBSCRIBER, QUERYABLE, TOKEN


class Undeclarable:
    """A declaration that the program holds, until `undeclare()`."""

    def __init__(self, session: "ZenohSession", end: Callable[[], object]) -> None:
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


class Declarations:
    """Declarations of one session, and of the others it knows."""

    def __init__(self, session: "ZenohSession") -> None:
        self.session = session
        self.own: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        # The faces by which others have declared keys.
        self.heard: dict[str, KeyHolders[Face]] = {kind: KeyHolders() for kind in KINDS}

    def change(self, kind: str, full: str, by: int) -> None:
        """The program declares one more of this kind and key, or ends one."""
        own = self.own[kind]
        own[full] += by
        if own[full] == 0:
            del own[full]
        self.spread(self.session, kind, full, by)
        self.session.tasks.step()

    def hear(self, face: "Face", kind: str, key: str, is_new: bool) -> None:
        """The far end of a face declares something, or ends it."""
        declared = face.declared[kind]
        if is_new == (key in declared):
            return
        if is_new:
            declared[key] = None
            self.heard[kind].add(key, face)
        else:
            del declared[key]
            self.heard[kind].discard(key, face)
        self.spread(face, kind, key, 1 if is_new else -1)

    def end_of(self, face: "Face") -> None:
        """A face has ended, and all that its far end had declared."""
        for kind, declared in face.declared.items():
            for key in list(declared):
                del declared[key]
                self.heard[kind].discard(key, face)
                self.spread(face, kind, key, -1)

    def move(self, former: "Face", face: "Face") -> None:
        """A face continues a former one, and has all that was declared by that."""
        for kind, declared in former.declared.items():
            for key in declared:
                self.heard[kind].discard(key, former)
                self.heard[kind].add(key, face)

    def spread(self, source: object, kind: str, key: str, change: int) -> None:
        """A source has one declaration more, or less: count it, and tell the sessions concerned."""
        session = self.session
        session.routing.spread(source, kind, key, change)
        if kind == TOKEN:
            session.tokens.count(key, change, source)
        elif not session.is_closed():
            session.matchings.report_changes(kind, key)

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of this kind meets a key, here or at another session."""
        own = self.own[kind]
        if full in own or any(intersect(each, full) for each in own):
            return True
        return bool(self.session.routing.has(kind, full))


class _TokenWatch:
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
        self._watches: dict[int, _TokenWatch] = {}
        # By how many sources each token is declared; and tokens whose end was told nevertheless.
        self._count: Counter[str] = Counter()
        self._lost: set[str] = set()

    def __iter__(self) -> Any:
        return iter([key for key in self._count if key not in self._lost])

    def count(self, key: str, change: int, source: object) -> None:
        """Count a source of a token more, or less: the first and the last are news."""
        former = self._count[key]
        self._count[key] += change
        if self._count[key] == 0:
            del self._count[key]
        is_there = key in self._count
        if is_there != bool(former):
            self.report(key, alive=is_there, source=source)
            self._lost.discard(key)

    def report(self, key: str, *, alive: bool, source: object = None) -> None:
        """Report that a token is there, or is not, whether or not it is: as by half a link, by
        which one that has ended is not found either.
        """
        (self._lost.discard if alive else self._lost.add)(key)
        kind = zenoh.SampleKind.PUT if alive else zenoh.SampleKind.DELETE
        for watch in list(self._watches.values()):
            self._report(watch, key, kind, source)

    def watch(self, full: str, handler: Handler, *, history: bool) -> Undeclarable:
        """Report tokens as they come and end; with `history` present ones first."""
        number = next(self._numbers)
        watch = self._watches[number] = _TokenWatch(full, handler)
        if history:
            # By their sources: news of one source come in order.
            for source, keys in self._by_source():
                for key in keys:
                    self._report(watch, key, zenoh.SampleKind.PUT, source)

        def undeclare() -> None:
            watch.is_over = True
            self._watches.pop(number, None)

        return Undeclarable(self._session, undeclare)

    def clear(self) -> None:
        """Watch nothing more."""
        self._watches.clear()

    def _report(self, watch: _TokenWatch, key: str, kind: Any, source: object) -> None:
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

    def declare_token(self, key: str) -> Undeclarable:
        session = self._session
        session.check_open()
        full = session.names.full(key)
        session.declarations.change(TOKEN, full, 1)
        return Undeclarable(session, lambda: session.declarations.change(TOKEN, full, -1))

    def declare_subscriber(self, key: str, handler: Any, *, history: bool = False) -> Undeclarable:
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
