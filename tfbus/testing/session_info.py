"""A session's knowledge of itself and of its links, and watches of these."""

import itertools
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.callers import Handler, guarded
from tfbus.testing.declarations import Declared

if TYPE_CHECKING:
    from tfbus.testing.processes import Process
    from tfbus.testing.zenoh_session import ZenohSession

_MODES = {
    "peer": zenoh.WhatAmI.PEER,
    "client": zenoh.WhatAmI.CLIENT,
    "router": zenoh.WhatAmI.ROUTER,
}


class LinkInfo:
    """A link, or the connection that it is of: the session at its far end."""

    def __init__(self, far: "ZenohSession") -> None:
        self.zid = far.zid_text
        self.whatami = _MODES[far.mode]
        self.auth_identifier = None


class TransportEvent:
    """A connection that opens or ends."""

    def __init__(self, far: "ZenohSession", *, is_open: bool) -> None:
        self.transport = LinkInfo(far)
        self.kind = zenoh.SampleKind.PUT if is_open else zenoh.SampleKind.DELETE


class Info:
    """Information of a session, with the methods of Zenoh's own."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._watches: dict[int, Handler] = {}

    def zid(self) -> str:
        return self._session.zid_text

    def routers_zid(self) -> list[str]:
        return [far.zid_text for far in self._session.faces if far.mode == "router"]

    def peers_zid(self) -> list[str]:
        return [far.zid_text for far in self._session.faces if far.mode == "peer"]

    def links(self) -> list[LinkInfo]:
        return [LinkInfo(far) for far in self._session.faces]

    def declare_transport_events_listener(self, handler: Any, *, history: bool = False) -> Declared:
        session = self._session
        session.check_open()
        number = next(self._numbers)
        watch = self._watches[number] = Handler(handler)
        if history:
            for far in session.faces:
                self._post(watch.call, TransportEvent(far, is_open=True))
        return Declared(session, lambda: self._watches.pop(number, None))

    def report(self, far: "ZenohSession", *, is_open: bool) -> None:
        """Tell the watches of a connection that opens or ends."""
        for watch in list(self._watches.values()):
            self._post(watch.call, TransportEvent(far, is_open=is_open))

    def _post(self, call: Callable[[TransportEvent], object], event: TransportEvent) -> None:
        self._session.callers.post("links", partial(call, event))


class Hello:
    """The answer of a session to one that scouts."""

    def __init__(self, session: "ZenohSession") -> None:
        self.zid = session.zid_text
        self.locators = list(session.listen)


class Scout:
    """A search for sessions, until `stop()`."""

    def __init__(self, process: "Process", handler: Handler) -> None:
        self.process = process
        self._handler = handler
        self._is_over = False

    def hear(self, session: "ZenohSession") -> None:
        """A session answers, if it still runs."""
        if session.process.is_running and not self._is_over:
            self.process.receive(lambda: guarded(lambda: self._handler.call(Hello(session))))

    def stop(self) -> None:
        self._is_over = True
