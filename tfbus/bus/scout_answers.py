"""Answers the Scouts of others in Zenoh's place, by the addresses that this host has now."""

import socket
from collections.abc import Container
from contextlib import suppress

from tfbus.bus.endpoints import split_endpoint
from tfbus.bus.scouting import (
    MOST_ANSWERS_A_SECOND,
    Place,
    Scouting,
    group_at,
    leave,
    places_at_start,
    received,
)
from tfbus.bus.zenoh_sockets import ZenohSockets
from tfbus.runtime import scheduler
from tfbus.runtime.addresses import is_local
from tfbus.wire.scouting import Hello, encode_hello, is_scout_for

# From Linux's <linux/in.h>; Python has no name for it.
_HEAR_ALL_GROUPS = 49


class ScoutAnswers:
    """Answers for the session with this id, from the first `take_over` until `close()`.

    All on one thread; `socket` is readable when a Scout has come, None before.
    """

    def __init__(self, zid: str, scouting: Scouting, sockets: ZenohSockets) -> None:
        self._id = zid
        self._scouting = scouting
        self._sockets = sockets
        self._places: frozenset[Place] = frozenset()
        self._budget = (0.0, 0)
        self.socket: socket.socket | None = None

    def take_over(self, former: frozenset[Place], places: frozenset[Place]) -> None:
        """Answer Scouts from now on, at these places; Zenoh's own answers end."""
        if not self._scouting.answers:
            return
        self._places = places
        group, port = self._scouting.group
        theirs = self._sockets.answering
        if theirs is not None:
            with suppress(OSError):
                theirs.setsockopt(socket.IPPROTO_IP, _HEAR_ALL_GROUPS, 0)
            leave(theirs, group, former | places_at_start())
        if self.socket is None:
            answering = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            answering.setblocking(False)
            answering.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            answering.bind((group, port))
            self.socket = answering
        leave(self.socket, group, former)
        for place in places:
            with suppress(OSError):  # it has just gone
                at_place = group_at(group, place)
                self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, at_place)

    def answer(self, own: Container[int]) -> None:
        """Answer the Scouts that have come, but those of this session, from its `own` ports."""
        assert self.socket is not None
        for message, source in received(self.socket):
            is_own = source[1] in own and self._is_here(source[0])
            if is_scout_for(message, self._scouting.role) and not is_own:
                self._answer_to(source)

    def _answer_to(self, source: tuple[str, int]) -> None:
        second, answers = self._budget
        now_s = scheduler.monotonic() // 1
        answers = answers if now_s == second else 0
        self._budget = (now_s, answers + 1)
        if answers >= MOST_ANSWERS_A_SECOND:
            return
        # By its route this socket knows the address at which that host reaches this one.
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reply:
            reply.connect(source)
            locators = self._locators(reply.getsockname()[0])
            if locators:
                reply.send(encode_hello(Hello(self._id, self._scouting.role, locators)))

    def _locators(self, address: str) -> tuple[str, ...]:
        """The endpoints at which the session is reached by an address of this host."""
        ends = [split_endpoint(endpoint) for endpoint in self._scouting.listen]
        named = {port for *_, port in ends}
        free = [port for port in self._sockets.listening if port not in named]
        found = []
        for protocol, host, port in ends:
            if port == 0 and len(free) == 1:
                port = free[0]
            is_any = host in ("0.0.0.0", "::", "")
            if port and (is_any or not is_local(host) or is_local(address)):
                at = address if is_any else f"[{host}]" if ":" in host else host
                found.append(f"{protocol}/{at}:{port}")
        return tuple(found)

    def _is_here(self, address: str) -> bool:
        return is_local(address) or any(address == place[2] for place in self._places)

    def close(self) -> None:
        """Answer no more. Twice is fine."""
        for each in (self.socket, self._sockets.answering):
            if each is not None:
                each.close()
