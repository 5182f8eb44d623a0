"""The network interfaces of this host, and the addresses that scouting needs."""

import socket
import struct
import sys
from typing import NamedTuple

# From Linux's <linux/sockios.h> and <net/if.h>.
_GET_FLAGS = 0x8913
_GET_ADDRESS = 0x8915
_UP = 0x1
_LOOPBACK = 0x8
_RUNNING = 0x40
_MULTICAST = 0x1000


class Interface(NamedTuple):
    """A network interface of this host: whether it is up, has a carrier, and carries multicast.

    `address` is its first one of IPv4, "" for none. `number` is another one once the interface is
    replaced by one of the same name.
    """

    name: str
    is_up: bool
    has_multicast: bool
    is_loopback: bool
    has_carrier: bool = True
    address: str = ""
    number: int = 0

    @property
    def is_on_network(self) -> bool:
        """Whether scouting reaches other hosts by it."""
        is_ready = self.is_up and self.has_carrier and bool(self.address)
        return is_ready and self.has_multicast and not self.is_loopback


def interfaces() -> list[Interface]:
    """The network interfaces of this host; [] if it is not Linux."""
    if sys.platform != "linux":
        return []
    return [found for at, name in socket.if_nameindex() if (found := _interface(at, name))]


def scouted() -> list[Interface]:
    """The interfaces to scout on: all that are on a network, or loopback if none is.

    Zenoh scouts on every interface but loopback: without a network it finds no process, not even
    on the same machine.
    """
    known = interfaces()
    return [each for each in known if each.is_on_network] or [
        each for each in known if each.is_loopback and each.address
    ]


def _interface(index: int, name: str) -> Interface | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = _asked(any_socket, _GET_FLAGS, name)
        if answer is None:  # it has just gone
            return None
        flags: int = struct.unpack("16sh14x", answer)[1]
        answer = _asked(any_socket, _GET_ADDRESS, name)
    return Interface(
        name,
        bool(flags & _UP),
        bool(flags & _MULTICAST),
        bool(flags & _LOOPBACK),
        bool(flags & _RUNNING),
        "" if answer is None else socket.inet_ntoa(answer[20:24]),
        index,
    )


def _asked(any_socket: socket.socket, request: int, name: str) -> bytes | None:
    """The answer of the kernel; None if the interface has gone, or has no address."""
    import fcntl  # Windows has none

    try:
        return fcntl.ioctl(any_socket, request, struct.pack("16s16x", name.encode()))
    except OSError:
        return None
