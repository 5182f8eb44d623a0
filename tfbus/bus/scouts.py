"""Scouts on the networks of now, and hands the answers to Zenoh, which connects to who answered."""

import socket
from collections.abc import Iterable
from contextlib import suppress

import zenoh

from tfbus.bus.endpoints import host_of
from tfbus.bus.links import Links
from tfbus.bus.scouting import Place, Scouting, group_at, received
from tfbus.bus.zenoh_sockets import ZenohSockets
from tfbus.runtime import scheduler
from tfbus.wire.scouting import Hello, decode_hello, encode_hello, encode_scout

# The pauses between Scouts after a change, or after a host was lost: some networks carry nothing in
# their first second. The last one repeats while a neighbour may come back soon. After that Zenoh's
# own Scouts do, where it scouts on the networks of now, or as rare ones.
_PAUSES_S = (0.0, 0.25, 0.5, 0.5, 0.5, 0.75, 1.5, 3.0)
_BACK_WITHIN_S = 300.0
_LATER_S = 8.0

# Of two peers the one with the greater id connects at once, the other after this time.
_POLITE_S = 0.6

# One that was lost is connected to after this part of the lease at the earliest: it notices the
# loss within the time between two keep-alives, which is a quarter.
_APART = 2 / 3

_MOST_WAITING = 1000


class Scouts:
    """Scouts for a session, from `begin` until no neighbour may come back soon, or `close()`.

    All on one thread; `sockets` are readable when answers have come, and `next_s` is the time of
    the next Scout, None without one. `lease_s` is the time after which a silent link is lost.
    """

    def __init__(
        self,
        session: zenoh.Session,
        scouting: Scouting,
        sockets: ZenohSockets,
        links: Links,
        lease_s: float,
    ) -> None:
        self._info = session.info
        self._id = str(session.zid())
        self._scouting = scouting
        self._zenoh = sockets
        self._links = links
        self._apart_s = _APART * lease_s
        # When each of those that are lost was lost.
        self._lost_s: dict[str, float] = {}
        self._asking: dict[Place, socket.socket] = {}
        self._waiting: dict[str, float] = {}
        self._turn = 0
        self._missed_s = 0.0
        self.next_s: float | None = None

    @property
    def sockets(self) -> Iterable[socket.socket]:
        """The sockets to which answers come."""
        return self._asking.values()

    def own_ports(self) -> set[int]:
        """The ports that the Scouts of this session come from, Zenoh's own too."""
        return {each.getsockname()[1] for each in self._asking.values()} | {*self._zenoh.asking}

    def note_lost(self, lost: Iterable[str]) -> None:
        """Note the ids of those that are lost, and forget those that are linked again."""
        now_s = scheduler.monotonic()
        for zid in [zid for zid in self._waiting if zid in self._links]:
            del self._waiting[zid]
        self._lost_s = {
            zid: at_s for zid, at_s in self._lost_s.items() if now_s - at_s < self._apart_s
        } | dict.fromkeys(lost, now_s)

    def begin(self) -> None:
        """Scout from now on, soon and then again and again."""
        if not self._scouting.connects or not self._zenoh.asking:
            return
        self._missed_s = scheduler.monotonic()
        self._turn = 0
        self.next_s = self._missed_s

    def is_due(self) -> bool:
        """Whether it is time to scout."""
        return self.next_s is not None and scheduler.monotonic() >= self.next_s

    def scout(self, places: frozenset[Place], *, for_good: bool) -> None:
        """Scout once at these places, and say when next: `for_good` where Zenoh does not scout
        on these itself.
        """
        self._links.keep_only(
            {str(zid) for zid in (*self._info.peers_zid(), *self._info.routers_zid())}
        )
        self._ask_on(places)
        for asking in self._asking.values():
            with suppress(OSError):  # no route yet: again after the next pause
                asking.sendto(encode_scout(), self._scouting.group)
        self._turn += 1
        now_s = scheduler.monotonic()
        pause_s = _PAUSES_S[min(self._turn, len(_PAUSES_S) - 1)]
        if now_s - self._missed_s <= _BACK_WITHIN_S:
            self.next_s = now_s + pause_s
        elif for_good:
            self.next_s = now_s + _LATER_S
        else:
            # Zenoh scouts on these networks itself.
            self.next_s = None
            self._ask_on(frozenset())

    def _ask_on(self, places: frozenset[Place]) -> None:
        """Have a socket to scout with at each of the places, and no others."""
        for place in self._asking.keys() - places:
            self._asking.pop(place).close()
        for place in places - self._asking.keys():
            with suppress(OSError):  # the interface has just gone
                self._asking[place] = self._asking_at(place)

    def _asking_at(self, place: Place) -> socket.socket:
        asking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            asking.setblocking(False)
            interface = group_at(self._scouting.group[0], place)
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._scouting.ttl)
            asking.bind(("", 0))
        except OSError:
            asking.close()
            raise
        return asking

    def take_hellos(self, asking: socket.socket) -> None:
        """Let Zenoh connect to those whose answers have come on one of the sockets."""
        for message, (host, _) in received(asking):
            hello = decode_hello(message)
            if hello is not None and hello.role != "client" and hello.zid != self._id:
                self._meet(hello, host)

    def _meet(self, hello: Hello, host: str) -> None:
        """Let Zenoh connect to one that has answered."""
        if hello.zid in self._links or not self._is_turn(hello):
            return
        # The first address of several may be one that is not reached from here, and Zenoh would
        # try it for 10 s.
        at_host = tuple(each for each in hello.locators if host_of(each) == host)
        if not (locators := at_host or hello.locators):
            return
        message = encode_hello(hello._replace(locators=locators))
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as to_zenoh:
            to_zenoh.sendto(message, ("127.0.0.1", self._zenoh.asking[0]))

    def _is_turn(self, hello: Hello) -> bool:
        """Whether to connect now, and not while the other one connects, or has not noticed that
        the last link is lost: the two would be half linked.
        """
        if hello.zid in self._lost_s:
            return scheduler.monotonic() - self._lost_s[hello.zid] >= self._apart_s
        if hello.role == "router" or int(self._id, 16) > int(hello.zid, 16):
            return True
        if len(self._waiting) >= _MOST_WAITING:
            self._waiting.clear()
        now_s = scheduler.monotonic()
        return now_s - self._waiting.setdefault(hello.zid, now_s) >= _POLITE_S

    def close(self) -> None:
        """Scout no more. Twice is fine."""
        self._ask_on(frozenset())
