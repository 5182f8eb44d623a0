"""Endpoints, and the links of a session between them: lost and half linked processes.

A process that has lost another may connect again before that one has noticed. Zenoh then adds the
new link to the other's old ones, and tells the first nothing of its declarations: the two
stay half linked for good (eclipse-zenoh/zenoh#2806).

If the last link is lost before the new one comes, Zenoh ends the connection by itself, once it
has closed the lost link. If the new one were ended before that, it would end twice, the second time
with the next connection: that one would look alive from then on, and carry nothing.
"""

import socket
from collections import deque
from typing import NamedTuple

import zenoh

from tfbus.base import scheduler
from tfbus.base.addresses import NO_HOST_NAME, is_local
from tfbus.base.structs import Struct, field

_CONNECT_WITHIN_S = 2.0


def split_endpoint(endpoint: str) -> tuple[str, str, int]:
    """The protocol, the host and the port of an endpoint such as tcp/[::]:7447#iface=eth0; 0 for
    one without a port.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    return protocol, host.strip("[]"), int(port) if port.isdigit() else 0


def host_of(endpoint: str) -> str:
    """The host of an endpoint, an address of IPv4 as such."""
    return split_endpoint(endpoint)[1].removeprefix("::ffff:")


def why_unreachable(endpoint: str) -> str:
    """Why an endpoint such as `tcp/host:7447` does not answer; "" if it does."""
    address = _address(endpoint)
    if address is None:
        return ""  # untested: tfbus does not speak its protocol
    try:
        with socket.create_connection(address, _CONNECT_WITHIN_S):
            return ""
    except UnicodeError:
        return NO_HOST_NAME
    except OSError as error:
        return error.strerror or str(error)


def speaks_tls(endpoint: str) -> bool | None:
    """Whether an endpoint encrypts, as a closed bus's does; None if it does not answer.

    For an endpoint that gives no link: it takes up to 2 s if that does not encrypt.
    """
    import ssl  # slow to import, and most processes do not need it

    address = _address(endpoint)
    if address is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with socket.create_connection(address, _CONNECT_WITHIN_S) as plain:
            try:
                with context.wrap_socket(plain):
                    return True
            except ssl.SSLError as error:
                # If it asks for a certificate at once, it has begun to encrypt.
                return "ALERT" in (error.reason or "")
            except OSError:
                return False
    except (OSError, UnicodeError):
        return None


def _address(endpoint: str) -> tuple[str, int] | None:
    """The host and port of an endpoint; None for one of another protocol, and in a simulation."""
    if scheduler.is_simulated:
        return None
    protocol, host, port = split_endpoint(endpoint)
    return (host, port) if protocol in ("tcp", "tls", "ws") and port else None


# The loss of an old link that is noticed this long after a new one has come was that of a
# connection which the other process had given up already.
_SAME_LOSS_S = 5.0


# In an endpoint of datagrams beside another one.
_BESIDE = "?rel=0"


class LinkEnds(NamedTuple):
    """A link, by its two endpoints."""

    src: str
    dst: str

    @property
    def is_of_datagrams(self) -> bool:
        """Whether it is a link of UDP beside one of TCP, as on networks that lose packets."""
        return self.src.startswith("udp/") and _BESIDE in self.src

    @property
    def is_within_host(self) -> bool:
        """Whether both ends are on this host: on loopback, or at the same address of it, as of
        peers that have met by multicast.
        """
        return is_local(host_of(self.dst)) or host_of(self.src) == host_of(self.dst)


class _Event(NamedTuple):
    zid: str
    link: LinkEnds | None  # None for the connection as a whole
    has_come: bool
    at_s: float


class _Connection(Struct, frozen=False):
    """The links to one process; all share the declarations told when the first one came. Datagrams
    carry nothing that must arrive.
    """

    links: set[LinkEnds] = field(default_factory=set)
    datagrams: set[LinkEnds] = field(default_factory=set)
    has_had_first: bool = False
    added_s: float = float("-inf")
    is_half: bool = False
    is_parted: bool = False
    began_by_datagrams: bool = False
    dst: str = ""


class LinkChanges(Struct):
    """A change of links: the last endpoints of lost processes, by their ids; the new links, the
    lost ones, all links of half linked processes, and the links of datagrams that were left of a
    process when it had no other link.
    """

    lost: dict[str, str]
    new: set[LinkEnds]
    ended: set[LinkEnds]
    half: set[LinkEnds]
    datagrams: set[LinkEnds]


class Links:
    """The peers that a session is linked to. Events come on any thread, all else on one.

    `lease_s` is the time after which a silent link is lost.
    """

    def __init__(self, lease_s: float = 0.0) -> None:
        self._same_loss_s = max(_SAME_LOSS_S, lease_s + 2.0)
        self._events: deque[_Event] = deque()
        self._connections: dict[str, _Connection] = {}
        # Since the last poll: the links that were open then, the lost ones, and of whole
        # connections.
        self._former: set[LinkEnds] = set()
        self._ended: set[LinkEnds] = set()
        self._lost: dict[str, str] = {}

    def note_transport(self, event: zenoh.TransportEvent) -> None:
        """Note that a connection opens or ends."""
        has_come = event.kind == zenoh.SampleKind.PUT
        self._events.append(_Event(str(event.transport.zid), None, has_come, scheduler.monotonic()))

    def note_link(self, event: zenoh.LinkEvent) -> None:
        """Note that a link opens or ends."""
        link, has_come = event.link, event.kind == zenoh.SampleKind.PUT
        ends = LinkEnds(link.src, link.dst)
        self._events.append(_Event(str(link.zid), ends, has_come, scheduler.monotonic()))

    def end_history(self) -> None:
        """Take all that was noted so far as there before, in no order."""
        events = sorted(
            self._events, key=lambda each: bool(each.link and each.link.is_of_datagrams)
        )
        self._events = deque(events)

    def __contains__(self, zid: str) -> bool:
        return zid in self._connections

    def __bool__(self) -> bool:
        return bool(self._connections)

    def hosts_for_datagrams(self) -> tuple[set[str], set[str]]:
        """The hosts of processes that have told all that they have declared, or are about to, on
        another link: datagrams may be added to it. And the hosts of processes that have begun by
        datagrams, of which nothing more is taken than their end.
        """
        self._apply_events()
        each_of = self._connections.values()
        whole = [each for each in each_of if each.has_had_first and not each.began_by_datagrams]
        ending = [link for each in each_of if each.began_by_datagrams for link in each.datagrams]
        hosts = {host_of(each.dst) for each in whole}
        return hosts, {host_of(link.dst) for link in ending} - hosts

    def all(self) -> set[LinkEnds]:
        """The links that are open."""
        return {link for each in self._connections.values() for link in each.links}

    def beside(self, links: set[LinkEnds]) -> set[LinkEnds]:
        """All links of the connections that have one of these."""
        each_of = self._connections.values()
        return {link for each in each_of if each.links & links for link in each.links}

    def keep_only(self, zids: set[str]) -> None:
        """Forget connections other than Zenoh's, which have these ids."""
        for zid in self._connections.keys() - zids:
            del self._connections[zid]

    def poll(self) -> LinkChanges:
        """The changes since the last call."""
        self._apply_events()
        lost, self._lost = self._lost, {}
        ended, self._ended = self._ended, set()
        former, self._former = self._former, self.all()
        half: set[LinkEnds] = set()
        left: set[LinkEnds] = set()
        for each in self._connections.values():
            if each.is_half:
                half |= each.links
                each.is_half = False
            if each.is_parted:
                left |= each.datagrams
                half |= each.links
        return LinkChanges(lost, self._former - former, ended, half, left)

    def _apply_events(self) -> None:
        while self._events:
            self._apply(self._events.popleft())

    def _apply(self, event: _Event) -> None:
        zid, link, has_come, at_s = event
        if link is None and has_come:
            self._connections.setdefault(zid, _Connection())
            self._lost.pop(zid, None)
        elif link is None:
            connection = self._connections.pop(zid, None)
            if connection is not None:
                self._lost[zid] = connection.dst
        elif (connection := self._connections.get(zid)) is None:
            pass  # it has ended: events of links may come after that of their connection
        elif link.is_of_datagrams:
            (connection.datagrams.add if has_come else connection.datagrams.discard)(link)
            if not connection.has_had_first:
                # Zenoh has told the far end of its declarations by them, or the part that arrived.
                connection.is_parted = connection.began_by_datagrams = True
        elif has_come:
            connection.links.add(link)
            connection.dst = link.dst
            if connection.has_had_first:
                connection.added_s = at_s
            connection.has_had_first = True
        else:
            self._ended.add(link)
            connection.links.discard(link)
            # For good: messages under way are lost, and a new link brings them no more.
            connection.is_parted |= bool(connection.datagrams) and not connection.links
            connection.is_half |= (
                bool(connection.links) and at_s - connection.added_s < self._same_loss_s
            )
