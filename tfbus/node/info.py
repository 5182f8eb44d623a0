"""How a node describes itself, and the queries that it answers with that."""

import os
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from tfbus.bus.query import Query
from tfbus.bus.session import Session
from tfbus.node.endpoint import Endpoint
from tfbus.node.parameters import Parameters
from tfbus.runtime import scheduler
from tfbus.runtime.installation import installed_version
from tfbus.wire.codec import encode_map
from tfbus.wire.descriptions import FILLED_BY_OTHERS
from tfbus.wire.keys import clock_key, node_key

# Returns entries for fields of the description.
Describer = Callable[[], Mapping[str, Sequence[Any]]]

E = TypeVar("E", bound=Endpoint)


class NodeInfo:
    """A node's description, the fields of a NodeDescription, and its system's clock, on the bus.

    `describers` add what the node itself does not know; what several return for a field is joined.
    """

    def __init__(
        self, name: str, full_name: str, started_ns: int, session: Session, parameters: Parameters
    ) -> None:
        self.describers: list[Describer] = []
        self._name = name
        self._full_name = full_name
        self._started_ns = started_ns
        self._session = session
        self._parameters = parameters
        self._lock = scheduler.Lock()
        self._endpoints: dict[str, list[Endpoint]] = {
            kind: [] for kind in ("publishes", "subscribes", "serves", "calls")
        }
        session.queryable(node_key(name), self._on_info_query)
        session.queryable(clock_key(name), self._on_clock_query)

    def add(self, kind: str, endpoint: E) -> E:
        """List the endpoint for as long as it is open, and return it."""
        with self._lock:
            is_open = [each for each in self._endpoints[kind] if not each.closed]
            self._endpoints[kind] = [*is_open, endpoint]
        return endpoint

    def describe(self) -> dict[str, Any]:
        """The node's name, host and current endpoints."""
        described: dict[str, list[Any]] = {field: [] for field in FILLED_BY_OTHERS}
        for describe in list(self.describers):
            for field, entries in describe().items():
                described.setdefault(field, []).extend(entries)
        return {
            "name": self._full_name,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "version": installed_version(),
            "session": self._session.id,
            "started_ns": self._started_ns,
            **self._membership(),
            **described,
            "parameters": [parameter.describe() for parameter in self._parameters],
            **{
                kind: {each.name: each.type_name for each in endpoints if not each.closed}
                for kind, endpoints in self._endpoints.items()
            },
            "retained": [
                each.name
                for each in self._endpoints["publishes"]
                if each.retained and not each.closed
            ],
        }

    def _definitions(self) -> dict[str, str]:
        """The definitions of the types of its publishers, by name."""
        open_ones = [each for each in self._endpoints["publishes"] if not each.closed]
        return {each.type_name: each.definition for each in open_ones if each.definition}

    def _membership(self) -> dict[str, str]:
        """Which identity it is on a closed bus, and which rights it enforces."""
        closed = self._session.settings.closed
        if closed is None:
            return {}
        return {"identity": closed.identity.name, "rights": closed.digest}

    def _on_info_query(self, query: Query) -> None:
        described = self.describe()
        if query.parameter("definitions"):
            described["definitions"] = self._definitions()
        query.answer(node_key(self._name), encode_map(described))
        query.close()

    def _on_clock_query(self, query: Query) -> None:
        received_ns = scheduler.time_ns()
        times = {"received": received_ns, "now": scheduler.time_ns()}
        query.answer(clock_key(self._name), encode_map(times))
        query.close()
