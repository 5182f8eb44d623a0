"""The network interfaces of this host, and which of them scouting needs."""

import socket
import struct
import sys
from typing import NamedTuple

# From Linux's <linux/sockios.h> and <net/if.h>.
_GET_FLAGS = 0x8913
_UP = 0x1
_LOOPBACK = 0x8
_MULTICAST = 0x1000


class Interface(NamedTuple):
    """A network interface of this host, and whether it is up and carries multicast."""

    name: str
    is_up: bool
    has_multicast: bool
    is_loopback: bool


def interfaces() -> list[Interface]:
    """The network interfaces of this host; [] where it is not Linux."""
    if sys.platform != "linux":
        return []
    return [_interface(name) for _, name in socket.if_nameindex()]


def loopback_where_alone() -> str:
    """The loopback interface where no other can carry multicast, "" otherwise.

    Zenoh scouts on every interface but loopback: without a network it finds no process, not even
    on the same machine. Always "" where the host is not Linux.
    """
    known = interfaces()
    if any(each.is_up and each.has_multicast and not each.is_loopback for each in known):
        return ""
    return next((each.name for each in known if each.is_loopback), "")


def _interface(name: str) -> Interface:
    import fcntl  # Windows has none

    request = struct.pack("16sh14x", name.encode(), 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = fcntl.ioctl(any_socket, _GET_FLAGS, request)
    flags: int = struct.unpack("16sh14x", answer)[1]
    return Interface(name, bool(flags & _UP), bool(flags & _MULTICAST), bool(flags & _LOOPBACK))
