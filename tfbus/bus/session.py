"""The one place that opens Zenoh: a session, in words that the rest of tfbus uses.

Zenoh calls back on threads of its own and swallows exceptions; here they are caught, counted and
reported once.
"""

import atexit
import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import zenoh

from tfbus.bus.bytes_publisher import BytesPublisher, PublishersWithin, priority_of
from tfbus.bus.callbacks import kept
from tfbus.bus.handles import Declaration, HeardWatch, ServedWatch, direct
from tfbus.bus.query import Answer, Query, answer_of
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.bus.zenoh_errors import bus_errors, first_sentence, is_nobody_there
from tfbus.errors import BusError
from tfbus.runtime.workers import Workers

# How soon a client looks for its router again.
_RETRY_S = 0.5

# So many answers that may be long are sent at a time, and so many questions wait for that.
_LONG_ANSWERS = 4
_LONG_ANSWERS_WAITING = 64


class Session:
    """One process's place on the bus; it closes by `with` or `close()`, twice is fine."""

    def __init__(
        self,
        settings: NodeSettings,
        log: logging.Logger,
        *,
        patience_s: float = 0.0,
        scouting_s: float | None = None,
    ):
        """Open the session.

        A client's router may come later: it is waited for, at most `patience_s` seconds. Where
        nobody is found, it opens after `scouting_s` (None: what the configuration says). Raises
        BusError where the bus cannot be joined, and says why.
        """
        zenoh.try_init_log_from_env()
        self.settings = settings
        self._log = log
        self._closed = False
        self._ending: list[Callable[[], None]] = []
        self._answering = Workers("answers", threads=_LONG_ANSWERS, waiting=_LONG_ANSWERS_WAITING)
        config = zenoh_config(settings, scouting_s)
        with bus_errors(f"join the bus{_towards(settings)}"):
            self.zenoh = self._open(config, patience_s)
        self.id = str(self.zenoh.zid())
        self._process = os.getpid()
        atexit.register(self._end_with_process)

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus: every declaration of this session ends with it.

        It is waited for 10 s at most, and then told in the log.
        """
        if not self._closed:
            self._closed = True
            atexit.unregister(self._end_with_process)
            for end in list(self._ending):
                end()
            try:
                self.zenoh.close()
            except zenoh.ZError as error:
                # As where a peer has stopped in the middle of a message. The end of the process
                # ends it all the same; nobody could do anything about an error here.
                self._log.warning("Left the bus untidily: %s", first_sentence(str(error)))

    def _end_with_process(self) -> None:
        # Threads of Zenoh's that come back from it into an interpreter that is being taken down
        # abort the process. A child of a fork has none of them, and nothing to close.
        if os.getpid() == self._process:
            # From here on Ctrl-C ends the process at once, without a traceback.
            with suppress(ValueError):  # this interpreter has no signals
                if signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None):
                    signal.signal(signal.SIGINT, signal.SIG_DFL)
            self.close()

    def at_close(self, end: Callable[[], None]) -> Callable[[], None]:
        """Call `end()` before the session closes; call what this returns to have it not called."""
        self._ending.append(end)

        def forget() -> None:
            with suppress(ValueError):
                self._ending.remove(end)

        return forget

    def _open(self, config: zenoh.Config, patience_s: float) -> zenoh.Session:
        """Zenoh's session; tried again here, not by Zenoh, which would not hear Ctrl-C."""
        deadline = time.monotonic() + patience_s
        told = False
        while True:
            try:
                return zenoh.open(config)
            except zenoh.ZError as error:
                if not is_nobody_there(error) or time.monotonic() >= deadline:
                    raise
            if not told:
                told = True
                self._log.warning("Waiting for a router%s", _at(self.settings))
            time.sleep(_RETRY_S)

    def publisher(self, key: str, *, urgent: bool = False) -> BytesPublisher:
        """A publisher of messages or dynamic transforms; what is urgent goes before the rest.

        A newer message makes an old one worthless, so where a link is congested one is dropped:
        a subscriber that has stopped must not hold up the publisher's node, and with it all
        others. Zenoh's batching stays on: a message waits for others only while the link is busy,
        and then they go as one.
        """
        with bus_errors(f"publish {key}"):
            publisher = self.zenoh.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority_of(urgent),
            )
        return BytesPublisher(key, publisher)

    def publishers_within(self, expression: str, *, urgent: bool = False) -> PublishersWithin:
        """Publishers of many keys within a key expression, each as `publisher` makes them."""
        return PublishersWithin(self.zenoh, self.watch_heard(expression), priority_of(urgent))

    def subscriber(self, key: str, callback: Callable[[str, bytes], None]) -> Declaration:
        """Call `callback(key, payload)` for each message, on a thread of Zenoh's."""
        with bus_errors(f"subscribe to {key}"):
            subscriber = self.zenoh.declare_subscriber(key, self.sample_callback(key, callback))
        return Declaration(subscriber)

    def queryable(
        self, key: str, callback: Callable[[Query], None], *, long: bool = False
    ) -> Declaration:
        """Call `callback(query)` for each question on `key`, on a thread of Zenoh's.

        The callback closes the query when it has sent its answers. Where they may be `long` it is
        called on another thread: were Zenoh's held up by answers that do not fit into the link,
        and the asker's as well, by answers to us, both would wait for each other. Who asks while
        too many others wait is refused.
        """
        what = f"query of {key}"
        guarded = self._guarded(what, callback)

        def on_query(zenoh_query: zenoh.Query) -> None:
            query = Query(zenoh_query)
            if not long:
                callback(query)
            elif not self._answering.do(lambda: guarded(query)):
                with query.answering(what):
                    raise BusError("too many others ask at the same time; ask again later")

        with bus_errors(f"serve {key}"):
            guarded_query = self._guarded(what, on_query)
            return Declaration(self.zenoh.declare_queryable(key, direct(guarded_query)))

    def ask(
        self,
        key: str,
        payload: bytes | None = None,
        *,
        timeout_s: float = 5.0,
        at_any_key: bool = False,
    ) -> Iterator[Answer]:
        """The answers of all who serve `key`, as they come, until all have closed or
        `timeout_s` has passed. No answer at all is an empty iteration.

        With `at_any_key` they may answer at keys that are not within `key`.
        """
        # Zenoh's own channel for replies blocks when it is full, even before it can be read.
        answers: queue.SimpleQueue[Answer | None] = queue.SimpleQueue()
        self.ask_later(
            key,
            payload,
            answers.put,
            lambda: answers.put(None),
            timeout_s=timeout_s,
            at_any_key=at_any_key,
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
        at_any_key: bool = False,
    ) -> None:
        """Ask as `ask` does and return at once: the answers are handed to `on_answer` as they
        come and `on_end()` is called after the last, both on threads of Zenoh's.
        """

        def on_reply(reply: zenoh.Reply) -> None:
            on_answer(answer_of(reply))

        guarded_end = self._guarded(f"end of the answers of {key}", lambda _: on_end())
        with bus_errors(f"ask for {key}"):
            self.zenoh.get(
                key,
                direct(self._guarded(f"answer of {key}", on_reply), lambda: guarded_end(None)),
                payload=payload,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                accept_replies=(
                    zenoh.ReplyKeyExpr.ANY if at_any_key else zenoh.ReplyKeyExpr.MATCHING_QUERY
                ),
            )

    def watch_heard(self, key: str) -> HeardWatch:
        """A watch that knows whether somebody subscribes to `key`."""
        with bus_errors(f"watch {key}"):
            return HeardWatch(self.zenoh.declare_publisher(key))

    def watch_served(self, key: str) -> ServedWatch:
        """A watch that knows whether somebody serves `key`."""
        with bus_errors(f"watch {key}"):
            return ServedWatch(self.zenoh.declare_querier(key, target=zenoh.QueryTarget.ALL))

    def token(self, key: str) -> Declaration:
        """Declare that `key` is alive for as long as this session is."""
        with bus_errors(f"declare {key}"):
            return Declaration(self.zenoh.liveliness().declare_token(key))

    def living(self, key: str, *, timeout_s: float = 1.0) -> list[str]:
        """The keys of the tokens within the key expression that are alive now, sorted."""
        keys: queue.SimpleQueue[str | None] = queue.SimpleQueue()

        def on_reply(reply: zenoh.Reply) -> None:
            keys.put(answer_of(reply).key)

        with bus_errors(f"list {key}"):
            self.zenoh.liveliness().get(
                key,
                direct(on_reply, lambda: keys.put(None)),
                timeout=timeout_s,
            )
        return sorted(set(filter(None, iter(keys.get, None))))

    def watch_living(self, key: str, callback: Callable[[str, bool], None]) -> Declaration:
        """Call `callback(key, alive)` for each token within the key expression: first for those
        that are alive already, then at each change.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        with bus_errors(f"watch {key}"):
            guarded = self._guarded(f"token of {key}", on_sample)
            return Declaration(
                self.zenoh.liveliness().declare_subscriber(key, direct(guarded), history=True)
            )

    def settle(self, *, quiet_s: float = 0.15, timeout_s: float = 1.0) -> None:
        """Wait until no link has opened or closed for `quiet_s` seconds, at most `timeout_s`.

        A session opens with the first process that it finds; one that asks who is there, waits
        for the others too.
        """
        changed = threading.Event()
        watch = self.watch_links(changed.set)
        deadline = time.monotonic() + timeout_s
        while changed.wait(min(quiet_s, max(deadline - time.monotonic(), 0.0))):
            changed.clear()
            if time.monotonic() >= deadline:
                break
        watch.close()

    def routers(self) -> list[str]:
        """The ids of the routers that the session is connected to."""
        with bus_errors("list the routers"):
            return [str(zid) for zid in self.zenoh.info.routers_zid()]

    def watch_links(self, callback: Callable[[], None]) -> Declaration:
        """Call `callback()` whenever a link to another process opens or closes."""
        with bus_errors("watch links"):
            guarded = self._guarded("link", lambda _: callback())
            listener = self.zenoh.info.declare_transport_events_listener(direct(guarded))
            return Declaration(listener)

    def sample_callback(self, key: str, callback: Callable[[str, bytes], None]) -> Any:
        """`callback(key, payload)` as Zenoh wants it, with its exceptions caught and reported."""

        report = self._reporter(f"message of {key}")

        # As `direct` and `_guarded` would have it, in one call instead of three: they take their
        # time where messages come one by one.
        def on_sample(sample: zenoh.Sample) -> None:
            kept.known = True
            try:
                callback(str(sample.key_expr), sample.payload.to_bytes())
            except Exception:
                report()

        return zenoh.handlers.Callback(on_sample, None, indirect=False)

    def _guarded(self, what: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        report = self._reporter(what)

        def guarded(event: Any) -> None:
            try:
                callback(event)
            except Exception:
                report()

        return guarded

    def _reporter(self, what: str) -> Callable[[], None]:
        """What reports the first of the exceptions that it is called for."""
        failures = 0

        def report() -> None:
            nonlocal failures
            failures += 1
            if failures == 1 and not self._closed:
                self._log.exception("Could not handle the %s; this is said once", what)

        return report


def _towards(settings: NodeSettings) -> str:
    return f" through {', '.join(settings.connect)}" if settings.connect else ""


def _at(settings: NodeSettings) -> str:
    return f" at {' or '.join(settings.connect)}" if settings.connect else " on this network"


def within(key: str, expression: str) -> bool:
    """Whether the key lies within the key expression."""
    return zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))
