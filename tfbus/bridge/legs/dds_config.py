"""Cyclone DDS on this host: its configuration, and datagrams dropped for its sockets."""

import logging
import os
import re
import socket
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

from tfbus.errors import SettingsError
from tfbus.wording import listed, printable

# Cyclone refuses what Fast DDS 3 says of types, and then matches nothing of it: for these vendors
# (Connext, Fast DDS, Cyclone itself) the name of a type decides, as everywhere in ROS.
_VENDORS = "1.1,1.15,1.16"

# Messages that a reader has not confirmed are at most those of the history; more than this many
# bytes of them would make a writer wait, and all of Python with it.
_MOST_WAITING = "256 MB"

# A host, in brackets where it is an address of IPv6, and a port.
_PEER = re.compile(r"(?:udp6?/)?(?:\[([^]]*)\]|([^:]*|[^:]*:[^:]*:.*?))(?::(\d{1,5}))?")
_MOST_PORT = 65535


def configuration(
    connect: Sequence[str], log: logging.Logger, environ: Mapping[str, str] = os.environ
) -> str:
    """The configuration of Cyclone DDS, as XML.

    `connect` are names of network interfaces to use, and hosts to ask if multicast does not
    reach them. Without any, it is as ROS's variables say: ROS_LOCALHOST_ONLY,
    ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS. The settings of CYCLONEDDS_URI hold as well.

    Raises SettingsError if one of `connect` is neither; a host of ROS_STATIC_PEERS that is not
    found is left out, and logged.
    """
    here = {name for _, name in socket.if_nameindex()}
    interfaces = [each for each in connect if each in here]
    peers = [each for each in connect if each not in here]
    for each in peers:
        if mistake := _mistake_in_peer(each, environ):
            raise SettingsError(
                f"--ros-connect {printable(each, 60)!r}: {mistake}; by DDS it is a network "
                f"interface of this host ({listed(sorted(here))}), or the name or address of a "
                "host, as 192.168.1.7"
            )
    if not connect:
        peers = _static_peers(log, environ)
        if _is_local(environ):
            # ROS finds others on this host by their ports, not by multicast.
            interfaces, peers = ["127.0.0.1"], ["127.0.0.1", *peers]
    asked = _domain(_general(interfaces) + _discovery(peers))
    return ",".join(filter(None, (_ALWAYS, environ.get("CYCLONEDDS_URI", "").strip(), asked)))


def _static_peers(log: logging.Logger, environ: Mapping[str, str]) -> list[str]:
    """The hosts of ROS_STATIC_PEERS that are found."""
    found = []
    for each in filter(None, map(str.strip, environ.get("ROS_STATIC_PEERS", "").split(";"))):
        if mistake := _mistake_in_peer(each, environ):
            shown = printable(each, 60)
            log.warning("ROS_STATIC_PEERS has %r, which is left out: %s", shown, mistake)
        else:
            found.append(each)
    return found


def _mistake_in_peer(peer: str, environ: Mapping[str, str]) -> str:
    """Why Cyclone cannot use a peer, "" if it can: it would abort the process."""
    parts = _PEER.fullmatch(peer)
    if parts is None or (parts[3] and not 0 < int(parts[3]) <= _MOST_PORT):
        return f"its port is not a number from 1 to {_MOST_PORT}"
    try:
        found = socket.getaddrinfo(parts[1] or parts[2] or "", None, _family(environ))
    except (OSError, ValueError) as error:
        # ValueError: a label of more than 63 letters, for example.
        reason = error.strerror if isinstance(error, OSError) else None
        return f"no host of this name is found ({printable(reason or str(error), 80)})"
    return "" if found else "no host of this name is found"


def _family(environ: Mapping[str, str]) -> socket.AddressFamily:
    """The kind of addresses that Cyclone uses: IPv4's, unless its configuration says otherwise."""
    uri = environ.get("CYCLONEDDS_URI", "")
    if "udp6" in uri:
        return socket.AF_INET6
    # A file may say so, too.
    return socket.AF_INET if "<" in uri or not uri.strip() else socket.AF_UNSPEC


def _is_local(environ: Mapping[str, str]) -> bool:
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return reach == "LOCALHOST" or (not reach and environ.get("ROS_LOCALHOST_ONLY") == "1")


def _domain(text: str) -> str:
    return f'<CycloneDDS><Domain Id="any">{text}</Domain></CycloneDDS>' if text else ""


def _general(interfaces: Sequence[str]) -> str:
    if not interfaces:
        return ""
    listed = "".join(
        f"<NetworkInterface {'address' if each[0].isdigit() else 'name'}={quoteattr(each)}/>"
        for each in interfaces
    )
    return f"<General><Interfaces>{listed}</Interfaces></General>"


def _discovery(peers: Sequence[str]) -> str:
    if not peers:
        return ""
    listed = "".join(f"<Peer Address={quoteattr(each)}/>" for each in peers)
    # At a port that others try when they ask this host. Hosts are asked for as long as there is no
    # ROS on them: Cyclone would give up after 30 s.
    settings = (
        "<ParticipantIndex>auto</ParticipantIndex>"
        "<SPDPInterval>2 s</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
    )
    return f"<Discovery>{settings}<Peers>{listed}</Peers></Discovery>"


_ALWAYS = _domain(
    "<Compatibility>"
    f"<IgnoreTypeInformation>{_VENDORS}</IgnoreTypeInformation>"
    "</Compatibility>"
    # Without a hash of the key Fast DDS does not understand that a writer or a whole participant
    # ends: ROS would show it until its lease ends, for 10 s.
    "<Internal>"
    "<GenerateKeyhash>true</GenerateKeyhash>"
    # As much of this as the system allows (net.core.rmem_max) waits while the process gets no CPU;
    # the rest is lost where its publishers do not keep it. Only what waits takes memory.
    '<SocketReceiveBufferSize max="16 MiB"/>'
    f"<Watermarks><WhcHigh>{_MOST_WAITING}</WhcHigh></Watermarks>"
    "</Internal>"
)


_TABLES = ("/proc/self/net/udp", "/proc/self/net/udp6")
_OPEN_FILES = "/proc/self/fd"

# Columns of the tables.
_INODE, _DROPS = 9, 12


def udp_sockets() -> frozenset[str]:
    """The sockets for datagrams that this process has open, by their inodes."""
    own = set()
    with suppress(OSError):
        for name in os.listdir(_OPEN_FILES):
            with suppress(OSError):  # closed meanwhile
                own.add(os.readlink(f"{_OPEN_FILES}/{name}").removeprefix("socket:[")[:-1])
    return frozenset(own.intersection(row[_INODE] for row in _rows()))


def dropped_datagrams(sockets: frozenset[str]) -> int:
    """How many datagrams came to these sockets while so many waited that there was no room."""
    return sum(int(row[_DROPS]) for row in _rows() if row[_INODE] in sockets)


def _rows() -> Iterable[list[str]]:
    for table in _TABLES:
        with suppress(OSError):
            for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                yield line.split()
