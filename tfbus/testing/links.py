"""Paths between hosts, the lanes of links over them, and the ends of these.

On a link of TCP nothing is lost or overtakes: a lost packet delays all behind it. On one of UDP a
lost packet is lost, and Zenoh drops one that another has overtaken.
"""

import heapq
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from tfbus.testing.declarations import KINDS, QUERYABLE, Keys
from tfbus.testing.tasks import Tasks

if TYPE_CHECKING:
    from tfbus.testing.processes import Host
    from tfbus.testing.queries import Asked
    from tfbus.testing.zenoh_session import ZenohSession

# As tfbus sets it.
LEASE_S = 1.5

# Linux repeats a packet a round trip after it was lost, once three later ones have arrived; without
# these after a time of its own, twice as long for each further loss.
_LATER_ONES = 3
_RESEND_AFTER_S = 0.2
_LONGEST_RESEND_S = 60.0

# A queue of Zenoh's holds this much of urgent messages, and of others, before it drops them.
_URGENT_BYTES = 8 * 65536
_OTHER_BYTES = 2 * 65536

# On a bad network it holds so much of others; a message of more bytes than a packet is dropped if
# it has not all found room after this time, and what the link has carried of it is lost.
PACKET_BYTES = 1380
_FRAGMENTS_BYTES = 16 * PACKET_BYTES
_FRAGMENTS_WAIT_S = 0.05


@dataclass
class LinkPath:
    """The way from one host to another, in one direction.

    Seconds, bytes a second (0: without bound), and the shares of packets that are lost, and that
    take twice as long, so that others overtake them. `is_up` is whether anything arrives,
    `multicast` whether peers find each other by it.
    """

    delay_s: float = 0.0002
    jitter_s: float = 0.0001
    loss: float = 0.0
    reordering: float = 0.0
    bytes_a_second: float = 0.0
    multicast: bool = True
    is_up: bool = True
    changed_ns: int = 0

    def delays_s(self, chance: Callable[[], float]) -> tuple[float, float]:
        """How long one packet takes, and how much longer if others overtake it."""
        is_late = self.reordering and chance() < self.reordering
        more_s = self.delay_s + self.jitter_s if is_late else 0.0
        return self.delay_s + self.jitter_s * chance(), more_s


class Paths:
    """The paths between all hosts."""

    def __init__(self) -> None:
        self._paths: dict[tuple[Host, Host], LinkPath] = {}

    def between(self, one: "Host", other: "Host") -> LinkPath:
        """The path from one host to another, or to itself."""
        path = self._paths.get((one, other))
        if path is None:
            path = LinkPath(0.00005, 0.00005) if one is other else LinkPath()
            self._paths[one, other] = path
        return path

    def both_ways(self, one: "Host", other: "Host") -> Iterator[LinkPath]:
        """The path from one host to another, and the path back."""
        yield self.between(one, other)
        yield self.between(other, one)


class _Packet(NamedTuple):
    """A call on its way; calls of the lowest rank go first, then in the order of `place`."""

    rank: int
    place: int
    call: Callable[[], object]
    size: int


class LinkLane:
    """A direction of a link: calls that arrive at its far end, all of them if it `is_reliable`.

    They arrive in their order, but urgent ones, of rank 0, overtake others of a higher rank that
    wait for the bandwidth.
    """

    def __init__(self, tasks: Tasks, path: LinkPath, *, is_reliable: bool = True) -> None:
        self._tasks = tasks
        self.path = path
        self.is_reliable = is_reliable
        self.is_open = True
        self._places = itertools.count(1)
        # Packets that wait for the bandwidth, a heap.
        self._waiting: list[_Packet] = []
        self._is_sending = False
        # Packets that wait for the path to be up, or for one before them, by their numbers.
        self._held: dict[int, _Packet] = {}
        self._numbers = itertools.count(1)
        # When the last packet left, and the mean time between two.
        self._left_ns, self._gap_s = 0, _RESEND_AFTER_S
        # The number of the last packet that has arrived, and when the last one that left is due.
        self._arrived = self.due_ns = 0

    def busy_s(self) -> float:
        """How long all that is under way still takes to arrive."""
        return self._waits_s() + self._repeats_s()

    def lost_after_s(self) -> float:
        """How long the far end still takes to notice that nothing more is sent: the lease, once all
        has arrived, or has been repeated for as long.
        """
        return self._waits_s() + min(self._repeats_s(), LEASE_S) + LEASE_S

    def _waits_s(self) -> float:
        rate = self.path.bytes_a_second
        return sum(packet.size for packet in self._waiting) / rate if rate else 0.0

    def _repeats_s(self) -> float:
        return max(0, self.due_ns - self._tasks.now_ns) / 1e9

    def has_room(self, rank: int) -> bool:
        """Whether a message that may be dropped is sent."""
        return self._backlog(rank) < (_OTHER_BYTES if rank else _URGENT_BYTES)

    def bytes_carried(self, size: int, rank: int) -> int:
        """How much of a message in fragments is carried, on a bad network, before it is dropped:
        all of it is if the others of its rank leave it room in time.
        """
        room = _FRAGMENTS_BYTES - self._backlog(rank)
        rate = self.path.bytes_a_second
        return max(0, min(size, room + round(_FRAGMENTS_WAIT_S * rate))) if rate else size

    def _backlog(self, rank: int) -> int:
        """The bytes that wait and are as urgent as messages of a rank, or as little."""
        waiting = itertools.chain(self._waiting, self._held.values())
        return sum(packet.size for packet in waiting if bool(packet.rank) is bool(rank))

    def send(self, call: Callable[[], object], size: int = 100, *, rank: int = 0) -> None:
        """Make a call at the far end, once it has arrived there."""
        packet = _Packet(rank, next(self._places), call, size)
        if self.path.bytes_a_second or self._waiting:
            heapq.heappush(self._waiting, packet)
            self._send_next()
        else:
            self._launch(next(self._numbers), packet)

    def release(self) -> None:
        """The path is up again: all that waits is sent anew, after TCP's pause."""
        held, self._held = sorted(self._held.items()), {}
        down_s = (self._tasks.now_ns - self.path.changed_ns) / 1e9
        pause_s = self._tasks.random.uniform(0, min(down_s, 2 * LEASE_S))
        for number, packet in held:
            self._launch(number, packet, pause_s)

    def _send_next(self) -> None:
        """Send the first waiting packet, unless another one is leaving."""
        if self._is_sending or not self._waiting:
            return
        packet = heapq.heappop(self._waiting)
        rate = self.path.bytes_a_second
        self._is_sending = True

        def has_left() -> None:
            self._is_sending = False
            self._launch(next(self._numbers), packet)
            self._send_next()

        self._tasks.call_after(packet.size / rate if rate else 0.0, has_left)

    def _launch(self, number: int, packet: _Packet, pause_s: float = 0.0) -> None:
        """Bring a packet to the far end: after TCP has repeated it, or not at all."""
        tasks, path = self._tasks, self.path
        chance = tasks.random.random
        if self.is_reliable and not path.is_up:
            self._held[number] = packet
            return
        delay_s, more_s = path.delays_s(chance)
        if self.is_reliable:
            delay_s += pause_s + more_s + self._resends_s()
        elif path.loss and chance() < path.loss:
            return
        # Jitter alone changes no order: packets of one way wait in one queue.
        self.due_ns = max(self.due_ns + 1, tasks.now_ns + round(delay_s * 1e9))
        late_ns = 0 if self.is_reliable else round(more_s * 1e9)
        arrive = self._arrive if self.is_reliable else self._arrive_once
        tasks.call_at(self.due_ns + late_ns, lambda: arrive(number, packet))

    def _resends_s(self) -> float:
        """How long TCP takes to repeat a packet until it gets through."""
        path, now_ns = self.path, self._tasks.now_ns
        gap_s, self._left_ns = (now_ns - self._left_ns) / 1e9, now_ns
        self._gap_s += (min(gap_s, _RESEND_AFTER_S) - self._gap_s) / 8
        by_later_s = _LATER_ONES * self._gap_s
        late_s, resend_s = 0.0, min(by_later_s, _RESEND_AFTER_S)
        while path.loss and self._tasks.random.random() < path.loss:
            late_s += 2 * (path.delay_s + path.jitter_s) + resend_s
            if by_later_s >= _RESEND_AFTER_S:
                resend_s = min(2 * resend_s, _LONGEST_RESEND_S)
        return late_s

    def _arrive(self, number: int, packet: _Packet) -> None:
        """A packet that is lost on its way is sent again, and all that was sent after it waits."""
        self._held[number] = packet
        while self.is_open and self.path.is_up and self._arrived + 1 in self._held:
            self._arrived += 1
            self._held.pop(self._arrived).call()

    def _arrive_once(self, number: int, packet: _Packet) -> None:
        if self.is_open and self.path.is_up and number > self._arrived:
            self._arrived = number
            packet.call()


_numbers = itertools.count()


class Face:
    """The end of a link in one session."""

    def __init__(self, session: "ZenohSession", lane: LinkLane) -> None:
        self.session = session
        self.lane = lane
        # Later ones have larger numbers.
        self.number = next(_numbers)
        self.far: Face
        self.is_open = True
        # Whether it reads nothing of what comes.
        self.is_deaf = False
        self._has_lost = False
        # Declarations of the far end, by kind.
        self.declared = {kind: Keys() for kind in KINDS}
        # How often the far end was told of a declaration, by kind and key.
        self._told: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        # The queries that went out by it and have not ended.
        self.asked: dict[int, Asked] = {}

    @property
    def far_session(self) -> "ZenohSession":
        """The session at its far end."""
        return self.far.session

    def wants(self, kind: str, key: str) -> bool:
        """Whether the far end has declared something of this kind that a key meets."""
        return self.declared[kind].meets(key)

    def continue_of(self, former: "Face") -> None:
        """Take over all that a former end knew and told: a link was added to it."""
        self.declared, self._told, self.asked = former.declared, former._told, former.asked
        self.session.declarations.move(former, self)

    def send(self, call: Callable[["Face"], object], size: int = 100, *, rank: int = 0) -> None:
        """Make `call(far end)` there, in the order of the calls of its rank."""
        far = self.far

        def arrive() -> None:
            if far.is_open and not far.is_deaf:
                call(far)

        self.lane.send(lambda: far.session.process.receive(arrive), size, rank=rank)

    def tell(self, kind: str, key: str, change: int) -> None:
        """Count a declaration more, or less: the far end hears of the first and of the last."""
        if self._is_news(kind, key, change):
            self._send_news([(kind, key)], change > 0)

    def tell_all(self, declared: Iterable[tuple[str, str, int]]) -> None:
        """Tell of all that is declared on a new link, and how often. It goes out in two messages,
        so that the far end may have done something after any of it, and before the next.
        """
        news = [(kind, key) for kind, key, count in declared if self._is_news(kind, key, count)]
        cut = int(self.session.tasks.random.random() * (len(news) + 1))
        for part in (news[:cut], news[cut:]):
            if part:
                self._send_news(part, True)

    def _is_news(self, kind: str, key: str, change: int) -> bool:
        """Count a declaration more, or less; whether the far end has to hear of it."""
        told = self._told[kind]
        former = told[key]
        told[key] += change
        if told[key] == 0:
            del told[key]
        if former == 0:
            if kind == QUERYABLE and not self._has_lost and self.session.fabric.loses_declaration():
                # More than one of a link was never seen to be lost.
                self._has_lost = True
                return False
            return True
        return key not in told

    def _send_news(self, news: list[tuple[str, str]], is_new: bool) -> None:
        def hear(far: "Face") -> None:
            for kind, key in news:
                far.session.declarations.hear(far, kind, key, is_new)

        self.send(hear, 100 * len(news))


_ENDPOINT = re.compile(r"(?P<protocol>[\w-]+)/\[?(?P<host>[^\]#?]*?)\]?(:(?P<port>\d+))?([#?].*)?")
_ROUTER_PORT = "7447"
_LOOPBACK = re.compile(r"localhost|127\..*|::1")
_ANY = ("::", "0.0.0.0")


class Meeting:
    """Says how two sessions find each other, on the paths of a network.

    A peer links to all peers and routers that it finds, a client to one router at a time, or to
    another client that listens (`tfbus router --hub`), a router to the endpoints in `connect`. A
    peer finds others by multicast, or introduced by a session that both have a link to; each
    introduces two others once. Links to clients of peers are not simulated.
    """

    def __init__(self, paths: "Paths") -> None:
        self._paths = paths
        # The number of the last connection of two: a session that both knew before introduces them
        # no more.
        self._met: dict[tuple[object, object], int] = {}

    def protocol(self, one: "ZenohSession", other: "ZenohSession") -> str:
        """The protocol of the link that two sessions make; "" if neither looks for the other."""
        if "client" in (one.mode, other.mode):
            return self._of_client(one, other) or self._of_client(other, one)
        named = _named(one, other) or _named(other, one)
        if named:
            return named
        is_found = "peer" in (one.mode, other.mode) and (
            self._is_multicast(one, other) or self._introduces(one, other)
        )
        return (_found_at(other, one) or _found_at(one, other)) if is_found else ""

    def _of_client(self, client: "ZenohSession", other: "ZenohSession") -> str:
        if client.mode != "client" or self.has_router(client):
            return ""
        if client.connect:
            takes_clients = other.mode == "router" or (other.mode == "client" and other.listen)
            return _named(client, other) if takes_clients else ""
        is_found = other.mode == "router" and self._is_multicast(client, other)
        return _found_at(other, client) if is_found else ""

    def has_router(self, client: "ZenohSession") -> bool:
        """Whether a client has a link beside those of its own clients, if it listens for some."""
        return any(not client.listen or bool(_named(client, far)) for far in client.faces)

    def _is_multicast(self, one: "ZenohSession", other: "ZenohSession") -> bool:
        paths = self._paths.both_ways(one.process.host, other.process.host)
        return all(path.multicast for path in paths)

    def _introduces(self, one: "ZenohSession", other: "ZenohSession") -> bool:
        """Whether a third session that both have a link to introduces them now."""
        met = self._met.get(_pair(one, other), -1)
        return any(
            one.faces[third].number > met or other.faces[third].number > met
            for third in _between(one, other)
        )

    def note_link(self, one: "ZenohSession", other: "ZenohSession") -> None:
        """Two sessions have a link: nobody introduces them again."""
        self._met[_pair(one, other)] = max(one.faces[other].number, other.faces[one].number)


def _pair(one: "ZenohSession", other: "ZenohSession") -> "tuple[ZenohSession, ZenohSession]":
    return (one, other) if one.zid_text > other.zid_text else (other, one)


def _between(one: "ZenohSession", other: "ZenohSession") -> "list[ZenohSession]":
    return [far for far in one.faces if far in other.faces and far.mode != "client"]


def _named(one: "ZenohSession", other: "ZenohSession") -> str:
    """The protocol by which `connect` of one session names the other; "" if it does not."""
    for endpoint in one.connect:
        found = _ENDPOINT.fullmatch(endpoint)
        if found and _is_at(found["host"], one.process.host, other.process.host):
            for protocol, host, port in _listens(other):
                is_heard = _is_heard(host, one, other)
                if (protocol, port) == (found["protocol"], found["port"]) and is_heard:
                    return protocol
    return ""


def _found_at(other: "ZenohSession", one: "ZenohSession") -> str:
    """The protocol by which a session reaches another that told it where it listens."""
    for protocol, host, _ in _listens(other):
        if _is_heard(host, one, other):
            return protocol
    return ""


def _listens(session: "ZenohSession") -> list[tuple[str, str, str | None]]:
    """The protocol, host and port of each endpoint that a session listens on."""
    given = session.listen or (f"tcp/[::]:{_ROUTER_PORT if session.mode == 'router' else 0}",)
    return _places(given)


@lru_cache(maxsize=1000)
def _places(endpoints: tuple[str, ...]) -> list[tuple[str, str, str | None]]:
    found = [_ENDPOINT.fullmatch(endpoint) for endpoint in endpoints]
    return [(each["protocol"], each["host"], each["port"]) for each in found if each]


def foreign_place(session: "ZenohSession") -> str:
    """The endpoint that a session cannot listen on, since the address is not its host's; or ""."""
    host = session.process.host
    for endpoint in session.listen:
        found = _ENDPOINT.fullmatch(endpoint)
        if found and found["host"] and not _is_at(found["host"], host, host):
            return endpoint
    return ""


def _is_heard(listens_at: str, one: "ZenohSession", other: "ZenohSession") -> bool:
    """Whether a session is on a host that reaches the address at which another listens."""
    return one.process.host is other.process.host or not _LOOPBACK.fullmatch(listens_at)


def _is_at(name: str, here: "Host", there: "Host") -> bool:
    """Whether a name or address is a host's, as another one resolves it."""
    if _LOOPBACK.fullmatch(name) or name in _ANY:
        return here is there
    return name in (there.name, there.address)
