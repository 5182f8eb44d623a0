"""Peers that have lost their link, and whom nobody else brings together again.

Zenoh calls again whom it was told to call (`--connect`), and by multicast peers find each other.
But peers that know each other by a third are introduced by it once only: where their link breaks
while both keep theirs with the third, as on a machine or a network that was too busy for a moment,
neither calls the other again.

Here the one of the two that had called the other, and so knows where it listens, looks whether it
still does. If they do not meet it hangs up on the third. Zenoh calls that again at once, and is
told anew who is there. (Zenoh can neither call a peer nor hang up on demand; but the operating
system lets a process shut its own connections.)
"""

import json
import logging
import os
import random
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import zenoh

from tfbus.declaration import Declaration, direct
from tfbus.executor import Executor

# At random, so that not all peers hang up on one third at the same time.
_LOOK_EVERY_S = (2.0, 6.0)
# Who answers may be about to call, or to be introduced, by itself: Zenoh calls every 4 s.
_MEETS_WITHIN_S = 5.0
# So often is looked for one that does not answer: ten minutes.
_MOST_LOOKS = 150

# So often again where it did not help: each time the third is away for a moment.
_MORE_HANG_UPS = 2

_ANSWERS_WITHIN_S = 0.5

# An IP address and a port.
Address = tuple[str, int]


class LostLinks:
    """Lets the peer of a session meet again those whose link is lost."""

    def __init__(self, session: zenoh.Session, config: zenoh.Config, log: logging.Logger) -> None:
        self._session = session
        self._executor = Executor("lost links", log)
        called = json.loads(config.get_json("connect/endpoints"))
        self._thirds = called.get("peer", []) if isinstance(called, dict) else called
        self._listener = Declaration(
            session.info.declare_link_events_listener(direct(self._on_link))
        )

    def close(self) -> None:
        """Look for nobody any more. Twice is fine."""
        self._listener.close()
        self._executor.close()

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        peer, endpoint = str(event.link.zid), str(event.link.dst)
        # Without somebody to call nobody else can be asked, and Zenoh calls those by itself.
        is_lost = event.kind == zenoh.SampleKind.DELETE
        if is_lost and self._thirds and endpoint not in self._thirds:
            self._look_later(peer, endpoint, _MOST_LOOKS)

    def _look_later(self, peer: str, endpoint: str, looks: int) -> None:
        if looks:
            pause_s = random.uniform(*_LOOK_EVERY_S)
            self._executor.after(pause_s, lambda: self._look(peer, endpoint, looks - 1))

    def _look(self, peer: str, endpoint: str, looks: int) -> None:
        if self._is_linked(peer):
            return
        is_there = answers(endpoint)
        if is_there is None:
            self._look_later(peer, endpoint, looks)
        elif is_there:
            self._executor.after(_MEETS_WITHIN_S, lambda: self._meet(peer, endpoint, looks))

    def _meet(self, peer: str, endpoint: str, looks: int) -> None:
        if not self._is_linked(peer):
            if answers(endpoint):
                self._hang_up_on_the_third()
                looks = min(looks, _MORE_HANG_UPS)
            self._look_later(peer, endpoint, looks)

    def _is_linked(self, peer: str) -> bool:
        info = self._session.info
        return any(str(zid) == peer for zid in (*info.peers_zid(), *info.routers_zid()))

    def _hang_up_on_the_third(self) -> None:
        thirds = {address for endpoint in self._thirds for address in _addresses(endpoint)}
        for link in self._session.info.links():
            for address in thirds.intersection(_addresses(str(link.dst))):
                for _, port in _addresses(str(link.src)):
                    _shut(port, address)


def answers(endpoint: str) -> bool | None:
    """Whether somebody listens at a TCP endpoint; None where it cannot be reached now."""
    for address in _addresses(endpoint):
        try:
            socket.create_connection(address, _ANSWERS_WITHIN_S).close()
        except ConnectionRefusedError:
            return False
        except OSError:
            return None
        return True
    return False


def _addresses(endpoint: str) -> Iterator[Address]:
    """Where `tcp/host:port` is; nothing for another protocol, or a host that is not known."""
    protocol, _, place = endpoint.partition("/")
    host, _, port = place.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol == "tcp":
        with suppress(OSError):
            for found in socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM):
                yield _plain(found[4])


def _plain(address: tuple[object, ...]) -> Address:
    """IPv4 addresses are told as IPv6 where a socket is for both."""
    return str(address[0]).removeprefix("::ffff:"), int(str(address[1]))


def _shut(port: int, remote: Address) -> None:
    """Shut the connection of this process from a port of its own to a remote address."""
    with suppress(FileNotFoundError):  # no Linux
        for entry in filter(Path.is_socket, Path("/proc/self/fd").iterdir()):
            # Others, or ones of other families, have no such addresses.
            with (
                suppress(OSError, IndexError, ValueError),
                socket.socket(fileno=os.dup(int(entry.name))) as connection,
            ):
                own = _plain(connection.getsockname())
                if own[1] == port and _plain(connection.getpeername()) == remote:
                    connection.shutdown(socket.SHUT_RDWR)
