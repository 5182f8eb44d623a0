"""The networks that robots have, and what tfbus sets for each."""

import os
import socket
from collections.abc import Iterable

from tfbus.errors import SettingsError
from tfbus.runtime import scheduler
from tfbus.runtime.structs import Struct

# As on the command line and in the environment.
AUTO = "auto"


class Network(Struct):
    """The settings for one kind of network.

    A link that is silent for `lease_s` is lost. A publisher whose link is lost is silent, and
    counts as gone `gone_after_s` later unless it is back. With `has_datagrams`, peers and routers
    have a link of UDP beside each of TCP for dynamic transforms, which are not sent again if they
    are lost. Messages of dynamic transforms, and the packets of links, have at most so many bytes
    (0: without bound); `urgent_batches` of these wait on a link. A try to open a link ends after
    `open_s`; the next one follows after `retry_s`, twice as much later, and at most `longest_s`.
    Between hosts TCP takes further bytes only while fewer than `unsent_bytes` wait in it:
    transforms come after these, and before all that waits in Zenoh. With `tcp_bytes` it has at
    most so many that have not arrived yet, repeats lost packets at a steady pace, and measures
    the bandwidth instead of taking a loss for a full link.
    """

    name: str
    lease_s: float = 1.5
    gone_after_s: float = 0.0
    has_datagrams: bool = False
    message_bytes: int = 0
    packet_bytes: int = 0
    urgent_batches: int = 8
    open_s: float = 5.0
    retry_s: float = 0.5
    longest_s: float = 1.0
    unsent_bytes: int = 32768
    tcp_bytes: int = 0

    @property
    def is_bad(self) -> bool:
        """Whether packets are often lost or late on this network."""
        return bool(self.packet_bytes)


# A packet of a mobile network or a tunnel has 1,420 bytes or more. With the headers of IP, UDP and
# Zenoh and the name of its key, a message of this size goes into one.
_PACKET = 1380
_MESSAGE = 1200

NETWORKS = {
    each.name: each
    for each in (
        Network("lan"),
        Network(
            "wifi",
            lease_s=4.0,
            gone_after_s=3.0,
            has_datagrams=True,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            urgent_batches=2,
            open_s=1.0,
            retry_s=0.25,
            # Of ten tries at a loss of 5 % one fails: two more are to come before *gone*.
            longest_s=0.5,
            tcp_bytes=24576,
        ),
        Network(
            "mobile",
            lease_s=4.0,
            gone_after_s=4.0,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            urgent_batches=1,
            open_s=2.0,
            retry_s=0.25,
            tcp_bytes=16384,
        ),
        Network(
            "satellite",
            lease_s=6.0,
            gone_after_s=6.0,
            has_datagrams=True,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            urgent_batches=1,
            open_s=2.5,
            retry_s=0.25,
            tcp_bytes=32768,
        ),
    )
}
LAN = NETWORKS["lan"]

NAMES = (*NETWORKS, AUTO)


def check_network(name: str) -> str:
    """The name of a network. Raises SettingsError for any other."""
    if name not in NAMES:
        raise SettingsError(f"network {name!r} is not one of {', '.join(NAMES)}")
    return name


def network_of(name: str, connect: Iterable[str] = ()) -> Network:
    """The network of this name; for `auto` that of the interface by which the first endpoint to
    connect to is reached, or any other host if none is given.

    Wi-Fi and mobile networks are known on Linux. A satellite is not: it is behind a cable.
    """
    if name != AUTO or scheduler.is_simulated:
        return NETWORKS.get(name, LAN)
    interface = _interface_to(next(iter(connect), ""))
    if not interface:
        return LAN
    device = f"{_DEVICES}/{interface}"
    if os.path.isdir(f"{device}/wireless") or os.path.exists(f"{device}/phy80211"):
        return NETWORKS["wifi"]
    if "DEVTYPE=wwan" in _text(f"{device}/uevent") or interface.startswith(("wwan", "ppp")):
        return NETWORKS["mobile"]
    return LAN


_DEVICES = "/sys/class/net"

# Any address that is not here: nothing is sent to it.
_ELSEWHERE = ("192.0.2.1", 9)


def _interface_to(endpoint: str) -> str:
    """The interface that leads to an endpoint, by its address of IPv4; for a name, which may take
    long to resolve, and IPv6 that of the default route. "" if it is not known.
    """
    from tfbus.bus.interfaces import interfaces  # few processes need these
    from tfbus.bus.links import split_endpoint

    _, host, port = split_endpoint(endpoint)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port) if port and _is_ipv4(host) else _ELSEWHERE)
            address = probe.getsockname()[0]
    except (OSError, OverflowError):  # no route, or no port that can be
        return ""
    return next((each.name for each in interfaces() if each.address == address), "")


def _is_ipv4(host: str) -> bool:
    try:
        socket.inet_pton(socket.AF_INET, host)
    except (OSError, ValueError):  # a name, also one that cannot be
        return False
    return True


def _text(path: str) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            return file.read()
    except OSError:
        return ""
