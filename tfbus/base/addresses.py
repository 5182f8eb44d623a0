"""The addresses of this host: of its network interfaces, which change, and for others to open."""

import socket
import struct
import sys
from typing import TYPE_CHECKING, Any

from tfbus.base.structs import Struct

if TYPE_CHECKING:
    import ipaddress

# Why Python looks up no address of a name, which it says by a UnicodeError.
NO_HOST_NAME = "no host has such a name: its parts have 1 to 63 characters"


def is_local(host: str) -> bool:
    """Whether a host, a name or an address, is only this machine."""
    address = address_of(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def names_to_open(host: str) -> tuple[str, ...]:
    """The name for a browser to open if a server listens at `host`.

    `0.0.0.0` and `::` stand for all addresses of this machine, and no browser opens them.
    """
    address = address_of(host)
    if address is not None and address.is_unspecified:
        return ("localhost", socket.gethostname())
    return (host,)


def names_to_open_elsewhere(host: str) -> tuple[str, ...]:
    """The name for a browser of another machine to open if a server listens at `host`."""
    address = address_of(host)
    if address is not None and address.is_unspecified:
        return tuple(filter(None, (socket.gethostname(), main_address())))
    return (host,)


def own_names() -> frozenset[str]:
    """The host names of this machine in small letters: with and without its domain."""
    full = socket.gethostname(), socket.getfqdn()
    return frozenset(name.lower() for name in (*full, full[0].partition(".")[0]))


def main_address() -> str:
    """The address under which other machines most likely reach this one; "" if none does."""
    for family, elsewhere in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        try:
            # Sends nothing: only the route is looked up.
            with socket.socket(family, socket.SOCK_DGRAM) as probe:
                probe.connect((elsewhere, 9))
                found = str(probe.getsockname()[0])
        except OSError:
            continue
        if not is_local(found):
            return found
    return ""


def address_of(name: str) -> "ipaddress.IPv4Address | ipaddress.IPv6Address | None":
    """The address that a text is; None if it is a name."""
    import ipaddress  # slow to import, and few processes need it

    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


# Network interfaces

# From Linux's <linux/sockios.h> and <net/if.h>.
_GET_FLAGS = 0x8913
_GET_ADDRESS = 0x8915
_UP = 0x1
_LOOPBACK = 0x8
_RUNNING = 0x40
_MULTICAST = 0x1000


class Interface(Struct):
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
    return [found for at, name in socket.if_nameindex() if (found := interface_of(at, name))]


def scouted() -> list[Interface]:
    """The interfaces to scout on: all that are on a network, or loopback if none is.

    Zenoh scouts on every interface but loopback: without a network it finds no process, not even
    on the same machine.
    """
    known = interfaces()
    return [each for each in known if each.is_on_network] or [
        each for each in known if each.is_loopback and each.address
    ]


def interface_of(index: int, name: str) -> Interface | None:
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


# From Linux's <linux/rtnetlink.h>: changes of links and of addresses of IPv4.
_LINKS = 0x1
_ADDRESSES = 0x10

_MOST_BYTES = 65536

# The interfaces are looked at after this time if the kernel does not tell of changes.
_POLLED_S = 2.0


class NetworkWatch:
    """Becomes readable when the network of this host may have changed, until `close()`.

    The kernel tells of changes by a socket. If it does not, as in some containers, `socket` is None
    and `polled_s` the time after which to look; None if nothing needs a look.
    """

    def __init__(self) -> None:
        self.socket = _told_by_kernel()
        self.polled_s = None if self.socket is not None else _POLLED_S

    def drain(self) -> None:
        """Drop the kernel's messages so far."""
        if self.socket is not None:
            try:
                while self.socket.recv(_MOST_BYTES):
                    pass
            except OSError:  # nothing is left, or more came than the kernel keeps
                pass

    def close(self) -> None:
        """End the watch. Twice is fine."""
        if self.socket is not None:
            self.socket.close()


def _told_by_kernel() -> Any:
    if sys.platform != "linux":
        return None
    told = None
    try:
        told = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
        told.bind((0, _LINKS | _ADDRESSES))
    except OSError:
        if told is not None:
            told.close()
        return None
    told.setblocking(False)
    return told
