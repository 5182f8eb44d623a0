"""Addresses that a server of this machine listens on, and how browsers open them."""

import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import ipaddress


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
