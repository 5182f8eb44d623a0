"""Meeting: which sessions look for each other, by their modes, endpoints, multicast and gossip.

A peer links to all peers and routers that it finds, a client to one router at a time, a router to
those that `connect` names. A peer finds others by multicast, or introduced by a session that both
have a link to; each introduces two others once. Links to clients of peers are not simulated.
"""

import re
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tfbus.testing.links import Paths
    from tfbus.testing.processes import Host
    from tfbus.testing.zenoh_session import ZenohSession

_ENDPOINT = re.compile(r"(?P<protocol>[\w-]+)/\[?(?P<host>[^\]#?]*?)\]?(:(?P<port>\d+))?([#?].*)?")
_ROUTER_PORT = "7447"
_LOOPBACK = re.compile(r"localhost|127\..*|::1")
_ANY = ("::", "0.0.0.0")


class Meeting:
    """Says how two sessions find each other, on the paths of a network."""

    def __init__(self, paths: "Paths") -> None:
        self._paths = paths
        # The number of the last connection of two: whom both knew before introduces them no more.
        self._met: dict[tuple[object, object], int] = {}

    def protocol(self, one: "ZenohSession", other: "ZenohSession") -> str:
        """The protocol of the link that two sessions make; "" if neither looks for the other."""
        if "client" in (one.mode, other.mode):
            return self._of_client(*((one, other) if one.mode == "client" else (other, one)))
        named = _named(one, other) or _named(other, one)
        if named:
            return named
        is_found = "peer" in (one.mode, other.mode) and (
            self._is_multicast(one, other) or self._introduces(one, other)
        )
        return (_found_at(other, one) or _found_at(one, other)) if is_found else ""

    def _of_client(self, client: "ZenohSession", other: "ZenohSession") -> str:
        if other.mode != "router" or client.faces:
            return ""
        if client.connect:
            return _named(client, other)
        return _found_at(other, client) if self._is_multicast(client, other) else ""

    def _is_multicast(self, one: "ZenohSession", other: "ZenohSession") -> bool:
        paths = self._paths.both_ways(one.process.host, other.process.host)
        return all(path.multicast for path in paths)

    def _introduces(self, one: "ZenohSession", other: "ZenohSession") -> bool:
        """Whether a third session that both have a link to introduces them now."""
        met = self._met.get(_pair(one, other), -1)
        return any(
            one.faces[third].number > met or other.faces[third].number > met
            for third in _between(one, other)
        )

    def note_link(self, one: "ZenohSession", other: "ZenohSession") -> None:
        """Two sessions have a link: nobody introduces them again."""
        self._met[_pair(one, other)] = max(one.faces[other].number, other.faces[one].number)


def _pair(one: "ZenohSession", other: "ZenohSession") -> "tuple[ZenohSession, ZenohSession]":
    return (one, other) if one.zid_text > other.zid_text else (other, one)


def _between(one: "ZenohSession", other: "ZenohSession") -> "list[ZenohSession]":
    return [far for far in one.faces if far in other.faces and far.mode != "client"]


def _named(one: "ZenohSession", other: "ZenohSession") -> str:
    """The protocol by which `connect` of one session names the other; "" if it does not."""
    for endpoint in one.connect:
        found = _ENDPOINT.fullmatch(endpoint)
        if found and _is_at(found["host"], one.process.host, other.process.host):
            for protocol, host, port in _listens(other):
                is_heard = _is_heard(host, one, other)
                if (protocol, port) == (found["protocol"], found["port"]) and is_heard:
                    return protocol
    return ""


def _found_at(other: "ZenohSession", one: "ZenohSession") -> str:
    """The protocol by which a session reaches another that told it where it listens."""
    for protocol, host, _ in _listens(other):
        if _is_heard(host, one, other):
            return protocol
    return ""


def _listens(session: "ZenohSession") -> list[tuple[str, str, str | None]]:
    """The protocol, host and port of each endpoint that a session listens on."""
    given = session.listen or (f"tcp/[::]:{_ROUTER_PORT if session.mode == 'router' else 0}",)
    return _places(given)


@lru_cache(maxsize=1000)
def _places(endpoints: tuple[str, ...]) -> list[tuple[str, str, str | None]]:
    found = [_ENDPOINT.fullmatch(endpoint) for endpoint in endpoints]
    return [(each["protocol"], each["host"], each["port"]) for each in found if each]


def foreign_place(session: "ZenohSession") -> str:
    """The endpoint that a session cannot listen on, since the address is not its host's; or ""."""
    host = session.process.host
    for endpoint in session.listen:
        found = _ENDPOINT.fullmatch(endpoint)
        if found and found["host"] and not _is_at(found["host"], host, host):
            return endpoint
    return ""


def _is_heard(listens_at: str, one: "ZenohSession", other: "ZenohSession") -> bool:
    """Whether a session is on a host that reaches the address at which another listens."""
    return one.process.host is other.process.host or not _LOOPBACK.fullmatch(listens_at)


def _is_at(name: str, here: "Host", there: "Host") -> bool:
    """Whether a name or address is that of a host, as another one resolves it."""
    if _LOOPBACK.fullmatch(name) or name in _ANY:
        return here is there
    return name in (there.name, there.address)
