"""Addresses that a server of this machine listens on, and how browsers open them."""

import ipaddress
import socket


def is_local(host: str) -> bool:
    """Whether a host, a name or an address, is only this machine."""
    address = address_of(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def names_to_open(host: str) -> tuple[str, ...]:
    """What a browser opens where a server listens at `host`.

    `0.0.0.0` and `::` stand for all addresses of this machine, and no browser opens them.
    """
    address = address_of(host)
    if address is not None and address.is_unspecified:
        return ("localhost", socket.gethostname())
    return (host,)


def address_of(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The address that a text is; None where it is a name."""
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None
