"""A session of Zenoh in a simulated network, with the methods of Zenoh's own that the bus uses.

It does as eclipse-zenoh 1.10 does, as far as programs can tell; tests/simulation/scenarios.py holds
the two against each other. It allows more than real Zenoh shows: callbacks of different origins
come in any order, lost sessions meet again at any moment within 4 s, and `Faults` has faults that
real Zenoh shows too seldom for a test. Its parts have a file each: declarations, publications,
queries, liveliness, routing.
"""

import itertools
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.testing.callers import Callers, Handler, Source, guarded
from tfbus.testing.declarations import Declarations, Liveliness, SessionNames, Tokens, Undeclarable
from tfbus.testing.links import Face
from tfbus.testing.publications import Matchings, Publications, Publisher, Querier, SentMessage
from tfbus.testing.queries import Cancellation, Queries
from tfbus.testing.routing import routing_of
from tfbus.testing.tasks import SimulationOver, Tasks

if TYPE_CHECKING:
    from tfbus.testing.fabric import Fabric
    from tfbus.testing.processes import Process


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
        self.dst = f"tcp/{far.process.host.name}:0"
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

    def declare_transport_events_listener(
        self, handler: Any, *, history: bool = False
    ) -> Undeclarable:
        session = self._session
        session.check_open()
        number = next(self._numbers)
        watch = self._watches[number] = Handler(handler)
        if history:
            for far in session.faces:
                self._post(watch.call, TransportEvent(far, is_open=True))
        return Undeclarable(session, lambda: self._watches.pop(number, None))

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


_CLOSED = "session closed"


def _rank(priority: Any) -> int:
    """The rank of a message or query: 0 urgent, 1 others."""
    return 0 if priority in (zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.REAL_TIME) else 1


class ZenohSession:
    """A session, as `zenoh.open` returns one."""

    def __init__(
        self,
        fabric: "Fabric",
        process: "Process",
        *,
        mode: str,
        namespace: str,
        zid: str,
        connect: tuple[str, ...],
        listen: tuple[str, ...],
        has_bad_network: bool = False,
    ) -> None:
        self.fabric = fabric
        self.tasks: Tasks = fabric.tasks
        self.process = process
        self.mode = mode
        self.zid_text = zid
        self.connect, self.listen = connect, listen
        self.has_bad_network = has_bad_network
        self.names = SessionNames(namespace)
        # The links of the session, by the session at the far end of each.
        self.faces: dict[ZenohSession, Face] = {}
        # The sessions that it meets soon.
        self.looks_for: set[ZenohSession] = set()
        self.callers = Callers(self.tasks, process, "zenoh")
        self.declarations = Declarations(self)
        self.routing: Any = routing_of(self)
        self.publications = Publications(self)
        self.queries = Queries(self)
        self.tokens = Tokens(self)
        self.matchings = Matchings(self)
        self.info = Info(self)
        self.publisher_numbers = itertools.count(1)
        self._is_closed = False

    def zid(self) -> str:
        return self.zid_text

    def is_closed(self) -> bool:
        return self._is_closed

    def check_open(self) -> None:
        """Raise Zenoh's error if the session is closed, and SimulationOver in an ending task."""
        if self.tasks.is_over and self.tasks.current is not self.tasks.main:
            raise SimulationOver
        if self._is_closed:
            raise zenoh.ZError(_CLOSED)

    def close(self) -> None:
        """Leave the network; others know at once."""
        if self._is_closed:
            return
        self._is_closed = True
        self.publications.clear()
        self.tokens.clear()
        self.matchings.clear()
        self.queries.clear()
        self.fabric.leave(self)
        self.tasks.step()

    def declare_publisher(self, key: str, **options: Any) -> Publisher:
        self.check_open()
        return Publisher(self, key, options)

    def declare_querier(self, key: str, **options: Any) -> Querier:
        self.check_open()
        return Querier(self, key)

    def declare_subscriber(
        self, key: str, handler: Any = None, *, allowed_origin: Any = None
    ) -> Undeclarable:
        self.check_open()
        return self.publications.subscribe(
            self.names.full(key),
            Handler(handler),
            is_remote_only=allowed_origin == zenoh.Locality.REMOTE,
        )

    def declare_queryable(self, key: str, handler: Any = None, **options: Any) -> Undeclarable:
        self.check_open()
        return self.queries.serve(self.names.full(key), Handler(handler))

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
        message = SentMessage(
            self.names.full(str(key)),
            bytes(payload),
            source_info,
            must_arrive=congestion_control == zenoh.CongestionControl.BLOCK,
            rank=2 if priority == zenoh.Priority.BACKGROUND else _rank(priority),
        )
        also_here = allowed_destination != zenoh.Locality.REMOTE
        self.publications.send(message, also_here=also_here)

    def get(
        self,
        selector: str,
        handler: Any = None,
        *,
        payload: bytes | None = None,
        timeout: float | None = None,
        allowed_destination: Any = None,
        cancellation_token: Cancellation | None = None,
        priority: Any = None,
        **options: Any,
    ) -> None:
        self.check_open()
        self.tasks.step()
        key, _, parameters = str(selector).partition("?")
        self.queries.ask(
            self.names.full(key),
            parameters,
            None if payload is None else bytes(payload),
            Handler(handler),
            timeout_s=timeout,
            also_here=allowed_destination != zenoh.Locality.REMOTE,
            cancellation=cancellation_token,
            rank=_rank(priority),
        )

    def liveliness(self) -> Liveliness:
        return Liveliness(self)

    # Links

    def greet(self, face: Face) -> None:
        """A face is new: tell its far end all that it has to know."""
        self.faces[face.far_session] = face
        self.routing.greet(face)
        self.info.report(face.far_session, is_open=True)

    def part(self, face: Face) -> None:
        """A face has ended: the declarations of its far end do, and so do queries."""
        if self.faces.get(face.far_session) is face:
            del self.faces[face.far_session]
        self.declarations.end_of(face)
        self.routing.part(face)
        self.queries.end_of(face)
        self.info.report(face.far_session, is_open=False)
