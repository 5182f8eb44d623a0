"""The neighbours: which of them answer scouting, and how a session meets them again after the
network of this host has changed.

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
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from typing import Any

import zenoh

from tfbus.base import scheduler
from tfbus.base.addresses import NetworkWatch, is_local
from tfbus.base.wording import listed
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import direct
from tfbus.bus.deaf_links import DeafLinks
from tfbus.bus.links import LinkEnds, Links, host_of, split_endpoint
from tfbus.bus.network_session import Declaration
from tfbus.bus.scouting import Place, ScoutAnswers, Scouting, Scouts, places, places_at_start
from tfbus.bus.settings import Network, NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.bus.zenoh_library import bus_errors, configure_zenoh_threads
from tfbus.bus.zenoh_sockets import (
    Ends,
    ZenohSockets,
    admit_datagrams,
    end_datagrams,
    end_links,
    fit_to_losses,
    hold_back,
    received_by,
    shorten_close,
    take_more,
)

# Changes come in groups: an interface, its carrier, its addresses.
_SETTLED_S = 0.05

_CLOSING_S = 2.0

# The kernel is asked again to admit hosts after these times.
_ADMIT_AGAIN_S, _LONGEST_ADMIT_AGAIN_S = 1.0, 60.0


class Neighbours:
    """Watches the network for one session, on a thread of its own, until `close()`.

    Without `scouting` it only says that the network has changed, and `remedy`, how to meet others.
    `lease_s` is the time after which a silent link is lost, and `network` the one between them.
    At `datagram_ports` the session takes datagrams beside other links.
    """

    def __init__(
        self,
        session: zenoh.Session,
        scouting: Scouting | None,
        sockets: ZenohSockets,
        lease_s: float,
        network: Network,
        datagram_ports: Iterable[int],
        log: logging.Logger | None,
        remedy: str,
    ) -> None:
        self._only = () if scouting is None else scouting.only
        self._log = log
        self._remedy = remedy
        self._watch = NetworkWatch()
        self._waker, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = scheduler.Event()
        self._places = places_at_start() if not self._only else places(self._only)
        self._links = Links(lease_s)
        self._deaf = DeafLinks(lease_s)
        self._network = network
        self._datagram_ports = tuple(datagram_ports)
        self._admitted: tuple[set[str], set[str]] | None = None
        # When hosts are to be admitted again that were not, and the pause before that.
        self._admit_again_s: float | None = None
        self._admit_pause_s = 0.0
        self._scouts: Scouts | None = None
        self._answers: ScoutAnswers | None = None
        if scouting is not None:
            self._scouts = Scouts(session, scouting, sockets, self._links, lease_s)
            self._answers = ScoutAnswers(str(session.zid()), scouting, sockets)
        self._has_changed = False
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
        links.end_history()

    # The thread

    def _run(self) -> None:
        try:
            self._update()
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
        on(self._watch.socket, self._update_soon)
        if self._answers is not None:
            on(self._answers.socket, self._answer)
        if self._scouts is not None:
            for asking in self._scouts.sockets:
                on(asking, partial(self._scouts.take_hellos, asking))
        ready = poll.poll(self._timeout_ms())
        for number, _ in ready:
            if not self._closing.is_set():
                takers[number]()
        if not ready and self._watch.polled_s is not None:
            self._update()
        if self._admit_again_s is not None and scheduler.monotonic() >= self._admit_again_s:
            self._update_links()
        if (look_s := self._deaf.next_s) is not None and scheduler.monotonic() >= look_s:
            self._end_deaf_links()
        if self._scouts is not None and self._scouts.is_due():
            self._scouts.scout(self._places, for_good=self._has_changed)

    def _timeout_ms(self) -> float | None:
        pauses = [] if self._watch.polled_s is None else [self._watch.polled_s]
        scout_s = None if self._scouts is None else self._scouts.next_s
        for at_s in (scout_s, self._admit_again_s, self._deaf.next_s):
            if at_s is not None:
                pauses.append(max(at_s - scheduler.monotonic(), 0.0))
        return 1e3 * min(pauses) if pauses else None

    def _take_wake(self) -> None:
        with suppress(OSError):
            self._woken.recv(4096)
        # At once: a process that links again may do so by datagrams first.
        self._admit()
        self._update_soon()

    def _update_soon(self) -> None:
        """Update once the changes that come together have come."""
        self._closing.wait(_SETTLED_S)
        self._watch.drain()
        if not self._closing.is_set():
            self._update()

    def _update(self) -> None:
        self._update_links()
        now = places(self._only)
        if now != self._places:
            former, self._places, self._has_changed = self._places, now, True
            self._say(former, now)
            if self._answers is not None:
                self._answers.take_over(former, now)
            self._end_links_without_address()
            self._begin_scouting()

    def _update_links(self) -> None:
        changes = self._links.poll()
        if self._scouts is not None:
            self._scouts.note_lost(changes.lost)
        if changes.new:
            shorten_close(_ends(changes.new))
            self._deaf.watch(_ends(changes.new))
            # Within a host TCP holds nothing up, and smaller pieces cost both ends CPU.
            beyond = {link for link in changes.new if not link.is_within_host}
            hold_back(_ends(beyond), self._network.unsent_bytes)
            if self._network.tcp_bytes:
                fit_to_losses(_ends(changes.new), self._network.tcp_bytes)
                take_more(_ends(changes.new - beyond))
        # Before Zenoh closes an encrypted link, it waits until all is sent: to a host that is gone,
        # as long as TCP tries. Until then it adds the next link to the lost one's connection.
        if changes.half or changes.ended:
            end_links(_ends(changes.half | changes.ended))
        self._admit()
        # Messages under way on the other link are lost, and so may be a declaration.
        if changes.datagrams:
            end_datagrams(_ends(changes.datagrams))
        # A host is missed, not a process that has ended. But one that stood still loses all links.
        known = {address for *_, address in self._places}
        known |= {host_of(link.dst) for link in self._links.all()}
        lost = map(host_of, changes.lost.values())
        missed = {host for host in lost if not is_local(host)}
        if changes.half or (changes.lost and not self._links) or missed - known:
            self._begin_scouting()

    def _end_deaf_links(self) -> None:
        """End the connections of links that are never read: Zenoh then opens them anew."""
        deaf = self._deaf.look(received_by(self._deaf.links))
        if not deaf:
            return
        ending = {link for link in self._links.all() if _ends([link]) <= deaf}
        end_links(deaf | _ends(self._links.beside(ending)))
        self._begin_scouting()
        if self._log is not None:
            self._log.warning(
                "Nothing that came by the link to %s was read since it was opened: opening it anew",
                listed(sorted(far for _, far in deaf)),
            )

    def _admit(self) -> None:
        """Take datagrams from hosts with another link alone; the kernel may refuse that, and is
        asked again.
        """
        if not self._datagram_ports:
            return
        hosts, ending = self._links.hosts_for_datagrams()
        now_s, again_s = scheduler.monotonic(), self._admit_again_s
        if (hosts, ending) == self._admitted if again_s is None else now_s < again_s:
            return
        self._admitted, self._admit_again_s = (hosts, ending), None
        failures = [
            why for port in self._datagram_ports if (why := admit_datagrams(port, hosts, ending))
        ]
        if not failures:
            self._admit_pause_s = 0.0
            return
        is_first = not self._admit_pause_s
        pause_s = 2.0 * self._admit_pause_s or _ADMIT_AGAIN_S
        self._admit_pause_s = min(pause_s, _LONGEST_ADMIT_AGAIN_S)
        self._admit_again_s = now_s + self._admit_pause_s
        if is_first and self._log is not None:
            self._log.warning(
                "Datagrams of %d hosts could not be admitted: %s; trying again. Until then some of "
                "what these hosts declare may be missed, or their transforms come by TCP",
                len(hosts),
                failures[0],
            )

    def _begin_scouting(self) -> None:
        if self._scouts is not None:
            self._scouts.begin()

    def _answer(self) -> None:
        if self._answers is not None and self._scouts is not None:
            self._answers.answer(self._scouts.own_ports())

    def _end_links_without_address(self) -> None:
        """End links from an address that this host has lost: nothing comes on them any more."""
        links = self._links.all()
        gone = {host for host in {host_of(link.src) for link in links} if not _is_here(host)}
        if gone:
            end_links(_ends(link for link in links if host_of(link.src) in gone))

    def _say(self, former: frozenset[Place], now: frozenset[Place]) -> None:
        if self._log is None:
            return
        lost = [f"{name} has lost {address}" for _, name, address in _on_network(former - now)]
        gained = [f"{name} has {address}" for _, name, address in _on_network(now - former)]
        remedy = self._remedy
        if not _on_network(now):
            remedy = "this host has no network now; others are met again when it is back"
        if lost or gained:
            self._log.info("The network has changed: %s: %s", listed(gained + lost), remedy)

    def _end(self) -> None:
        self._watch.close()
        for each in (self._scouts, self._answers):
            if each is not None:
                each.close()
        self._waker.close()
        self._woken.close()


def _on_network(places: frozenset[Place]) -> list[Place]:
    return sorted(place for place in places if not is_local(place[2]))


def _is_here(address: str) -> bool:
    """Whether an address is one of this host."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind((address.partition("%")[0], 0))
    except OSError as error:
        return error.errno != errno.EADDRNOTAVAIL
    return True


def _ends(links: Iterable[LinkEnds]) -> set[Ends]:
    return {(_end_of(link.src), _end_of(link.dst)) for link in links}


def _end_of(endpoint: str) -> str:
    return f"{host_of(endpoint)}:{split_endpoint(endpoint)[2]}"


# For each process its id and its endpoints.
Hellos = dict[str, tuple[str, ...]]


def scout(
    settings: NodeSettings,
    timeout_s: float,
    *,
    until: Callable[[str, tuple[str, ...]], bool],
    what: str = "peer|router",
) -> Hellos:
    """The peers and routers that answer within `timeout_s`, or until `until(id, endpoints)` is true
    of one. Raises BusError if this host cannot ask.
    """
    zenoh_library.begin_use()
    configure_zenoh_threads()
    found: Hellos = {}
    is_found = scheduler.Event()

    def on_hello(hello: zenoh.Hello) -> None:
        zid, endpoints = str(hello.zid), tuple(hello.locators)
        found[zid] = endpoints
        if until(zid, endpoints):
            is_found.set()

    with bus_errors("look for others by scouting"):
        scout = _scout(direct(on_hello), what, settings)
    is_found.wait(timeout_s)
    scout.stop()
    return found.copy()


def _scout(handler: Any, what: str, settings: NodeSettings) -> Any:
    network = zenoh_library.simulated()
    if network is not None:
        return network.scout(handler, what)
    return zenoh.scout(handler, what=what, config=zenoh_config(settings))
