"""Services and actions as Foxglove's Service Call panel calls them."""

import json
from collections.abc import Mapping
from typing import Any

from tfbus import messages
from tfbus.bus.session import Session
from tfbus.discover.graph import Graph, ServiceInfo
from tfbus.errors import ServiceError
from tfbus.foxglove.as_json import json_of, json_schema, values_of
from tfbus.foxglove.graph import absolute
from tfbus.foxglove.server import Server, Service
from tfbus.wire.codec import as_map, decode_map, encode_map, from_map

# A service answers at once; an action may take long, and the panel waits for its result.
_TIMEOUT_S = 60.0

_MOST_SERVICES = 2000


class LiveServices:
    """The services of the bus, as of the last `update`.

    An action is a service whose request is the goal and whose response is the result.
    """

    def __init__(self, session: Session, server: Server) -> None:
        self._session = session
        self._server = server
        self._offered: dict[str, str] = {}

    def update(self, graph: Graph) -> None:
        """Take the services of the graph."""
        present = {
            absolute(name): _type_of(info)
            for name, info in list(graph.services.items())[:_MOST_SERVICES]
            if info.servers
        }
        gone = [name for name, of in self._offered.items() if present.get(name) != of]
        if gone:
            self._server.remove_services(gone)
        for name in gone:
            del self._offered[name]
        for name, type_name in present.items():
            if name not in self._offered:
                self._offered[name] = type_name
                self._server.add_service(self._service(name, type_name))

    def _service(self, name: str, type_name: str) -> Service:
        request, response = _parts(type_name)
        return Service(
            name,
            type_name or "unknown",
            _schema(request),
            _schema(response),
            lambda asked: self._call(name, request, asked),
        )

    def _call(self, name: str, request_type: type | None, asked: bytes) -> bytes:
        values = values_of(asked, request_type)
        if request_type is not None:
            values = as_map(from_map(request_type, values, unknown_fields=False))
        return json_of(self._last_answer(name, values))

    def _last_answer(self, name: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        last: Mapping[str, Any] | None = None
        self._session.settings.check_right("calls", name)
        for answer in self._session.ask(name, encode_map(values), timeout_s=_TIMEOUT_S):
            if answer.refusal is not None:
                raise ServiceError(answer.refusal or f"{name} did not answer in time")
            last = decode_map(answer.payload)
        if last is None:
            raise ServiceError(f"{name} did not answer")
        return last


def _type_of(info: ServiceInfo) -> str:
    return next(iter(info.types), "")


def _parts(type_name: str) -> tuple[type | None, type | None]:
    """The types of request and response, as far as tfbus.messages has them."""
    found = getattr(messages, type_name, None)
    request = getattr(found, "Request", None) or getattr(found, "Goal", None)
    return request, getattr(found, "Response", None)


def _schema(message_type: type | None) -> tuple[str, str]:
    """The name of a type, and its schema in JSON."""
    if message_type is None:
        return "", json.dumps({"type": "object"})
    return message_type.__qualname__, json.dumps(json_schema(message_type))
