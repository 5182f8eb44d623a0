"""The one place that opens Zenoh: a session, in words that the rest of tfbus uses.

Zenoh calls back on threads of its own and swallows exceptions; here they are caught, counted and
reported once. Zenoh's own errors become BusError here and nowhere else.
"""

import atexit
import json
import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import zenoh

from tfbus.errors import BusError, SettingsError, TfbusError
from tfbus.kept_thread import on_kept_thread
from tfbus.scouting import loopback_where_alone
from tfbus.settings import NodeSettings
from tfbus.workers import Workers

# How soon a client looks for its router again.
_RETRY_S = 0.5

# How long a link may be silent before its tokens are lost; Zenoh fills it with four signs of life.
_LEASE_MS = 1500

# So many batches of 64 KiB of urgent messages wait on a link before one is dropped: a burst of
# 10,000 transforms on as many keys lost up to 2,000 of them with Zenoh's two.
_URGENT_BATCHES = 8

# So many answers that may be long are sent at a time, and so many questions wait for that.
_LONG_ANSWERS = 4
_LONG_ANSWERS_WAITING = 64

# What Zenoh itself puts in the place of an answer that has not come in time.
_NO_ANSWER_IN_TIME = b"Timeout"


@dataclass(frozen=True)
class Answer:
    """One answer to a query: its key and payload, or the text of a refusal, "" where it has not
    come in time.
    """

    key: str
    payload: bytes
    refusal: str | None = None


class Query:
    """A question that another process asked; answered as often as wanted, then closed."""

    def __init__(self, query: zenoh.Query):
        self._query = query
        self.key = str(query.key_expr)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def parameter(self, name: str) -> str | None:
        """What the selector `key?name=value` says of this name; None for nothing."""
        return self._query.parameters.get(name)

    def answer(self, key: str, payload: bytes) -> None:
        """Send one answer; `key` lies within the key expression that was asked."""
        with bus_errors(f"answer the query for {self.key}"):
            self._query.reply(key, payload)

    def refuse(self, reason: str) -> None:
        """Answer that this cannot be done, and why."""
        with bus_errors(f"refuse the query for {self.key}"):
            self._query.reply_err(reason.encode())

    @contextmanager
    def answering(self, what: str) -> Iterator[None]:
        """Close the query at the end; an error becomes a refusal that says so."""
        try:
            yield
        except TfbusError as error:
            self.refuse(str(error))
        except Exception as error:
            self.refuse(f"{what} failed ({type(error).__name__}: {error})")
            raise
        finally:
            self.close()

    def close(self) -> None:
        """Tell the asker that no more answers come."""
        self._query.drop()


class Declaration:
    """Something that a session has declared; it ends with the session, or before."""

    def __init__(self, declared: Any):
        self._declared = declared

    def close(self) -> None:
        """End it; twice is fine."""
        with suppress(zenoh.ZError):
            self._declared.undeclare()


class _MatchWatch:
    """Knows at any time whether what a session declared has a counterpart; closed by `close`."""

    def __init__(self, declared: zenoh.Querier | zenoh.Publisher):
        self._matched = threading.Event()
        self._declared = Declaration(declared)
        self._listener = Declaration(
            declared.declare_matching_listener(_direct(lambda status: self._set(status.matching)))
        )
        status: Any = declared.matching_status  # a bool in Zenoh's stubs, but not in Zenoh
        if status.matching:
            self._set(True)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether there is one, waited for at most `timeout_s` (None: for ever)."""
        return self._matched.wait(timeout_s)

    def close(self) -> None:
        """Watch no more."""
        self._listener.close()
        self._declared.close()

    def _set(self, matched: bool) -> None:
        if matched:
            self._matched.set()
        else:
            self._matched.clear()


class ServedWatch(_MatchWatch):
    """Knows at any time whether somebody serves a key; closed when nobody asks any more."""

    @property
    def served(self) -> bool:
        """Whether somebody serves it now."""
        return self._matched.is_set()


class HeardWatch(_MatchWatch):
    """Knows at any time whether somebody subscribes to a key."""

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to it now."""
        return self._matched.is_set()


class BytesPublisher(Declaration):
    """Sends payloads on one key; made by a session or, for retained ones, by tfbus.retained."""

    def __init__(self, key: str, publisher: Any):
        super().__init__(publisher)
        self._key = key

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to its key now."""
        status: Any = self._declared.matching_status  # a bool in Zenoh's stubs, but not in Zenoh
        return bool(status.matching)

    def put(self, payload: bytes) -> None:
        """Send one payload. Raises BusError where the session is closed."""
        try:
            self._declared.put(payload)
        except zenoh.ZError as error:
            raise _as_bus_error(f"publish {self._key}", error) from error


class PublishersWithin:
    """Makes publishers by the thousand.

    Zenoh's own take a time that grows with the square of their number: 10,000 took 3 s. These
    share one of them, which knows whether anybody hears any of the keys.
    """

    def __init__(self, session: zenoh.Session, heard: HeardWatch, priority: zenoh.Priority):
        self._session = session
        self._heard = heard
        self._priority = priority

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to any of the keys now."""
        return self._heard.heard

    def publisher(self, key: str) -> BytesPublisher:
        """A publisher of one key."""
        return BytesPublisher(key, _OneOfMany(self._session, self._heard, key, self._priority))


class _OneOfMany:
    """Stands in for a publisher of Zenoh's."""

    def __init__(
        self, session: zenoh.Session, heard: HeardWatch, key: str, priority: zenoh.Priority
    ):
        self._session = session
        self._heard = heard
        self._key = zenoh.KeyExpr(key)
        self._priority = priority

    def put(self, payload: bytes) -> None:
        if self._heard.heard or self._session.is_closed():
            self._session.put(
                self._key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=self._priority,
            )

    def undeclare(self) -> None:
        """There is nothing of its own to end."""


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
        with bus_errors(f"join the bus{_towards(settings)}"):
            self.zenoh = self._open(zenoh_config(settings, scouting_s), patience_s)
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
                self._log.warning("Left the bus untidily: %s", _first_sentence(str(error)))

    def _end_with_process(self) -> None:
        # Threads of Zenoh's that come back from it into an interpreter that is being taken down
        # abort the process. A child of a fork has none of them, and nothing to close.
        if os.getpid() == self._process:
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
                if not _is_nobody_there(error) or time.monotonic() >= deadline:
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
                priority=_priority(urgent),
            )
        return BytesPublisher(key, publisher)

    def publishers_within(self, expression: str, *, urgent: bool = False) -> "PublishersWithin":
        """Publishers of many keys within a key expression, each as `publisher` makes them."""
        return PublishersWithin(self.zenoh, self.watch_heard(expression), _priority(urgent))

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
            return Declaration(self.zenoh.declare_queryable(key, _direct(guarded_query)))

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
            on_answer(_answer(reply))

        guarded_end = self._guarded(f"end of the answers of {key}", lambda _: on_end())
        with bus_errors(f"ask for {key}"):
            self.zenoh.get(
                key,
                _direct(self._guarded(f"answer of {key}", on_reply), lambda: guarded_end(None)),
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
            keys.put(_answer(reply).key)

        with bus_errors(f"list {key}"):
            self.zenoh.liveliness().get(
                key,
                _direct(on_reply, lambda: keys.put(None)),
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
                self.zenoh.liveliness().declare_subscriber(key, _direct(guarded), history=True)
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
            listener = self.zenoh.info.declare_transport_events_listener(_direct(guarded))
            return Declaration(listener)

    def sample_callback(self, key: str, callback: Callable[[str, bytes], None]) -> Any:
        """`callback(key, payload)` as Zenoh wants it, with its exceptions caught and reported."""

        def on_sample(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.payload.to_bytes())

        return _direct(self._guarded(f"message of {key}", on_sample))

    def _guarded(self, what: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        failures = 0

        def guarded(event: Any) -> None:
            nonlocal failures
            try:
                callback(event)
            except Exception:
                failures += 1
                if failures == 1 and not self._closed:
                    self._log.exception("Could not handle the %s; this is said once", what)

        return guarded


def zenoh_config(settings: NodeSettings, scouting_s: float | None = None) -> zenoh.Config:
    """Zenoh's configuration for these settings: the file's, with what is given put over it.

    `scouting_s` is how long others are looked for before the session opens without any.
    Raises SettingsError where the file is not one.
    """
    config = _config_of(settings.config)
    zenohs_own = zenoh.Config()
    defaults = {
        # Retained messages carry a time, by which late joiners order them.
        "timestamping/enabled": True,
        "scouting/multicast/interface": loopback_where_alone(),
        # A host that was unplugged is noticed after this time; Zenoh's own is 10 s.
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/queue/size/interactive_high": _URGENT_BATCHES,
        # Zenoh looks after it 30 times a second, as much CPU as all else of an idle session.
        "transport/shared_memory": {"enabled": False},
    }
    given: dict[str, Any] = {
        "namespace": settings.namespace,
        "mode": settings.mode,
        "connect/endpoints": list(settings.connect),
        "listen/endpoints": list(settings.listen),
    }
    if scouting_s is not None:
        given["scouting/delay"] = given["scouting/timeout"] = round(scouting_s * 1e3)
    unset = {
        key: value
        for key, value in defaults.items()
        if config.get_json(key) == zenohs_own.get_json(key)
    }
    for key, value in {**unset, **given}.items():
        if value:
            config.insert_json5(key, json.dumps(value))
    return config


def _config_of(path: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(path) if path else zenoh.Config()
    except zenoh.ZError as error:
        # Zenoh draws the place over several lines, the first and the last of which say it all.
        drawn = _first_sentence(str(error)).splitlines()
        reason = ", ".join(dict.fromkeys(line.strip(" =->|") for line in (drawn[0], drawn[-1])))
        raise SettingsError(
            f"{path} is not a configuration of Zenoh, in JSON5: {reason}"
        ) from error


def _direct(callback: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """The callback as Zenoh wants it: called on Zenoh's own thread.

    By default zenoh-python starts a thread for each callback, which now and then outlives its
    session and then keeps the process from ending. Ours only decode and store, or hand over to
    the node's thread, and so one that falls behind holds up its own link, not the memory.
    """
    return zenoh.handlers.Callback(on_kept_thread(callback), drop, indirect=False)


def _priority(urgent: bool) -> zenoh.Priority:
    return zenoh.Priority.INTERACTIVE_HIGH if urgent else zenoh.Priority.DATA


def _answer(reply: zenoh.Reply) -> Answer:
    if reply.ok is not None:
        return Answer(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
    payload = reply.err.payload.to_bytes() if reply.err is not None else b""
    if payload == _NO_ANSWER_IN_TIME:
        payload = b""
    return Answer("", b"", refusal=payload.decode(errors="replace"))


@contextmanager
def bus_errors(doing: str) -> Iterator[None]:
    """Zenoh's errors as BusError that says what could not be done: "publish turtle1/pose"."""
    try:
        yield
    except zenoh.ZError as error:
        raise _as_bus_error(doing, error) from error


def _as_bus_error(doing: str, error: zenoh.ZError) -> BusError:
    return BusError(f"could not {doing}: {_first_sentence(str(error))}")


def _is_nobody_there(error: zenoh.ZError) -> bool:
    """Whether a client could not be opened because no router answers, at its endpoints or, where
    it has none, to its scouting.
    """
    return str(error).startswith(("Unable to connect", "timeout"))


def _first_sentence(text: str) -> str:
    """Zenoh's reason without the places in its source."""
    return text.split(" at /", 1)[0].strip() or text


def _towards(settings: NodeSettings) -> str:
    return f" through {', '.join(settings.connect)}" if settings.connect else ""


def _at(settings: NodeSettings) -> str:
    return f" at {' or '.join(settings.connect)}" if settings.connect else " on this network"


def within(key: str, expression: str) -> bool:
    """Whether the key lies within the key expression."""
    return zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))


def has_scouting(settings: NodeSettings) -> bool:
    """Whether a session with these settings looks for others by multicast."""
    enabled = json.loads(_config_of(settings.config).get_json("scouting/multicast/enabled"))
    is_told_where = settings.mode == "client" and bool(settings.connect)
    return enabled is not False and not is_told_where


def found_by_scouting(settings: NodeSettings, timeout_s: float, *, until: str) -> set[str]:
    """The ids of the peers and routers that scouting finds, ended when `until` is among them."""
    found: set[str] = set()
    is_found = threading.Event()

    def on_hello(hello: zenoh.Hello) -> None:
        found.add(str(hello.zid))
        if until in found:
            is_found.set()

    with bus_errors("look for others by scouting"):
        scout = zenoh.scout(_direct(on_hello), what="peer|router", config=zenoh_config(settings))
    is_found.wait(timeout_s)
    scout.stop()
    return found
