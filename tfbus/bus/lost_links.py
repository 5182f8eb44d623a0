"""Peers that have lost their link, and whom nobody else brings together again.

Zenoh calls again whom it was told to call (`--connect`), and by multicast peers find each other.
But peers that know each other only by the one that `--connect` names are introduced by it once:
where their link breaks while both keep theirs with the named one, as on a machine or a network that
was too busy for a moment, neither calls the other again.

Here the one of the two that had called the other, and so knows where it listens, looks whether it
still does. If they do not meet it hangs up on the named one. Zenoh calls that again at once, and is
told anew who is there. (Zenoh can neither call a peer nor hang up on demand; but Linux lets a
process shut its own connections.)
"""

import errno
import json
import logging
import random
import selectors
import socket
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass

import zenoh

from tfbus.bus.own_connections import Address, can_shut, plain, shut
from tfbus.runtime.executor import Executor

# At random, so that not all peers hang up on the named one at the same time.
_LOOK_EVERY_S = (2.0, 6.0)
# Who answers may be about to call, or to be introduced, by itself: Zenoh calls every 4 s.
_MEETS_WITHIN_S = 5.0
_LOOKED_FOR_S = 600.0
_ANSWERS_WITHIN_S = 0.5
# So many are looked for at most.
_MOST_LOST = 256

# Whether somebody listens, by how a call ended; one that goes on or got nowhere says nothing.
_LISTENS = {0: True, errno.ECONNREFUSED: False}

# Each time the named one is away for a moment: so often until somebody is met, and so far apart.
_HANG_UPS = 3
_HANG_UP_EVERY_S = 10.0


@dataclass
class _Lost:
    """A peer whose link is lost."""

    peer: str
    # Who was linked when it was lost, or had been lost before it.
    known: frozenset[str]
    until: float
    answers_since: float | None = None
    hang_ups: int = 0


class LostLinks:
    """Lets the peer of a session meet again those whose link is lost."""

    def __init__(self, info: zenoh.SessionInfo, config: zenoh.Config, log: logging.Logger) -> None:
        self._info = info
        self._log = log
        self._executor = Executor("lost links", log)
        named = json.loads(config.get_json("connect/endpoints"))
        self._named: list[str] = named.get("peer", []) if isinstance(named, dict) else named
        self._lost: dict[Address, _Lost] = {}
        self._is_looking = False
        self._hang_ups_left = _HANG_UPS
        self._hung_up_at = -_HANG_UP_EVERY_S
        self._told = False

    def close(self) -> None:
        """Look for nobody any more. Twice is fine."""
        self._executor.close()

    def on_link(self, event: zenoh.LinkEvent) -> None:
        """A link has opened or closed; called on a thread of Zenoh's."""
        # Without somebody to call nobody else can be asked.
        if self._named and event.kind == zenoh.SampleKind.DELETE:
            link = event.link
            self._executor.submit("lost link", lambda: self._remember(str(link.zid), str(link.dst)))

    def _remember(self, peer: str, endpoint: str) -> None:
        lost_at = set(addresses(endpoint))
        # Zenoh calls those that are named by itself.
        if lost_at & self._named_addresses():
            return
        if not lost_at or not can_shut():
            self._tell_once(endpoint)
            return
        if not self._lost:
            self._hang_ups_left = _HANG_UPS
        known = frozenset(
            {str(link.zid) for link in self._info.links()}
            | {each.peer for each in self._lost.values()}
        )
        for address in lost_at:
            if len(self._lost) < _MOST_LOST:
                self._lost[address] = _Lost(peer, known, time.monotonic() + _LOOKED_FOR_S)
        if not self._is_looking:
            self._look_later(random.uniform(*_LOOK_EVERY_S))

    def _tell_once(self, endpoint: str) -> None:
        if not self._told:
            self._told = True
            self._log.debug(
                "Lost the link to %s; without multicast it is not looked for, as that takes TCP "
                "and Linux",
                endpoint,
            )

    def _look_later(self, pause_s: float) -> None:
        self._is_looking = bool(self._lost)
        if self._lost:
            self._executor.after(pause_s, self._look)

    def _look(self) -> None:
        self._forget_who_is_met()
        now = time.monotonic()
        answered = who_answers(self._lost, _ANSWERS_WITHIN_S)
        self._lost = {
            address: lost
            for address, lost in self._lost.items()
            # Nobody listens there any more where the call is refused.
            if answered[address] is not False and now < lost.until
        }
        is_new = False
        for address, lost in self._lost.items():
            if answered[address] is None:
                lost.answers_since = None
            elif lost.answers_since is None:
                lost.answers_since = now
                is_new = True
        if now - self._hung_up_at >= _HANG_UP_EVERY_S:
            self._meet(
                [
                    address
                    for address, lost in self._lost.items()
                    if lost.answers_since is not None
                    and now - lost.answers_since >= _MEETS_WITHIN_S
                ]
            )
        self._look_later(_MEETS_WITHIN_S if is_new else random.uniform(*_LOOK_EVERY_S))

    def _forget_who_is_met(self) -> None:
        linked = [(str(link.zid), str(link.dst)) for link in self._info.links()]
        peers = {peer for peer, _ in linked}
        # A peer that was restarted has another id.
        called = {address for _, endpoint in linked for address in addresses(endpoint)}
        met = [at for at, lost in self._lost.items() if lost.peer in peers or at in called]
        for address in met:
            del self._lost[address]
            self._hang_ups_left = _HANG_UPS

    def _meet(self, there: list[Address]) -> None:
        """Hang up once for all of them, and give up those for whom it does not help."""
        waiting = []
        for address in there:
            most = 1 if self._may_have_called(address) else _HANG_UPS
            if self._hang_ups_left and self._lost[address].hang_ups < most:
                waiting.append(address)
            else:
                del self._lost[address]
        if waiting:
            for address in waiting:
                self._lost[address].hang_ups += 1
            self._hang_ups_left -= 1
            self._hang_up()
            self._hung_up_at = time.monotonic()

    def _may_have_called(self, lost_at: Address) -> bool:
        """Whether somebody of the same host has come since.

        It may be the lost peer, restarted: where it has called us, nothing tells where it listens.
        """
        return any(
            str(link.zid) not in self._lost[lost_at].known and address[0] == lost_at[0]
            for link in self._info.links()
            for address in addresses(str(link.dst))
        )

    def _hang_up(self) -> None:
        named = self._named_addresses()
        for link in self._info.links():
            for address in named.intersection(addresses(str(link.dst))):
                for _, port in addresses(str(link.src)):
                    shut(port, address)

    def _named_addresses(self) -> set[Address]:
        return {address for endpoint in self._named for address in addresses(endpoint)}


def addresses(endpoint: str) -> Iterator[Address]:
    """Where `tcp/host:port` is; nothing for another protocol, or a host that is not known."""
    protocol, _, place = endpoint.partition("/")
    host, _, port = place.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol == "tcp":
        with suppress(OSError):
            for found in socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM):
                yield plain(found[4])


def who_answers(asked: Iterable[Address], within_s: float) -> dict[Address, bool | None]:
    """Whether somebody listens at each address; None where it cannot be reached now.

    All are called at the same time.
    """
    answered: dict[Address, bool | None] = {}
    with selectors.DefaultSelector() as calls, ExitStack() as opened:
        for address in asked:
            family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
            call = opened.enter_context(socket.socket(family, socket.SOCK_STREAM))
            call.setblocking(False)
            outcome = call.connect_ex(address)
            answered[address] = _LISTENS.get(outcome)
            if outcome == errno.EINPROGRESS:
                calls.register(call, selectors.EVENT_WRITE, (address, call))
        until = time.monotonic() + within_s
        while calls.get_map() and (left_s := until - time.monotonic()) > 0:
            for key, _ in calls.select(left_s):
                address, call = key.data
                answered[address] = _LISTENS.get(
                    call.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                )
                calls.unregister(call)
    return answered
