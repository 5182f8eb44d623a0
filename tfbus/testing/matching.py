"""Publishers and queriers, which know whether they have a counterpart."""

import itertools
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.callers import Handler
from tfbus.testing.declarations import QUERYABLE, SUBSCRIBER, Declared
from tfbus.testing.keys import intersect

if TYPE_CHECKING:
    from tfbus.testing.zenoh_session import ZenohSession


class MatchingStatus:
    """Whether there is a counterpart."""

    def __init__(self, matching: bool) -> None:
        self.matching = matching


class _Watch:
    """Reports whether a declaration has counterparts."""

    def __init__(self, session: "ZenohSession", kind: str, full: str, handler: Handler) -> None:
        self._session = session
        self._kind = kind
        self._full = full
        self._handler = handler
        self._former = session.declarations.has(kind, full)

    def is_of(self, kind: str, key: str) -> bool:
        """Whether a declaration of this kind and key may change what it reports."""
        return kind == self._kind and intersect(key, self._full)

    def look(self) -> None:
        now = self._session.declarations.has(self._kind, self._full)
        if now != self._former:
            self._former = now
            status = MatchingStatus(now)
            self._session.callers.post(self, lambda: self._handler.call(status))


class Matchings:
    """The watches of one session."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._watches: dict[int, _Watch] = {}

    def watch(self, kind: str, full: str, handler: Any) -> Declared:
        """Call the handler whenever `has` of the declarations changes."""
        number = next(self._numbers)
        self._watches[number] = _Watch(self._session, kind, full, Handler(handler))
        return Declared(self._session, lambda: self._watches.pop(number, None))

    def look(self, kind: str, key: str) -> None:
        """A declaration has come or ended: report what it changes."""
        for watch in list(self._watches.values()):
            if watch.is_of(kind, key):
                watch.look()

    def clear(self) -> None:
        """Watch nothing more."""
        self._watches.clear()


class _Matched(Declared):
    """A publisher or querier: it knows whether it has a counterpart."""

    _kind = SUBSCRIBER

    def __init__(self, session: "ZenohSession", key: str) -> None:
        super().__init__(session, lambda: None)
        self._key = key
        self._full = session.names.full(key)

    @property
    def matching_status(self) -> MatchingStatus:
        self._session.check_open()
        return MatchingStatus(self._session.declarations.has(self._kind, self._full))

    def declare_matching_listener(self, handler: Any) -> Declared:
        return self._session.matchings.watch(self._kind, self._full, handler)


class Publisher(_Matched):
    """A publisher of one key."""

    def __init__(self, session: "ZenohSession", key: str, options: dict[str, Any]) -> None:
        super().__init__(session, key)
        self._options = options

    def put(self, payload: bytes, **options: Any) -> None:
        if self._end is None:
            raise zenoh.ZError("Undeclared publisher")
        self._session.put(self._key, payload, **self._options)


class Querier(_Matched):
    """Asks at one key."""

    _kind = QUERYABLE
