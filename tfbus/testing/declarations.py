"""Declarations of a session: its own, and those it has heard of; each has a source.

A source is the session itself, the face of a peer or client, or the table of another router.
"""

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING

from tfbus.testing.keys import Holders, intersect

if TYPE_CHECKING:
    from tfbus.testing.faces import Face
    from tfbus.testing.zenoh_session import ZenohSession

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
        self._session = session
        self.own: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        # The faces by which others have declared keys.
        self.heard: dict[str, Holders[Face]] = {kind: Holders() for kind in KINDS}

    def change(self, kind: str, full: str, by: int) -> None:
        """The program declares one more of this kind and key, or ends one."""
        own = self.own[kind]
        own[full] += by
        if own[full] == 0:
            del own[full]
        self.spread(self._session, kind, full, by)
        self._session.tasks.step()

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
        session = self._session
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
        return bool(self._session.routing.has(kind, full))
