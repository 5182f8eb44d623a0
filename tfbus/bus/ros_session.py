"""A session in ROS's own Zenoh network, beside that of the bus: no namespace, other keys."""

import atexit
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

import zenoh

from tfbus.bus import forks
from tfbus.bus.callbacks import direct, kept
from tfbus.bus.handles import Declaration, HeardWatch
from tfbus.bus.retained import declare_caching_publisher, declare_history_subscriber
from tfbus.bus.ros_config import LARGEST, ros_config, where
from tfbus.bus.zenoh_errors import as_bus_error, first_sentence, is_router_missing
from tfbus.bus.zenoh_threads import configure_zenoh_threads
from tfbus.errors import BusError
from tfbus.runtime.log_once import LogOnce
from tfbus.wire.limits import size_text
from tfbus.wording import printable

# A router that does not answer is tried again after this time.
_RETRY_S = 0.5
# A router that neither answers nor refuses, as on a host that is unplugged, is missed after this.
_SILENT_AFTER_S = 3.0
# A try that hangs is waited for at the end, at most for this long.
_CLOSING_S = 10.0

# A subscriber asks each session for as many messages as it takes to have those of all its
# publishers: Zenoh counts per session.
_PUBLISHERS_OF_A_SESSION = 1000

# After a lost link is back, what was retained meanwhile is asked for and sent again. Zenoh asks for
# it itself, but as soon as it knows of a publisher, when the router does not yet know that it
# answers. ROS tries its router every 4 s at the latest.
_REFRESHING_S = (1.0, 6.0)

# payload, attachment or None, and what `sender_of` takes
OnSample = Callable[[bytes, bytes | None, Any], None]
OnToken = Callable[[str, bool], None]

_HOW_TO_START = (
    "start one with: ros2 run rmw_zenoh_cpp rmw_zenohd; ROS with Fast DDS (its default) or "
    "Cyclone DDS is reached by --via dds"
)


def sender_of(sample: zenoh.Sample) -> str:
    """The id of the session that a message is from, "" if it does not say."""
    if (source := sample.source_info) is not None:
        return str(source.source_id.zid)
    # ROS's sessions put their own clocks' times on what they send.
    return "" if sample.timestamp is None else str(sample.timestamp.get_id())


class _Part(Protocol):
    """A declaration of a session, now or as soon as it opens."""

    def declare(self, session: zenoh.Session) -> None: ...

    def undeclare(self) -> None: ...

    def refresh(self, session: zenoh.Session) -> None:
        """Make up for what was missed while there was no link."""


class RosSession:
    """A session in ROS's Zenoh network, until `close()`.

    It opens in the background, and tries until a router answers; what is declared before that is
    declared then. If the router is gone, Zenoh finds it again when it is back.
    """

    def __init__(self, endpoints: Sequence[str], log: logging.Logger) -> None:
        """Begin to open it; `endpoints` as `ros_config` takes them. Raises SettingsError for wrong
        ones, BusError in a fork of a process that had joined a bus.
        """
        forks.begin()
        configure_zenoh_threads()
        zenoh.try_init_log_from_env()
        # Chosen here, so that tokens can be told before it is open. Without a leading zero, as
        # Zenoh wants it.
        self.id = f"a{os.urandom(15).hex()}"
        self._config = ros_config(endpoints, self.id)
        self.where = where(self._config)
        self.zenoh: Any = None
        self._log = log
        self._once = LogOnce(log)
        # What is the matter while it has no link, and whether it ever had none.
        self._why = ""
        self._has_missed = False
        self._lock = threading.Lock()
        self._parts: list[_Part] = []
        self._closing = threading.Event()
        self._started_s = time.monotonic()
        self._links: set[str] = set()
        self._had_links = False
        self._timers: list[threading.Timer] = []
        self._link_watch: Declaration | None = None
        forks.holders.add(self, "zenoh")
        atexit.register(self._end_with_process)
        self._opener = threading.Thread(target=self._open, name="tfbus-ros", daemon=True)
        self._opener.start()

    @property
    def is_linked(self) -> bool:
        """Whether it has a link to the router, or to another process."""
        return bool(self._links)

    @property
    def trouble(self) -> str:
        """Why it has no link, in a sentence; "" if it has one, or has just begun to try."""
        if self.is_linked:
            return ""
        if not self._why and time.monotonic() >= self._started_s + _SILENT_AFTER_S:
            self._miss()
        return self._why

    def _missing(self) -> str:
        return (
            f"No Zenoh router of ROS answers at {self.where}, tried until one does: {_HOW_TO_START}"
        )

    # Opening

    def _open(self) -> None:
        while not self._closing.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError as error:
                # A router that is just being started is no matter.
                if time.monotonic() >= self._started_s + 2 * _RETRY_S:
                    self._miss(error)
                self._closing.wait(_RETRY_S)
            else:
                self._begin(session)
                # A peer opens without a router.
                self._closing.wait(2 * _RETRY_S)
                if not self.is_linked and not self._closing.is_set():
                    self._miss()
                return

    def _miss(self, error: zenoh.ZError | None = None) -> None:
        self._why = self._missing()
        if error is not None and not is_router_missing(error):
            reason = printable(first_sentence(str(error)))
            self._why = f"Could not join ROS at {self.where}: {reason}"
        self._has_missed = True

    def _begin(self, session: zenoh.Session) -> None:
        with self._lock:
            if self._closing.is_set():
                session.close()
                return
            self.zenoh = session
            for part in self._parts:
                self._declare_now(part)
        handler = direct(self._on_link)
        listener = session.info.declare_transport_events_listener(handler, history=True)
        self._link_watch = Declaration(listener)

    def _on_link(self, event: zenoh.TransportEvent) -> None:
        was_linked, name = bool(self._links), str(event.transport.zid)
        if event.kind == zenoh.SampleKind.PUT:
            self._links.add(name)
        else:
            self._links.discard(name)
        if was_linked == bool(self._links) or self._closing.is_set():
            return
        if was_linked:
            self._log.warning("Lost the Zenoh router of ROS at %s. Trying on", self.where)
            self._has_missed = True
            self._why = self._missing()
            return
        if self._has_missed:
            self._log.info("Joined ROS at %s", self.where)
        if self._had_links:
            self._refresh_later()
        self._had_links = True

    def _refresh_later(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers = [threading.Timer(after_s, self._refresh) for after_s in _REFRESHING_S]
        for timer in self._timers:
            timer.daemon = True
            timer.start()

    def _refresh(self) -> None:
        with self._lock:
            if not self._closing.is_set() and not forks.is_lost():
                for part in self._parts:
                    with suppress(zenoh.ZError):
                        part.refresh(self.zenoh)

    def _declare_now(self, part: _Part) -> None:
        try:
            part.declare(self.zenoh)
        except zenoh.ZError as error:
            self._log.error("%s", as_bus_error("declare in ROS", error))

    def _declare(self, part: _Part) -> None:
        forks.check()
        with self._lock:
            if self._closing.is_set():
                raise BusError("the session in ROS is closed")
            if self.zenoh is not None:
                try:
                    part.declare(self.zenoh)
                except zenoh.ZError as error:
                    raise as_bus_error("declare in ROS", error) from error
            self._parts.append(part)

    def end(self, part: _Part) -> None:
        """End what was declared; twice is fine."""
        with self._lock, suppress(ValueError):
            self._parts.remove(part)
        part.undeclare()

    # Declaring

    def publication(self, key: str, *, retained: int = 0) -> "Publication":
        """Publish on a key. The last `retained` messages also reach late joiners."""
        publication = Publication(key, retained)
        self._declare(publication)
        return publication

    def subscription(self, key: str, callback: OnSample, *, retained: bool = False) -> _Part:
        """Call `callback(payload, attachment, sample)` for each message of another session; with
        `retained` also for those that publishers keep for late joiners. From any thread of
        Zenoh's, at times from several at once.
        """
        subscription = _Subscription(key, self._on_sample(key, callback), retained)
        self._declare(subscription)
        return subscription

    def token(self, key: str) -> _Part:
        """Declare that `key` is alive for as long as this session is."""
        token = _Token(key)
        self._declare(token)
        return token

    def watch_tokens(self, key: str, callback: OnToken) -> _Part:
        """Call `callback(key, alive)` for each token within the key expression, also those of this
        session, and at each change: if the router is gone, so are they.
        """
        watch = _TokenWatch(key, self._on_token(key, callback))
        self._declare(watch)
        return watch

    def _on_sample(self, key: str, callback: OnSample) -> Callable[[zenoh.Sample], None]:
        kind = object()

        def on_sample(sample: zenoh.Sample) -> None:
            kept.known = True
            try:
                payload: Any = sample.payload
                if len(payload) > LARGEST:
                    self._drop_large(key, len(payload))
                    return
                attachment: Any = sample.attachment
                if attachment is not None:
                    attachment = attachment.to_bytes()
                callback(payload.to_bytes(), attachment, sample)
            except Exception:
                self._report(kind, f"message of {key}")

        return on_sample

    def _on_token(self, key: str, callback: OnToken) -> Callable[[zenoh.Sample], None]:
        kind = object()

        def on_token(sample: zenoh.Sample) -> None:
            kept.known = True
            try:
                callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)
            except Exception:
                self._report(kind, f"token of {key}")

        return on_token

    def _report(self, kind: object, what: str) -> None:
        if not self._closing.is_set():
            self._once.exception(kind, "Could not handle the %s", what)

    def _drop_large(self, key: str, size: int) -> None:
        self._once.warning(
            ("large", key),
            "Dropped a message of %s on %r unread: at most %s are read from ROS",
            size_text(size),
            printable(key),
            size_text(LARGEST),
        )

    # Closing

    def close(self) -> None:
        """Leave ROS: every declaration of the session ends. Twice is fine."""
        if self._closing.is_set() or forks.is_lost():
            return
        self._closing.set()
        atexit.unregister(self._end_with_process)
        self._opener.join(_CLOSING_S)
        if self._link_watch is not None:
            self._link_watch.close()
        for timer in self._timers:
            timer.cancel()
        with self._lock:
            parts, self._parts = self._parts, []
        # Tokens first: Zenoh may leave a link open that began while it closed.
        for part in reversed(parts):
            part.undeclare()
        if self.zenoh is not None:
            try:
                self.zenoh.close()
            except zenoh.ZError as error:
                self._log.warning(
                    "The session in ROS did not close cleanly: %s", first_sentence(str(error))
                )

    def _end_with_process(self) -> None:
        # Zenoh's threads that return into an interpreter that shuts down abort the process.
        if not forks.is_lost():
            self.close()


class Publication:
    """Publishes on a key; made by a session. Messages from before it opens are lost, but for the
    last ones of what is retained.
    """

    def __init__(self, key: str, retained: int) -> None:
        self._key = key
        self._retained = retained
        self._lock = threading.Lock()
        self._kept: deque[tuple[bytes, bytes]] = deque(maxlen=retained)
        self._publisher: Any = None
        self._watch: HeardWatch | None = None
        self._ended = False
        forks.holders.add(self, "_publisher")

    def declare(self, session: zenoh.Session) -> None:
        """Declare it in the open session."""
        remote = zenoh.Locality.REMOTE
        drop = zenoh.CongestionControl.DROP
        watched = publisher = session.declare_publisher(
            self._key, congestion_control=drop, allowed_destination=remote
        )
        with self._lock:
            self._watch = HeardWatch(watched)
            self._publisher = publisher
            if self._retained:
                self._publisher = declare_caching_publisher(session, self._key, self._retained)
            self._put_kept()

    def refresh(self, session: zenoh.Session) -> None:
        """Send again what is retained."""
        with self._lock:
            self._put_kept()

    def _put_kept(self) -> None:
        if self._publisher is not None:
            for payload, attachment in self._kept:
                self._publisher.put(payload, attachment=attachment)

    @property
    def heard(self) -> bool:
        """Whether another session subscribes to the key."""
        return self._watch is not None and self._watch.heard

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send one message. Raises BusError if it is closed."""
        with self._lock:
            if self._ended:
                raise BusError(f"could not publish {self._key}: it is closed")
            if self._retained:
                self._kept.append((payload, attachment))
            if self._publisher is None:
                return
            try:
                self._publisher.put(payload, attachment=attachment)
            except zenoh.ZError as error:
                raise as_bus_error(f"publish {self._key}", error) from error

    def undeclare(self) -> None:
        """End it; twice is fine."""
        with self._lock:
            publisher, self._publisher = self._publisher, None
            self._ended = True
        if publisher is not None and not forks.is_lost():
            with suppress(zenoh.ZError):
                publisher.undeclare()
        if self._watch is not None:
            self._watch.close()


class _Held:
    """A declaration of a session; it ends once, also if the session never opened."""

    def __init__(self, key: str) -> None:
        self.key = key
        self._declared: Declaration | None = None

    def hold(self, declared: Any) -> None:
        """Keep what was declared, in the place of what was before."""
        former, self._declared = self._declared, Declaration(declared)
        if former is not None:
            former.close()

    def refresh(self, session: zenoh.Session) -> None:
        """It misses nothing."""

    def undeclare(self) -> None:
        """End it; twice is fine."""
        if self._declared is not None:
            self._declared.close()


class _Subscription(_Held):
    def __init__(self, key: str, on_sample: Callable[[zenoh.Sample], None], retained: bool) -> None:
        super().__init__(key)
        self._on_sample = on_sample
        self._retained = retained

    def declare(self, session: zenoh.Session) -> None:
        handler = zenoh.handlers.Callback(self._on_sample, None, indirect=False)
        if self._retained:
            most = _PUBLISHERS_OF_A_SESSION
            self.hold(declare_history_subscriber(session, self.key, most, handler))
        else:
            remote = zenoh.Locality.REMOTE
            self.hold(session.declare_subscriber(self.key, handler, allowed_origin=remote))

    def refresh(self, session: zenoh.Session) -> None:
        """Ask publishers again for what they retain."""
        if self._retained:
            self.declare(session)


class _Token(_Held):
    def declare(self, session: zenoh.Session) -> None:
        self.hold(session.liveliness().declare_token(self.key))


class _TokenWatch(_Held):
    def __init__(self, key: str, on_token: Callable[[zenoh.Sample], None]) -> None:
        super().__init__(key)
        self._on_token = on_token

    def declare(self, session: zenoh.Session) -> None:
        handler = zenoh.handlers.Callback(self._on_token, None, indirect=False)
        self.hold(session.liveliness().declare_subscriber(self.key, handler, history=True))
