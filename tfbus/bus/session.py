"""A session: the declarations, messages and queries of one process on the bus."""

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, Literal

import zenoh

from tfbus.base import scheduler
from tfbus.base.arguments import seconds_to_wait
from tfbus.base.callbacks import Workers
from tfbus.base.errors import BusError, RightsError
from tfbus.base.structs import replace
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import Callbacks, OnSample, OnToken, direct
from tfbus.bus.links import host_of, speaks_tls
from tfbus.bus.neighbours import Neighbours
from tfbus.bus.network_session import (
    BytesPublisher,
    BytesSubscriber,
    Declaration,
    HeardWatch,
    NetworkSession,
    PublishersWithin,
    ServedWatch,
)
from tfbus.bus.query import Answer, OnEnd, Query, answer_of
from tfbus.bus.scouting import places_at_start
from tfbus.bus.settings import LAN, NodeSettings, network_of
from tfbus.bus.zenoh_config import (
    datagram_ports,
    end_shared_memory,
    lease_s,
    listens_beyond_loopback,
    scouting_of,
    zenoh_config,
)
from tfbus.bus.zenoh_library import bus_errors, is_router_missing
from tfbus.bus.zenoh_sockets import ZenohSockets, with_sockets
from tfbus.wire.keys import relative
from tfbus.wire.limits import kind_of_query

# At most as many long answers are sent at a time, and as many queries wait for that.
_LONG_ANSWERS = 4
_LONG_ANSWERS_WAITING = 64

# The end of a session waits at most this long for answers that are being sent.
_LAST_ANSWERS_S = 2.0

# A client that waits for its router says so again after this time.
_SAY_WAITING_AGAIN_S = 60.0

# Zenoh takes no infinite time for a query: thirty years.
_LONGEST_QUERY_S = 1e9

# News this soon after a token appeared that it is gone may be about the previous process's token:
# `living_later` says whether one is there.
ENDS_LATE_S = 10.0

QueryPriority = Literal["urgent", "usual", "low", "background"]


class Session(NetworkSession):
    """A process's place on the bus, until `close()` or the end of its `with`."""

    def __init__(
        self,
        settings: NodeSettings,
        log: logging.Logger,
        *,
        patience_s: float = 0.0,
        scouting_s: float | None = None,
        is_second: bool = False,
        opens_alone: bool = False,
    ):
        """Open the session.

        A client waits for its router for at most `patience_s` seconds, or if it `opens_alone` not
        at all, on Linux. A peer opens alone after
        `scouting_s` seconds without others (None: as configured). The second session of a process
        has an id of its own, and listens on other ports. Raises BusError if it cannot join the
        bus, as in a fork of a process that had joined it.
        """
        callbacks = Callbacks(log, settings.limits, is_closed=settings.closed is not None)
        super().__init__(log, callbacks, settings.name)
        self.settings = settings
        # That of an interface may come later than the process: known once the session is open.
        self.network = LAN
        self._ending: list[Callable[[], None]] = []
        self._outside: Session | None = None
        self._outside_lock = scheduler.Lock()
        self._answering = Workers("answers", threads=_LONG_ANSWERS, waiting=_LONG_ANSWERS_WAITING)
        self.open_to: tuple[str, ...] = ()
        self._neighbours: Neighbours | None = None
        self._deadline_s = scheduler.monotonic() + patience_s
        self._say_waiting_s = scheduler.monotonic()
        self._opens_alone = opens_alone
        network = zenoh_library.simulated()
        with bus_errors(f"join the bus{_through(settings)}"):
            if network is None:
                self._join(
                    lambda: zenoh_config(settings, scouting_s, self.network, is_second=is_second)
                )
                self._meet_neighbours(None if is_second else log)
                self._end_with_python()
            else:
                self.network = network_of(settings.network)
                self._open(partial(network.open_session, settings, opens_alone=opens_alone))
        self.id = str(self.zenoh.zid())

    def _join(self, make_config: Callable[[], zenoh.Config]) -> None:
        """Open Zenoh's session; its configuration has the network and the addresses of this host
        at each try.
        """
        places_at_start()
        settings = self.settings

        def open_once() -> zenoh.Session:
            self.network = network_of(settings.network, settings.connect)
            self._config = config = make_config()
            if why := end_shared_memory(config):
                self._log.warning("Shared memory stays off: %s", why)
            self._scouting = scouting_of(config, settings)
            self._sockets = ZenohSockets()
            if self._scouting is None:
                if not self._opens_alone:
                    return zenoh.open(config)
                from tfbus.bus.first_link import open_alone  # which few sessions need

                return open_alone(config)
            marks = self._scouting.marks()
            opened, self._sockets = with_sockets(partial(zenoh.open, config), marks)
            return opened

        self._open(open_once)
        # Endpoints by which any process of another host reaches it, and that it was given for that,
        # as a router is. All others listen too; of these tfbus doctor tells.
        is_given = bool(settings.listen) and not settings.closed
        self.open_to = listens_beyond_loopback(self._config) if is_given else ()

    @property
    def without_datagrams(self) -> str:
        """A clause that says why dynamic transforms wait for lost packets on a network on which an
        open bus sends them by UDP; "" if it does so, or would not.
        """
        if self.settings.closed is None or not self.network.has_datagrams:
            return ""
        return (
            f"a closed bus has links of TCP alone, also on network {self.network.name!r}: frames "
            "that come after a lost packet wait for it"
        )

    def _miss(self, error: zenoh.ZError) -> None:
        """A client waits for its router until its patience ends."""
        if not is_router_missing(error):
            raise error
        settings = self.settings
        if scheduler.monotonic() >= self._deadline_s:
            raise BusError(
                _why_no_link(settings)
                or f"no router answers{_at(settings)}: is it running (tfbus router), "
                "and its port open?"
            ) from error
        if scheduler.monotonic() >= self._say_waiting_s:
            self._say_waiting_s = scheduler.monotonic() + _SAY_WAITING_AGAIN_S
            self._log.warning("Waiting for a router%s", self.why_no_router())

    def _meet_neighbours(self, log: logging.Logger | None) -> None:
        """Watch the network, on hosts where tfbus knows its interfaces."""
        if not places_at_start():
            return
        remedy = "others reach it there"
        if self._scouting is not None and self._scouting.connects:
            remedy = "looking for others there"
        elif self.settings.connect:
            remedy = f"trying {' and '.join(self.settings.connect)} again"
        lease = lease_s(self._config)
        try:
            self._neighbours = Neighbours(
                self.zenoh,
                self._scouting,
                self._sockets,
                lease,
                self.network,
                datagram_ports(self._config),
                log,
                remedy,
            )
        except BaseException:
            # Such as too many open files: nobody could close the session that is open.
            self.zenoh.close()
            raise

    def _end(self) -> None:
        for end in list(self._ending):
            end()
        if self._neighbours is not None:
            self._neighbours.close()
        # A thread that is in Zenoh when Python shuts down aborts the process.
        self._answering.close(_LAST_ANSWERS_S)

    # Names of other namespaces

    def placed(self, key: str) -> tuple["Session", str]:
        """The session that reaches a key, and the key as that session names it.

        A key that begins with a slash is absolute, outside of this session's namespace. The first
        one opens a second session, without a namespace, which ends with this one.
        """
        key = relative(key, self.settings.namespace)
        if not key.startswith("/"):
            return self, key
        outside = self._open_outside()
        own = outside.settings.namespace
        key = relative(key, own)
        if own and key.startswith("/"):
            raise RightsError(f"{key} is outside of {own!r}, the namespace of this identity")
        return outside, key.removeprefix("/")

    def _open_outside(self) -> "Session":
        with self._outside_lock:
            if self._closing.is_set():
                raise BusError(f"node {self.settings.name!r} is closed")
            if self._outside is None:
                self._outside = Session(
                    replace(self.settings, namespace=""), self._log, is_second=True
                )
                self._ending.append(self._outside.close)
                if self._closing.is_set():
                    # Closed in between, perhaps before it could know of the second session.
                    self._outside.close()
                    raise BusError("the session is closed")
            return self._outside

    def at_close(self, end: Callable[[], None]) -> Callable[[], None]:
        """Call `end()` before the session closes; the function returned takes that back."""
        self._ending.append(end)

        def forget() -> None:
            with suppress(ValueError):
                self._ending.remove(end)

        return forget

    # Publish and subscribe

    def publisher(self, key: str, *, urgent: bool = False) -> BytesPublisher:
        """A publisher of messages or of dynamic transforms, which are `urgent`: they go first.

        A congested link drops messages. A newer one makes an old one worthless, and a subscriber
        that has stopped must not hold up the publisher's node, and with it all others. Zenoh's
        batching stays on: messages wait for others only while the link is busy. On a bad network
        urgent ones are not sent again if they are lost, and large ones of topics come last.
        """
        at, key = self.placed(key)
        drop = zenoh.CongestionControl.DROP
        with self._errors(f"publish {key}"):
            publisher = at.zenoh.declare_publisher(
                key, congestion_control=drop, priority=_priority(urgent), **self._lossy(urgent)
            )

        below = None
        if self.network.is_bad and not urgent:
            from tfbus.bus.large_messages import NewestLarge  # which few processes need

            below = NewestLarge(at, key)
        return BytesPublisher(key, publisher, self.settings.limits, self.settings.name, below=below)

    def publishers_within(self, expression: str, *, urgent: bool = False) -> PublishersWithin:
        """Publishers of many keys within a key expression, each as `publisher` makes them."""
        watch = self.watch_heard(expression)
        how = {"priority": _priority(urgent), **self._lossy(urgent)}
        return PublishersWithin(self.zenoh, watch, how, self.settings.limits, self.settings.name)

    def _lossy(self, urgent: bool) -> dict[str, Any]:
        """How Zenoh sends messages of which the next one makes a lost one worthless."""
        is_lossy = urgent and self.network.is_bad
        return {"reliability": zenoh.Reliability.BEST_EFFORT} if is_lossy else {}

    @property
    def retained_priority(self) -> zenoh.Priority:
        """The priority of retained messages and questions about transforms: the same as dynamic
        transforms, on a bad network one above.
        """
        is_above = self.network.is_bad
        return zenoh.Priority.REAL_TIME if is_above else zenoh.Priority.INTERACTIVE_HIGH

    def _query_priority(self, priority: QueryPriority) -> zenoh.Priority | None:
        if priority == "background":
            return zenoh.Priority.BACKGROUND
        if priority == "low":
            return zenoh.Priority.DATA_LOW
        return self.retained_priority if priority == "urgent" and self.network.is_bad else None

    def watch_heard(self, key: str) -> HeardWatch:
        """A watch that knows whether a process subscribes to `key`."""
        at, key = self.placed(key)
        with self._errors(f"watch {key}"):
            return HeardWatch(at.zenoh.declare_publisher(key))

    def subscriber(
        self,
        key: str,
        callback: OnSample,
        *,
        others: bool = False,
    ) -> BytesSubscriber:
        """Call `callback(key, payload)` for each message, but for one that is larger than the limit
        of its kind. With `others` messages of this session itself do not come.
        """
        at, key = self.placed(key)
        with self._errors(f"subscribe to {key}"):
            handler, dropped = self.callbacks.of_samples(key, callback)
            origin = zenoh.Locality.REMOTE if others else None
            declared = at.zenoh.declare_subscriber(key, handler, allowed_origin=origin)
            return BytesSubscriber(declared, dropped)

    # Ask and answer

    def queryable(
        self, key: str, callback: Callable[[Query], None], *, long: bool = False
    ) -> Declaration:
        """Call `callback(query)` for each query on `key`; it closes the query after its answers.

        If answers may be `long`, more than fits into a link, the callback runs on a thread of
        its own: if two processes sent such answers to each other on Zenoh's threads, each would
        wait for the other. At most 4 run and 64 wait; further queries are refused, and queries
        larger than the limit of their kind.
        """
        at, key = self.placed(key)
        what = f"query of {key}"
        guarded = self.callbacks.guarded(what, callback)

        def on_query(zenoh_query: zenoh.Query) -> None:
            query = Query(zenoh_query, self.settings.limits)
            try:
                query.check_size()
            except BusError as error:
                query.refuse(str(error))
                query.close()
                return
            if not long:
                callback(query)
            elif not self._answering.do(guarded, query):
                with query.answering(what):
                    raise BusError("too many queries at once; retry later")

        with self._errors(f"serve {key}"):
            handler = direct(self.callbacks.guarded(what, on_query))
            return Declaration(at.zenoh.declare_queryable(key, handler))

    def watch_served(self, key: str) -> ServedWatch:
        """A watch that knows whether a process serves `key`."""
        at, key = self.placed(key)
        with self._errors(f"watch {key}"):
            return ServedWatch(at.zenoh.declare_querier(key, target=zenoh.QueryTarget.ALL))

    def ask(
        self,
        key: str,
        payload: bytes | None = None,
        *,
        timeout_s: float = 5.0,
        answers_at: str = "",
    ) -> Iterator[Answer]:
        """Query all that serve `key` and iterate over their answers as they come, until all have
        closed the query or `timeout_s` has passed. Nothing if no process serves it.

        The keys of answers are within `answers_at` if that is not `key` itself.
        """
        # Zenoh's own channel for replies blocks when it is full, even before it can be read.
        answers: scheduler.SimpleQueue[Answer | None] = scheduler.SimpleQueue()
        self.ask_later(
            key,
            payload,
            answers.put,
            lambda: answers.put(None),
            timeout_s=timeout_s,
            answers_at=answers_at,
        )
        return iter(answers.get, None)

    def ask_later(
        self,
        key: str,
        payload: bytes | None,
        on_answer: Callable[[Answer], None],
        on_end: OnEnd,
        *,
        timeout_s: float,
        answers_at: str = "",
        others: bool = False,
        priority: QueryPriority = "usual",
        cancellation: zenoh.CancellationToken | None = None,
    ) -> None:
        """Ask as `ask` and return at once: `on_answer(answer)` is called for each answer, then
        `on_end()`. With `others` this session itself is not asked. On a bad network a query that is
        `urgent` has the priority of retained messages; other topics go before one that is `low`,
        all else on the link before one in the `background`, and before the answers of these.
        `cancellation.cancel()` ends it.
        """
        within = self.placed((answers_at or key).partition("?")[0])[1]
        at, key = self.placed(key)
        wait_s = seconds_to_wait(timeout_s)
        guarded = self.callbacks.guarded
        limits, kind = self.settings.limits, kind_of_query(key)
        if payload is not None and (mistake := limits.mistake_in(kind, len(payload))):
            raise BusError(f"could not query {key}: {mistake}")
        is_stray = self.callbacks.strays(within)

        def on_reply(reply: zenoh.Reply) -> None:
            answer = answer_of(reply, key, self.callbacks)
            if is_stray is None or not answer.key or not is_stray(answer.key):
                on_answer(answer)

        guarded_answer = guarded(f"answer of {key}", on_reply)
        guarded_end = guarded(f"end of the answers of {key}", lambda _: on_end())
        with self._errors(f"query {key}"):
            at.zenoh.get(
                key,
                direct(guarded_answer, lambda: guarded_end(None)),
                payload=payload,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=_LONGEST_QUERY_S if wait_s is None else min(wait_s, _LONGEST_QUERY_S),
                allowed_destination=zenoh.Locality.REMOTE if others else zenoh.Locality.ANY,
                cancellation_token=cancellation,
                priority=self._query_priority(priority),
                accept_replies=(
                    zenoh.ReplyKeyExpr.ANY if answers_at else zenoh.ReplyKeyExpr.MATCHING_QUERY
                ),
            )

    # Who is alive

    def living(self, key: str, *, timeout_s: float = 1.0) -> list[str]:
        """The keys of the tokens within the key expression that are alive now, sorted."""
        found: scheduler.SimpleQueue[list[str]] = scheduler.SimpleQueue()
        self.living_later(key, found.put, timeout_s=timeout_s)
        return found.get()

    def living_later(
        self, key: str, on_end: Callable[[list[str]], None], *, timeout_s: float = 1.0
    ) -> None:
        """Ask as `living` and return at once: `on_end(keys)` is called once."""
        at, key = self.placed(key)
        is_stray = self.callbacks.strays(key)
        found: set[str] = set()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                found.add(str(reply.ok.key_expr))

        def end(_: object) -> None:
            on_end(sorted(each for each in found if is_stray is None or not is_stray(each)))

        guarded_end = self.callbacks.guarded(f"list of {key}", end)
        with self._errors(f"list {key}"):
            at.zenoh.liveliness().get(
                key, direct(on_reply, lambda: guarded_end(None)), timeout=timeout_s
            )

    # Links

    def routers(self) -> list[str]:
        """The ids of the routers that the session is connected to."""
        with self._errors("list the routers"):
            return [str(zid) for zid in self.zenoh.info.routers_zid()]

    def why_no_router(self) -> str:
        """The end of a sentence: at which endpoints no router answers, or why one gives no link;
        within 2 s for each.
        """
        why = _why_no_link(self.settings)
        return f": {why}" if why else _at(self.settings)

    def linked(self) -> set[str]:
        """The ids of the processes that it has a link to."""
        with self._errors("list the links"):
            return {str(link.zid) for link in self.zenoh.info.links()}

    def address_of(self, zid: str) -> str:
        """The address of a process that it has a link to; "" if it has none to that."""
        with self._errors("list the links"):
            links = self.zenoh.info.links()
        return next((host_of(link.dst) for link in links if str(link.zid) == zid), "")

    def identities(self) -> dict[str, str]:
        """The identities of the processes that it has a link to, as their certificates prove them,
        by the ids of their sessions; {} on an open bus.
        """
        with self._errors("list the links"):
            links = self.zenoh.info.links()
        return {str(link.zid): link.auth_identifier for link in links if link.auth_identifier}

    def watch_links(self, callback: Callable[[], None]) -> Declaration:
        """Call `callback()` whenever a link to another process opens or closes."""
        return self.watch_processes(lambda process, linked: callback(), history=False)

    def watch_routers(self, callback: OnToken) -> Declaration:
        """Call `callback(id, linked)` for each router it has a link to, then whenever one opens
        or closes.
        """

        def on_change(process: zenoh.Transport, linked: bool) -> None:
            if process.whatami == zenoh.WhatAmI.ROUTER:
                callback(str(process.zid), linked)

        return self.watch_processes(on_change)

    def settle(self, *, quiet_s: float = 0.15, timeout_s: float = 1.0) -> None:
        """Wait until no link has opened or closed for `quiet_s` seconds, at most `timeout_s`.

        A session opens with the first process it finds; this waits for the others. If endpoints to
        connect to are given, the first link is waited for, however quiet it is.
        """
        changed = scheduler.Event()
        watch = self.watch_links(changed.set)
        deadline_s = scheduler.monotonic() + timeout_s
        while (left_s := deadline_s - scheduler.monotonic()) > 0.0:
            is_expecting = bool(self.settings.connect) and not self.linked()
            if not changed.wait(left_s if is_expecting else min(quiet_s, left_s)):
                break
            changed.clear()
        watch.close()


def _priority(urgent: bool) -> zenoh.Priority:
    return zenoh.Priority.INTERACTIVE_HIGH if urgent else zenoh.Priority.DATA


def _through(settings: NodeSettings) -> str:
    return f" through {', '.join(settings.connect)}" if settings.connect else ""


def _why_no_link(settings: NodeSettings) -> str:
    """Why an endpoint that answers gives no link: its bus is closed and ours open, or the reverse,
    or of another authority; "" if none answers.
    """
    is_closed = settings.closed is not None
    for endpoint in settings.connect:
        if (is_tls := speaks_tls(endpoint)) is None:
            continue
        address = endpoint.partition("/")[2]
        if is_tls and not is_closed:
            return (
                f"a closed bus is at {endpoint}: join it by --secure DIR, and --connect tls/"
                f"{address}"
            )
        if is_tls:
            return (
                f"the closed bus at {endpoint} gives this identity no link: join it by one of its "
                "authority (tfbus keys)"
            )
        if is_closed:
            return (
                f"an open bus, or another program, is at {endpoint}: join an open bus without "
                f"--secure, by --connect tcp/{address}"
            )
    return ""


def _at(settings: NodeSettings) -> str:
    return f" at {' or '.join(settings.connect)}" if settings.connect else " on this network"
