"""A session: what one process declares, sends and asks on the bus. Only this file opens Zenoh."""

import atexit
import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from functools import cache, partial
from typing import TypeVar

import zenoh

from tfbus.bus import forks, zenoh_library
from tfbus.bus.callbacks import Callbacks, direct
from tfbus.bus.endpoints import speaks_tls
from tfbus.bus.handles import (
    BytesPublisher,
    Declaration,
    HeardWatch,
    PublishersWithin,
    ServedWatch,
    Token,
)
from tfbus.bus.neighbours import Neighbours
from tfbus.bus.query import Answer, Query, answer_of
from tfbus.bus.scouting import places_at_start
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import lease_s, listens_beyond_loopback, scouting_of, zenoh_config
from tfbus.bus.zenoh_errors import bus_errors, first_sentence, is_router_missing
from tfbus.bus.zenoh_sockets import ZenohSockets, with_sockets
from tfbus.bus.zenoh_threads import configure_zenoh_threads
from tfbus.errors import BusError, RightsError
from tfbus.runtime import scheduler
from tfbus.runtime.seconds import seconds_to_wait
from tfbus.runtime.structs import replace
from tfbus.runtime.workers import Workers
from tfbus.wire.keys import relative
from tfbus.wire.limits import kind_of_query

T = TypeVar("T")

# A client tries its router again after this time.
_RETRY_S = 0.5

# At most as many long answers are sent at a time, and as many queries wait for that.
_LONG_ANSWERS = 4
_LONG_ANSWERS_WAITING = 64

# The end of a session waits at most this long for those that are being sent.
_LAST_ANSWERS_S = 2.0

# Zenoh takes no infinite time for a query: thirty years.
_LONGEST_QUERY_S = 1e9


class Session:
    """A process's place on the bus, until `close()` or the end of its `with`.

    All callbacks come on threads of Zenoh's. Their exceptions are logged, the first of each.
    """

    def __init__(
        self,
        settings: NodeSettings,
        log: logging.Logger,
        *,
        patience_s: float = 0.0,
        scouting_s: float | None = None,
        is_second: bool = False,
    ):
        """Open the session.

        A client waits for its router for at most `patience_s` seconds. A peer opens alone after
        `scouting_s` seconds without others (None: as configured). The second session of a process
        has an id of its own, and listens on other ports. Raises BusError if it cannot join the
        bus, as in a fork of a process that had joined it.
        """
        forks.begin()
        configure_zenoh_threads()
        zenoh.try_init_log_from_env()
        self.settings = settings
        self.callbacks = Callbacks(log, settings.limits, is_closed=settings.closed is not None)
        self._log = log
        self._closed = False
        self._ending: list[Callable[[], None]] = []
        self._tokens: dict[Token, None] = {}
        self._outside: Session | None = None
        self._outside_lock = scheduler.Lock()
        self._answering = Workers("answers", threads=_LONG_ANSWERS, waiting=_LONG_ANSWERS_WAITING)
        self.open_to: tuple[str, ...] = ()
        self._neighbours: Neighbours | None = None
        network = zenoh_library.simulated()
        with bus_errors(f"join the bus{_through(settings)}"):
            if network is None:
                self._join(scouting_s, patience_s, is_second=is_second)
            else:
                open_session = partial(network.open_session, settings)
                self.zenoh: zenoh.Session = self._retried(open_session, patience_s)
        self.id = str(self.zenoh.zid())

    def _join(self, scouting_s: float | None, patience_s: float, *, is_second: bool) -> None:
        """Open Zenoh's session, which follows the network of this host and ends with Python."""
        settings = self.settings
        places_at_start()
        make_config = partial(zenoh_config, settings, scouting_s, is_second=is_second)
        config = self._retried(lambda: self._open_once(make_config()), patience_s)
        # Where any process of another host reaches it, by an endpoint that it was given for that,
        # as a router is. All others listen too; of these tfbus doctor tells.
        is_given = bool(settings.listen) and not settings.closed
        self.open_to = listens_beyond_loopback(config) if is_given else ()
        try:
            self._neighbours = self._meet_neighbours(config, is_second=is_second)
        except BaseException:
            # Such as too many open files: nobody could close the session that is open.
            self.zenoh.close()
            raise
        forks.holders.add(self, "zenoh")
        if not scheduler.is_simulated:  # a simulated process ends by itself
            atexit.register(self._end_with_process)
        _end_at_a_signal_once_main_has_ended()

    def _retried(self, open_once: Callable[[], T], patience_s: float) -> T:
        """Open the session, until it is open or `patience_s` seconds have passed without a router.

        Retried here, since Ctrl-C does not interrupt Zenoh's own retry.
        """
        deadline = scheduler.monotonic() + patience_s
        is_waiting = False
        while True:
            try:
                return open_once()
            except zenoh.ZError as error:
                if not is_router_missing(error):
                    raise
                if scheduler.monotonic() >= deadline:
                    why = _why_no_link(self.settings)
                    raise BusError(
                        why
                        or f"no router answers{_at(self.settings)}: is it running (tfbus router), "
                        "and its port open?"
                    ) from error
            if not is_waiting:
                is_waiting = True
                why = _why_no_link(self.settings)
                said = f": {why}" if why else _at(self.settings)
                self._log.warning("Waiting for a router%s", said)
            scheduler.sleep(_RETRY_S)

    def _open_once(self, config: zenoh.Config) -> zenoh.Config:
        """Open Zenoh's session; returns its configuration, which has the addresses of this host."""
        self._scouting = scouting_of(config, self.settings)
        self._sockets = ZenohSockets()
        if self._scouting is None:
            self.zenoh = zenoh.open(config)
        else:
            self.zenoh, self._sockets = with_sockets(
                partial(zenoh.open, config), self._scouting.marks()
            )
        return config

    def _meet_neighbours(self, config: zenoh.Config, *, is_second: bool) -> Neighbours | None:
        """Watch the network, on hosts where tfbus knows its interfaces."""
        if not places_at_start():
            return None
        remedy = "others reach it there"
        if self._scouting is not None and self._scouting.connects:
            remedy = "looking for others there"
        elif self.settings.connect:
            remedy = f"trying {' and '.join(self.settings.connect)} again"
        log = None if is_second else self._log
        return Neighbours(self.zenoh, self._scouting, self._sockets, lease_s(config), log, remedy)

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus, within 10 s: every declaration of this session ends. Twice is fine.

        If Zenoh does not close in that time, the log says so. In a callback of Zenoh's it
        returns before that is done. In a forked child it does nothing.
        """
        if not self._closed and not forks.is_lost():
            self._closed = True
            self.callbacks.mute()
            atexit.unregister(self._end_with_process)
            for end in list(self._ending):
                end()
            if self._neighbours is not None:
                self._neighbours.close()
            # A thread that is in Zenoh when Python shuts down aborts the process.
            self._answering.close(_LAST_ANSWERS_S)
            # Zenoh may open a link while it closes, where it learns of a peer just then. That link
            # stays until the process ends, and its far end would take our tokens for alive.
            for token in tuple(self._tokens):
                token.close()
            if _is_zenohs(scheduler.current_thread()):
                # Zenoh's end waits for this callback, and for 10 s at most. Python's end waits for
                # the thread.
                scheduler.Thread(target=self._close_zenoh, name="end of the session").start()
            else:
                self._close_zenoh()

    def _close_zenoh(self) -> None:
        try:
            self.zenoh.close()
        except zenoh.ZError as error:
            # As where a peer has stopped in the middle of a message. The caller could do nothing
            # about an error, and the end of the process ends the session too.
            self._log.warning("Session did not close cleanly: %s", first_sentence(str(error)))

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
            if self._closed:
                raise BusError(f"node {self.settings.name!r} is closed")
            if self._outside is None:
                self._outside = Session(
                    replace(self.settings, namespace=""), self._log, is_second=True
                )
                self._ending.append(self._outside.close)
                if self._closed:
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

    def _end_with_process(self) -> None:
        # Zenoh's threads that return into an interpreter that shuts down abort the process. A
        # child of a fork has none of them, and nothing to close.
        if not forks.is_lost():
            _end_at_a_signal()
            self.close()

    def _errors(self, doing: str) -> AbstractContextManager[None]:
        """Raise Zenoh's errors as those of this node."""
        return bus_errors(doing, self.settings.name)

    # Publish and subscribe

    def publisher(self, key: str, *, urgent: bool = False) -> BytesPublisher:
        """A publisher of messages or of dynamic transforms, which are `urgent`: they go first.

        A congested link drops messages. A newer one makes an old one worthless, and a subscriber
        that has stopped must not hold up the publisher's node, and with it all others. Zenoh's
        batching stays on: messages wait for others only while the link is busy.
        """
        at, key = self.placed(key)
        with self._errors(f"publish {key}"):
            publisher = at.zenoh.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_priority(urgent),
            )
        return BytesPublisher(key, publisher, self.settings.limits, self.settings.name)

    def publishers_within(self, expression: str, *, urgent: bool = False) -> PublishersWithin:
        """Publishers of many keys within a key expression, each as `publisher` makes them."""
        watch = self.watch_heard(expression)
        return PublishersWithin(
            self.zenoh, watch, _priority(urgent), self.settings.limits, self.settings.name
        )

    def watch_heard(self, key: str) -> HeardWatch:
        """A watch that knows whether a process subscribes to `key`."""
        with self._errors(f"watch {key}"):
            return HeardWatch(self.zenoh.declare_publisher(key))

    def subscriber(
        self,
        key: str,
        callback: Callable[[str, bytes], None],
        on_too_large: Callable[[], object] = lambda: None,
        *,
        others: bool = False,
    ) -> Declaration:
        """Call `callback(key, payload)` for each message, and `on_too_large()` for one that is
        dropped unread, since it is larger than the limit of its kind. With `others` those of this
        session itself do not come.
        """
        at, key = self.placed(key)
        with self._errors(f"subscribe to {key}"):
            handler = self.callbacks.of_samples(key, callback, on_too_large)
            origin = zenoh.Locality.REMOTE if others else None
            return Declaration(at.zenoh.declare_subscriber(key, handler, allowed_origin=origin))

    # Ask and answer

    def queryable(
        self, key: str, callback: Callable[[Query], None], *, long: bool = False
    ) -> Declaration:
        """Call `callback(query)` for each query on `key`; it closes the query after its answers.

        If answers may be `long`, more than fits into a link, the callback runs on a thread of
        its own: if two processes sent such answers to each other on Zenoh's threads, each would
        wait for the other. At most 4 run and 64 wait; further queries are refused, and those
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
            elif not self._answering.do(lambda: guarded(query)):
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
        on_end: Callable[[], None],
        *,
        timeout_s: float,
        answers_at: str = "",
        others: bool = False,
        cancellation: zenoh.CancellationToken | None = None,
    ) -> None:
        """Ask as `ask` and return at once: `on_answer(answer)` is called for each answer, then
        `on_end()`. With `others` this session itself is not asked. `cancellation.cancel()` ends it.
        """
        within = self.placed((answers_at or key).partition("?")[0])[1]
        at, key = self.placed(key)
        wait_s = seconds_to_wait(timeout_s)
        guarded = self.callbacks.guarded
        limits, kind = self.settings.limits, kind_of_query(key)
        if payload is not None and (mistake := limits.mistake_in(kind, len(payload))):
            raise BusError(f"could not query {key}: {mistake}")
        mistake_in_size = partial(self.callbacks.mistake_in_answer, key)
        is_stray = self.callbacks.strays(within)

        def on_reply(reply: zenoh.Reply) -> None:
            answer = answer_of(reply, mistake_in_size)
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
                accept_replies=(
                    zenoh.ReplyKeyExpr.ANY if answers_at else zenoh.ReplyKeyExpr.MATCHING_QUERY
                ),
            )

    # Who is alive

    def token(self, key: str) -> Declaration:
        """Declare that `key` is alive for as long as this session is."""
        with self._errors(f"declare {key}"):
            return Token(self.zenoh.liveliness().declare_token(key), self._tokens)

    def living(self, key: str, *, timeout_s: float = 1.0) -> list[str]:
        """The keys of the tokens within the key expression that are alive now, sorted."""
        at, key = self.placed(key)
        keys: scheduler.SimpleQueue[str | None] = scheduler.SimpleQueue()
        handler = direct(
            lambda reply: keys.put(str(reply.ok.key_expr) if reply.ok else ""),
            lambda: keys.put(None),
        )
        with self._errors(f"list {key}"):
            at.zenoh.liveliness().get(key, handler, timeout=timeout_s)
        found = set(filter(None, iter(keys.get, None)))
        is_stray = self.callbacks.strays(key)
        return sorted(each for each in found if is_stray is None or not is_stray(each))

    def watch_living(self, key: str, callback: Callable[[str, bool], None]) -> Declaration:
        """Call `callback(key, alive)` for each token within the key expression that is alive, then
        at each change.
        """

        is_stray = self.callbacks.strays(key)

        def on_sample(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr)
            if is_stray is None or not is_stray(name):
                callback(name, sample.kind == zenoh.SampleKind.PUT)

        with self._errors(f"watch {key}"):
            handler = direct(self.callbacks.guarded(f"token of {key}", on_sample))
            liveliness = self.zenoh.liveliness()
            return Declaration(liveliness.declare_subscriber(key, handler, history=True))

    # Links

    def routers(self) -> list[str]:
        """The ids of the routers that the session is connected to."""
        with self._errors("list the routers"):
            return [str(zid) for zid in self.zenoh.info.routers_zid()]

    def linked(self) -> set[str]:
        """The ids of the processes that it has a link to."""
        with self._errors("list the links"):
            return {str(link.zid) for link in self.zenoh.info.links()}

    def identities(self) -> dict[str, str]:
        """The identities of the processes that it has a link to, as their certificates prove them,
        by the ids of their sessions; {} on an open bus.
        """
        with self._errors("list the links"):
            links = self.zenoh.info.links()
        return {str(link.zid): link.auth_identifier for link in links if link.auth_identifier}

    def watch_links(self, callback: Callable[[], None]) -> Declaration:
        """Call `callback()` whenever a link to another process opens or closes."""
        with self._errors("watch links"):
            handler = direct(self.callbacks.guarded("link", lambda _: callback()))
            return Declaration(self.zenoh.info.declare_transport_events_listener(handler))

    def watch_routers(self, callback: Callable[[str, bool], None]) -> Declaration:
        """Call `callback(id, linked)` for each router it has a link to, then whenever one opens
        or closes.
        """

        def on_event(event: zenoh.TransportEvent) -> None:
            if event.transport.whatami == zenoh.WhatAmI.ROUTER:
                callback(str(event.transport.zid), event.kind == zenoh.SampleKind.PUT)

        with self._errors("watch links"):
            handler = direct(self.callbacks.guarded("link", on_event))
            info = self.zenoh.info
            return Declaration(info.declare_transport_events_listener(handler, history=True))

    def settle(self, *, quiet_s: float = 0.15, timeout_s: float = 1.0) -> None:
        """Wait until no link has opened or closed for `quiet_s` seconds, at most `timeout_s`.

        A session opens with the first process it finds; this waits for the others.
        """
        changed = scheduler.Event()
        watch = self.watch_links(changed.set)
        deadline = scheduler.monotonic() + timeout_s
        while changed.wait(min(quiet_s, max(deadline - scheduler.monotonic(), 0.0))):
            changed.clear()
            if scheduler.monotonic() >= deadline:
                break
        watch.close()


def _end_at_a_signal() -> None:
    """From here on a signal ends the process at once, without a traceback."""
    with suppress(ValueError):  # this interpreter has no signals
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                signal.signal(number, signal.SIG_DFL)


@cache
def _end_at_a_signal_once_main_has_ended() -> None:
    # Python waits for threads before it calls what atexit has; a KeyboardInterrupt meanwhile would
    # print a traceback. Its own thread pools end by this function of threading's, too.
    register: Callable[[Callable[[], None]], object]
    register = getattr(threading, "_register_atexit", atexit.register)
    with suppress(RuntimeError):  # main has ended already
        register(_end_at_a_signal)


def _is_zenohs(thread: scheduler.Thread) -> bool:
    """Whether a thread is not Python's own, as those are on which callbacks come."""
    return isinstance(thread, threading._DummyThread)


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
