"""Declarations of a session, its own and those it has heard of, and which of their keys meet.

Each has a source: the session itself, the face of a peer or client, or the table of another router.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import TYPE_CHECKING, Generic, TypeVar

import zenoh

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


class Holders(Generic[Holder]):
    """By key all that have declared it; says which of them a key or expression meets."""

    def __init__(self) -> None:
        self._holders: dict[str, dict[Holder, None]] = {}
        # The keys by their first two names, of thousands of which an expression meets few.
        self._below: dict[str, dict[str, None]] = {}
        self._expressions: dict[str, None] = {}
        # What was found, until a holder comes or goes.
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


class Names:
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


class Declared:
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
        self.heard: dict[str, Holders[Face]] = {kind: Holders() for kind in KINDS}

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
        """A source has one declaration more, or less: count it, and tell all who have to know."""
        session = self.session
        session.routing.spread(source, kind, key, change)
        if kind == TOKEN:
            session.tokens.count(key, change, source)
        elif not session.is_closed():
            session.matchings.look(kind, key)

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of this kind meets a key, here or at another session."""
        own = self.own[kind]
        if full in own or any(intersect(each, full) for each in own):
            return True
        return bool(self.session.routing.has(kind, full))
