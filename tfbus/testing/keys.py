"""Keys of a simulated session: which expressions meet, and the namespace before each."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Generic, TypeVar

import zenoh

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
