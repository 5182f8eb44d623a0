"""Meets the neighbours again after the network of this host has changed.

Zenoh looks at the interfaces once in a process. A network that comes later it neither scouts on nor
answers on, and its answers name the addresses of the start. So from the first change on tfbus
answers in its place, by the addresses of now, and Zenoh's own answers end. And tfbus scouts on the
networks of now, and hands each answer to the socket to which the answers to Zenoh's own Scouts
come: Zenoh connects then as to any neighbour. The session stays as it is, with all that it has
declared.
"""

import errno
import logging
import select
import socket
import struct
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from typing import Any, NamedTuple

import zenoh

from tfbus.bus.callbacks import direct
from tfbus.bus.handles import Declaration
from tfbus.bus.interfaces import Interface, scouted
from tfbus.bus.links import Link, Links
from tfbus.bus.network_watch import NetworkWatch
from tfbus.bus.zenoh_sockets import Ends, ZenohSockets, end_links, shorten_close
from tfbus.runtime import scheduler
from tfbus.runtime.addresses import is_local
from tfbus.wire.scouting import (
    LARGEST,
    Hello,
    decode_hello,
    encode_hello,
    encode_scout,
    is_scout_for,
)
from tfbus.wording import listed

# From Linux's <linux/in.h>; Python has no name for it.
_HEAR_ALL_GROUPS = 49

# Changes come in groups: an interface, its carrier, its addresses.
_SETTLED_S = 0.05

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

# Anyone can send a Scout.
_MOST_ANSWERS_A_SECOND = 200
_MOST_WAITING = 1000

_CLOSING_S = 2.0


class Scouting(NamedTuple):
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


Place = tuple[int, str, str]  # the number, name and address of an interface


@cache
def places_at_start() -> frozenset[Place]:
    """The places as they were when this was called first: Zenoh stays at them."""
    return _places(())


def _places(only: tuple[str, ...]) -> frozenset[Place]:
    return frozenset(
        (each.number, each.name, each.address) for each in scouted() if _is_among(each, only)
    )


def _is_among(interface: Interface, only: tuple[str, ...]) -> bool:
    return not only or interface.name in only or interface.address in only


class Neighbours:
    """Watches the network for one session, on a thread of its own, until `close()`.

    Without `scouting` it only says that the network has changed, and `remedy`, what happens then.
    `lease_s` is the time after which a silent link is lost.
    """

    def __init__(
        self,
        session: zenoh.Session,
        scouting: Scouting | None,
        sockets: ZenohSockets,
        lease_s: float,
        log: logging.Logger | None,
        remedy: str,
    ) -> None:
        self._session = session
        self._id = str(session.zid())
        self._scouting = scouting
        self._only = () if scouting is None else scouting.only
        self._sockets = sockets
        self._apart_s = _APART * lease_s
        self._log = log
        self._remedy = remedy
        self._watch = NetworkWatch()
        self._waker, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = scheduler.Event()
        self._places = places_at_start() if not self._only else _places(self._only)
        self._links = Links()
        # When each of those that are lost was lost.
        self._lost_s: dict[str, float] = {}
        self._asking: dict[Place, socket.socket] = {}
        self._answering: socket.socket | None = None
        self._waiting: dict[str, float] = {}
        self._budget = (0.0, 0)
        self._has_changed = False
        self._turn = 0
        self._missed_s = 0.0
        self._next_scout_s: float | None = None
        self._events: list[Declaration] = []
        self._watch_links(session.info)
        self._thread = scheduler.Thread(target=self._run, name="tfbus-network", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the watch, before the session closes. Twice is fine."""
        if self._closing.is_set():
            return
        self._closing.set()
        for events in self._events:
            events.close()
        self._wake()
        if scheduler.current_thread() is not self._thread:
            self._thread.join(_CLOSING_S)

    def _wake(self) -> None:
        with suppress(OSError):
            self._waker.send(b".")

    def _watch_links(self, info: zenoh.SessionInfo) -> None:
        def noted(note: Callable[[Any], None]) -> Any:
            def take(event: Any) -> None:
                note(event)
                self._wake()

            return direct(take)

        links = self._links
        transports = info.declare_transport_events_listener(
            noted(links.note_transport), history=True
        )
        each_link = info.declare_link_events_listener(noted(links.note_link), history=True)
        self._events = [Declaration(transports), Declaration(each_link)]

    # The thread

    def _run(self) -> None:
        try:
            self._look()
            while not self._closing.is_set():
                self._wait()
        except Exception:
            if not self._closing.is_set() and self._log is not None:
                self._log.exception("Changes of the network are no longer noticed")
        finally:
            self._end()

    def _wait(self) -> None:
        """Wait for the next event, and handle it."""
        # By numbers of files beyond 1024, which `select.select` does not take.
        poll = select.poll()
        takers: dict[int, Callable[[], object]] = {}

        def on(each: socket.socket | None, take: Callable[[], object]) -> None:
            if each is not None:
                takers[each.fileno()] = take
                poll.register(each, select.POLLIN)

        on(self._woken, self._take_wake)
        on(self._watch.socket, self._look_soon)
        on(self._answering, self._answer)
        for asking in self._asking.values():
            on(asking, partial(self._take_hellos, asking))
        ready = poll.poll(self._timeout_ms())
        for number, _ in ready:
            if not self._closing.is_set():
                takers[number]()
        if not ready and self._watch.polled_s is not None:
            self._look()
        if self._next_scout_s is not None and scheduler.monotonic() >= self._next_scout_s:
            self._scout()

    def _timeout_ms(self) -> float | None:
        pauses = [] if self._watch.polled_s is None else [self._watch.polled_s]
        if self._next_scout_s is not None:
            pauses.append(max(self._next_scout_s - scheduler.monotonic(), 0.0))
        return 1e3 * min(pauses) if pauses else None

    def _take_wake(self) -> None:
        with suppress(OSError):
            self._woken.recv(4096)
        self._look_soon()

    def _look_soon(self) -> None:
        """Look once the changes that come together have come."""
        self._closing.wait(_SETTLED_S)
        self._watch.drain()
        if not self._closing.is_set():
            self._look()

    def _look(self) -> None:
        self._look_at_links()
        places = _places(self._only)
        if places != self._places:
            former, self._places, self._has_changed = self._places, places, True
            self._say(former, places)
            self._take_over(former)
            self._end_links_without_address()
            self._look_for_neighbours()

    def _look_at_links(self) -> None:
        lost, new, half = self._links.take()
        now_s = scheduler.monotonic()
        for zid in self._waiting.keys() & {zid for zid in self._waiting if zid in self._links}:
            del self._waiting[zid]
        self._lost_s = {
            zid: at_s for zid, at_s in self._lost_s.items() if now_s - at_s < self._apart_s
        } | dict.fromkeys(lost, now_s)
        if new:
            shorten_close(_ends(new))
        if half:
            end_links(_ends(half))
        # A host is missed, not a process that has ended. But one that stood still loses all links.
        known = {address for *_, address in self._places}
        known |= {_host(link.dst) for link in self._links.all()}
        missed = {host for endpoint in lost.values() if not is_local(host := _host(endpoint))}
        if half or (lost and not self._links) or missed - known:
            self._look_for_neighbours()

    def _end_links_without_address(self) -> None:
        """End links from an address that this host has lost: nothing comes on them any more."""
        links = self._links.all()
        gone = {host for host in {_host(link.src) for link in links} if not _is_here(host)}
        if gone:
            end_links(_ends(link for link in links if _host(link.src) in gone))

    def _say(self, former: frozenset[Place], places: frozenset[Place]) -> None:
        if self._log is None:
            return
        lost = [f"{name} has lost {address}" for _, name, address in _on_network(former - places)]
        gained = [f"{name} has {address}" for _, name, address in _on_network(places - former)]
        remedy = self._remedy
        if not _on_network(places):
            remedy = "this host has no network now; others are met again when it is back"
        if lost or gained:
            self._log.info("The network has changed: %s: %s", listed(gained + lost), remedy)

    # Answering Scouts

    def _take_over(self, former: frozenset[Place]) -> None:
        """Answer Scouts from now on, on the networks of now; Zenoh's own answers end."""
        if self._scouting is None or not self._scouting.answers:
            return
        group, port = self._scouting.group
        theirs = self._sockets.answering
        if theirs is not None:
            with suppress(OSError):
                theirs.setsockopt(socket.IPPROTO_IP, _HEAR_ALL_GROUPS, 0)
            _leave(theirs, group, former | places_at_start())
        if self._answering is None:
            answering = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            answering.setblocking(False)
            answering.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            answering.bind((group, port))
            self._answering = answering
        _leave(self._answering, group, former)
        for place in self._places:
            with suppress(OSError):  # it has just gone
                at_place = _group_at(group, place)
                self._answering.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, at_place)

    def _answer(self) -> None:
        assert self._answering is not None and self._scouting is not None
        for message, source in _received(self._answering):
            if is_scout_for(message, self._scouting.role) and not self._is_own(source):
                self._answer_to(source)

    def _answer_to(self, source: tuple[str, int]) -> None:
        second, answers = self._budget
        now_s = scheduler.monotonic() // 1
        answers = answers if now_s == second else 0
        self._budget = (now_s, answers + 1)
        if answers >= _MOST_ANSWERS_A_SECOND:
            return
        # By its route this socket knows the address at which that host reaches this one.
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reply:
            reply.connect(source)
            locators = self._locators(reply.getsockname()[0])
            if locators:
                assert self._scouting is not None
                reply.send(encode_hello(Hello(self._id, self._scouting.role, locators)))

    def _locators(self, address: str) -> tuple[str, ...]:
        """The endpoints at which the session is reached by an address of this host."""
        assert self._scouting is not None
        ends = [_split(endpoint) for endpoint in self._scouting.listen]
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

    def _is_own(self, source: tuple[str, int]) -> bool:
        address, port = source
        own = {each.getsockname()[1] for each in self._asking.values()}
        return port in own | {*self._sockets.asking} and (
            is_local(address) or any(address == place[2] for place in self._places)
        )

    # Scouting

    def _look_for_neighbours(self) -> None:
        """Scout from now on, soon and then again and again."""
        if self._scouting is None or not self._scouting.connects or not self._sockets.asking:
            return
        self._missed_s = scheduler.monotonic()
        self._turn = 0
        self._next_scout_s = self._missed_s

    def _scout(self) -> None:
        assert self._scouting is not None
        info = self._session.info
        self._links.keep_only({str(zid) for zid in (*info.peers_zid(), *info.routers_zid())})
        self._ask_on(self._places)
        for asking in self._asking.values():
            with suppress(OSError):  # no route yet: again after the next pause
                asking.sendto(encode_scout(), self._scouting.group)
        self._turn += 1
        now_s = scheduler.monotonic()
        pause_s = _PAUSES_S[min(self._turn, len(_PAUSES_S) - 1)]
        if now_s - self._missed_s <= _BACK_WITHIN_S:
            self._next_scout_s = now_s + pause_s
        elif self._has_changed:
            self._next_scout_s = now_s + _LATER_S
        else:
            # Zenoh scouts on these networks itself.
            self._next_scout_s = None
            self._ask_on(frozenset())

    def _ask_on(self, places: frozenset[Place]) -> None:
        """Have a socket to scout with at each of the places, and no others."""
        for place in self._asking.keys() - places:
            self._asking.pop(place).close()
        for place in places - self._asking.keys():
            with suppress(OSError):  # the interface has just gone
                self._asking[place] = self._asking_at(place)

    def _asking_at(self, place: Place) -> socket.socket:
        assert self._scouting is not None
        asking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            asking.setblocking(False)
            interface = _group_at(self._scouting.group[0], place)
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._scouting.ttl)
            asking.bind(("", 0))
        except OSError:
            asking.close()
            raise
        return asking

    def _take_hellos(self, asking: socket.socket) -> None:
        for message, (host, _) in _received(asking):
            hello = decode_hello(message)
            if hello is not None and hello.role != "client" and hello.zid != self._id:
                self._meet(hello, host)

    def _meet(self, hello: Hello, host: str) -> None:
        """Let Zenoh connect to one that has answered."""
        if hello.zid in self._links or not self._is_turn(hello):
            return
        # The first address of several may be one that is not reached from here, and Zenoh would
        # try it for 10 s.
        at_host = tuple(each for each in hello.locators if _host(each) == host)
        if not (locators := at_host or hello.locators):
            return
        message = encode_hello(hello._replace(locators=locators))
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as to_zenoh:
            to_zenoh.sendto(message, ("127.0.0.1", self._sockets.asking[0]))

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

    def _end(self) -> None:
        self._watch.close()
        ours: Iterable[socket.socket | None] = (
            *self._asking.values(),
            self._answering,
            self._sockets.answering,
            self._waker,
            self._woken,
        )
        for each in ours:
            if each is not None:
                each.close()


def _received(from_socket: socket.socket) -> Iterable[tuple[bytes, tuple[str, int]]]:
    """What has come by now, at most as much as one turn of the thread takes."""
    for _ in range(_MOST_ANSWERS_A_SECOND):
        try:
            yield from_socket.recvfrom(LARGEST)
        except BlockingIOError:
            return
        except OSError:
            continue  # what was sent before had no receiver


def _leave(one: socket.socket, group: str, places: Iterable[Place]) -> None:
    for place in places:
        with suppress(OSError):  # the interface has gone, or it was not on it
            one.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, _group_at(group, place))


def _group_at(group: str, place: Place) -> bytes:
    # By number: another interface may have the address next.
    return struct.pack("4s4si", socket.inet_aton(group), bytes(4), place[0])


def _on_network(places: frozenset[Place]) -> list[Place]:
    return sorted(place for place in places if not is_local(place[2]))


def _split(endpoint: str) -> tuple[str, str, int]:
    """The protocol, the host and the port of an endpoint such as tcp/[::]:7447#iface=eth0."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    return protocol, host.strip("[]"), int(port) if port.isdigit() else 0


def _is_here(address: str) -> bool:
    """Whether an address is one of this host."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind((address.partition("%")[0], 0))
    except OSError as error:
        return error.errno != errno.EADDRNOTAVAIL
    return True


def _ends(links: Iterable[Link]) -> set[Ends]:
    return {(_end_of(link.src), _end_of(link.dst)) for link in links}


def _end_of(endpoint: str) -> str:
    return f"{_host(endpoint)}:{_split(endpoint)[2]}"


def _host(endpoint: str) -> str:
    host = _split(endpoint)[1]
    return host.removeprefix("::ffff:")
