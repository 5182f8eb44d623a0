"""How a session takes part in scouting, and on which networks of this host."""

import socket
import struct
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from typing import NamedTuple

from tfbus.bus.endpoints import split_endpoint
from tfbus.bus.interfaces import Interface, scouted
from tfbus.bus.zenoh_sockets import Marks
from tfbus.wire.scouting import LARGEST

# Anyone can send a Scout.
MOST_ANSWERS_A_SECOND = 200


class Scouting(NamedTuple):
    """How a session takes part in scouting.

    `role` is "peer" or "router"; `listen` are its endpoints. `only` are the interfaces that its
    configuration names, () for all.
    """

    role: str
    listen: tuple[str, ...]
    group: tuple[str, int]
    ttl: int
    only: tuple[str, ...] = ()
    answers: bool = True
    connects: bool = True

    def marks(self) -> Marks:
        """The marks of the sockets of such a session."""
        ends = [split_endpoint(endpoint) for endpoint in self.listen]
        hosts = {address for _, host, port in ends if port == 0 for address in _addresses(host)}
        return Marks(hosts, self.group, self.ttl, len(self.only or places(())))


Place = tuple[int, str, str]  # the number, name and address of an interface


@cache
def places_at_start() -> frozenset[Place]:
    """The places as they were when this was called first: Zenoh stays at them."""
    return places(())


def places(only: tuple[str, ...]) -> frozenset[Place]:
    """The places to scout on now; `only` are the interfaces to which that is restricted."""
    return frozenset(
        (each.number, each.name, each.address) for each in scouted() if _is_among(each, only)
    )


def _is_among(interface: Interface, only: tuple[str, ...]) -> bool:
    return not only or interface.name in only or interface.address in only


def received(from_socket: socket.socket) -> Iterable[tuple[bytes, tuple[str, int]]]:
    """The news that have come by now, at most as many as one turn of the thread takes."""
    for _ in range(MOST_ANSWERS_A_SECOND):
        try:
            yield from_socket.recvfrom(LARGEST)
        except BlockingIOError:
            return
        except OSError:
            continue  # what was sent before had no receiver


def leave(one: socket.socket, group: str, places: Iterable[Place]) -> None:
    """Let a socket leave a group at these places."""
    for place in places:
        with suppress(OSError):  # the interface has gone, or it was not on it
            one.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, group_at(group, place))


def group_at(group: str, place: Place) -> bytes:
    """A group at a place, as options of sockets have it."""
    # By number: another interface may have the address next.
    return struct.pack("4s4si", socket.inet_aton(group), bytes(4), place[0])


def _addresses(host: str) -> set[str]:
    with suppress(OSError):
        return {str(found[4][0]) for found in socket.getaddrinfo(host or "::", None)}
    return set()
