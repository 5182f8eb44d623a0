"""Scouting on the networks of now, in Zenoh's place: sockets, addresses, questions, answers, bytes.

The answers to our own Scouts are handed to Zenoh, which connects to their senders.
"""

import socket
import struct
from collections.abc import Container, Iterable
from contextlib import suppress
from functools import cache

import zenoh

from tfbus.base import scheduler
from tfbus.base.addresses import Interface, is_local, scouted
from tfbus.base.bounded import Bounded
from tfbus.base.structs import Struct, replace
from tfbus.bus.links import Links, host_of, split_endpoint
from tfbus.bus.zenoh_sockets import SocketMarks, ZenohSockets

_VERSION = 9
_SCOUT = 0x01
_HELLO = 0x02
_KIND = 0x1F
_HAS_LOCATORS = 0x20

# As Hello numbers them; Scout has a bit for each.
_ROLES = ("router", "peer", "client")
_ROUTERS_AND_PEERS = 0b011

# A host has a few addresses; any host of the network can send more.
_MOST_LOCATORS = 64

LARGEST = 8192


class Hello(Struct):
    """The id, the role ("router", "peer", "client") and the locators of a session."""

    zid: str
    role: str
    locators: tuple[str, ...]


def encode_scout() -> bytes:
    """The message that looks for peers and routers."""
    return bytes((_SCOUT, _VERSION, _ROUTERS_AND_PEERS))


def is_scout_for(message: bytes, role: str) -> bool:
    """Whether a message looks for sessions of a role."""
    is_scout = len(message) >= 3 and message[0] & _KIND == _SCOUT and message[1] == _VERSION
    return is_scout and bool(message[2] >> _ROLES.index(role) & 1)


def encode_hello(hello: Hello) -> bytes:
    """The answer of a session to a Scout."""
    digits = hello.zid if len(hello.zid) % 2 == 0 else f"0{hello.zid}"
    zid = bytes.fromhex(digits)[::-1]
    header = _HELLO | (_HAS_LOCATORS if hello.locators else 0)
    parts = [bytes((header, _VERSION, (len(zid) - 1) << 4 | _ROLES.index(hello.role))), zid]
    if hello.locators:
        parts.append(_length(len(hello.locators)))
    for locator in hello.locators:
        text = locator.encode()
        parts += (_length(len(text)), text)
    return b"".join(parts)


def decode_hello(message: bytes) -> Hello | None:
    """The Hello in a message; None for any other message, or one that is damaged."""
    try:
        if message[0] & _KIND != _HELLO or message[1] != _VERSION:
            return None
        role, at = _ROLES[message[2] & 0b11], 4 + (message[2] >> 4)
        zid = message[3:at][::-1].hex().lstrip("0")
        if len(message) < at or not zid:
            return None
        locators = _locators(message, at) if message[0] & _HAS_LOCATORS else ()
    except (IndexError, UnicodeDecodeError):
        return None
    return Hello(zid, role, locators)


def _locators(message: bytes, at: int) -> tuple[str, ...]:
    count, at = _read_length(message, at)
    found = []
    for _ in range(min(count, _MOST_LOCATORS)):
        size, at = _read_length(message, at)
        if at + size > len(message):
            raise IndexError
        found.append(message[at : at + size].decode())
        at += size
    return tuple(found)


def _length(number: int) -> bytes:
    """A number as Zenoh writes lengths: seven bits a byte, the lowest first."""
    encoded = bytearray()
    while number > 0x7F:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    encoded.append(number)
    return bytes(encoded)


def _read_length(message: bytes, at: int) -> tuple[int, int]:
    """A length, and the position behind it."""
    number = shift = 0
    while True:
        byte = message[at]
        number |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return number, at
        if shift > 28:
            raise IndexError


# Anyone can send a Scout.
MOST_ANSWERS_A_SECOND = 200


class Scouting(Struct):
    """How a session takes part in scouting.

    `role` is "peer" or "router"; `listen` are its endpoints. `only` are the interfaces that its
    configuration names, () for all.
    """

    role: str
    listen: tuple[str, ...]
    group: tuple[str, int]
    ttl: int
    only: tuple[str, ...] = ()
    answers: bool = True
    connects: bool = True

    def marks(self) -> SocketMarks:
        """The marks of the sockets of such a session."""
        ends = [split_endpoint(endpoint) for endpoint in self.listen]
        hosts = {address for _, host, port in ends if port == 0 for address in _addresses(host)}
        return SocketMarks(hosts, self.group, self.ttl, len(self.only or places(())))


Place = tuple[int, str, str]  # the number, name and address of an interface


@cache
def places_at_start() -> frozenset[Place]:
    """The places as they were when this was called first: Zenoh stays at them."""
    return places(())


def places(only: tuple[str, ...]) -> frozenset[Place]:
    """The places to scout on now; `only` are the interfaces to which that is restricted."""
    return frozenset(
        (each.number, each.name, each.address) for each in scouted() if _is_among(each, only)
    )


def _is_among(interface: Interface, only: tuple[str, ...]) -> bool:
    return not only or interface.name in only or interface.address in only


def received(from_socket: socket.socket) -> Iterable[tuple[bytes, tuple[str, int]]]:
    """The news that have come by now, at most as many as one turn of the thread takes."""
    for _ in range(MOST_ANSWERS_A_SECOND):
        try:
            yield from_socket.recvfrom(LARGEST)
        except BlockingIOError:
            return
        except OSError:
            continue  # an earlier message had no receiver


def leave(one: socket.socket, group: str, places: Iterable[Place]) -> None:
    """Let a socket leave a group at these places."""
    for place in places:
        with suppress(OSError):  # the interface has gone, or it was not on it
            one.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, group_at(group, place))


def group_at(group: str, place: Place) -> bytes:
    """A group at a place, as options of sockets have it."""
    # By number: another interface may have the address next.
    return struct.pack("4s4si", socket.inet_aton(group), bytes(4), place[0])


def _addresses(host: str) -> set[str]:
    host = host or "::"
    # As bytes, since of a text Python loads the tables of international names first: a millisecond
    # and 0.3 MB of each process that has a node.
    name = host.encode() if host.isascii() else host
    with suppress(OSError, UnicodeError):
        return {str(found[4][0]) for found in socket.getaddrinfo(name, None)}
    return set()


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
        # By id, when a lost process was lost.
        self._lost_s: dict[str, float] = {}
        self._asking: dict[Place, socket.socket] = {}
        self._waiting: Bounded[str, float] = Bounded(_MOST_WAITING)
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
        """Note the ids of lost processes, and forget the ones that are linked again."""
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
        """Scout once at these places, and say when next: `for_good` if Zenoh does not scout
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
        """Let Zenoh connect to the processes whose answers have come on one of the sockets."""
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
        message = encode_hello(replace(hello, locators=locators))
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
        now_s = scheduler.monotonic()
        return now_s - self._waiting.setdefault(hello.zid, now_s) >= _POLITE_S

    def close(self) -> None:
        """Scout no more. Twice is fine."""
        self._ask_on(frozenset())


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
        """Answer the Scouts that have come, but for this session's, from its `own` ports."""
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
