"""A session in ROS's own Zenoh network, beside the bus's: no namespace, other keys, and the
configuration of ROS itself, or of a client.
"""

import json
import logging
import os
import re
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

import zenoh

from tfbus.base import scheduler
from tfbus.base.errors import BusError, SettingsError
from tfbus.base.wording import printable
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import Callbacks, OnToken, direct
from tfbus.bus.network_session import RETRY_S, Declaration, HeardWatch, NetworkSession
from tfbus.bus.retained import declare_caching_publisher, declare_history_subscriber
from tfbus.bus.settings import check_endpoint
from tfbus.bus.zenoh_library import bus_errors, first_sentence, is_router_missing
from tfbus.wire.limits import size_text

# Where rmw_zenoh has its router.
_ROUTER = "tcp/localhost:7447"

# Before an endpoint: link to other processes as well, as ROS's own do, instead of to it alone.
_PEER = "peer:"

# A router that does not answer within this time is tried again.
_OPEN_TIMEOUT_MS = 5000

# As Zenoh names mistakes in JSON.
_MESSAGE = re.compile(r'msg: "(.*?)"')

# Larger messages are not read.
_LARGEST = 16 << 20

# A router that neither answers nor refuses, as on a host that is unplugged, is missed after this.
_SILENT_AFTER_S = 3.0
# A try that hangs is waited for at the end, at most for this long.
_CLOSING_S = 10.0

# A subscriber asks each session for as many messages as all of its publishers keep: Zenoh counts
# per session.
_PUBLISHERS_OF_A_SESSION = 1000

# After a lost link is back, messages retained meanwhile are asked for and sent again. Zenoh asks
# for them itself, but as soon as it knows of a publisher, when the router does not yet know that it
# answers. ROS tries its router every 4 s at the latest.
_REFRESHING_S = (1.0, 6.0)

# payload, attachment or None, and the sample, as `sender_of` takes it
OnSample = Callable[[bytes, bytes | None, Any], None]
P = TypeVar("P", bound="_Part")

_HOW_TO_START = (
    "start one with: ros2 run rmw_zenoh_cpp rmw_zenohd; ROS with Fast DDS (its default) or "
    "Cyclone DDS is reached by --via dds"
)


def sender_of(sample: zenoh.Sample) -> str:
    """The id of the session that a message is from, "" if it does not say."""
    if (source := sample.source_info) is not None:
        return str(source.source_id.zid)
    # ROS's sessions put their own clocks' times on their messages.
    return "" if sample.timestamp is None else str(sample.timestamp.get_id())


class _Part:
    """A declaration that a session makes once it is open, and that ends once."""

    def __init__(self, declare: Callable[[], Declaration], *, again: bool = False) -> None:
        self._declare = declare
        self._again = again
        self._declared: Declaration | None = None

    def declare(self) -> None:
        """Declare it in the open session, in the place of a former declaration."""
        former, self._declared = self._declared, self._declare()
        if former is not None:
            former.close()

    def refresh(self) -> None:
        """Make up for messages missed while there was no link."""
        if self._again:
            self.declare()

    def undeclare(self) -> None:
        """End it; twice is fine, also if the session never opened."""
        if self._declared is not None:
            self._declared.close()


class RosSession(NetworkSession):
    """A session in ROS's Zenoh network, until `close()`.

    It opens in the background, and tries until a router answers; earlier declarations are made
    then. If the router is gone, Zenoh finds it again when it is back.
    """

    def __init__(self, endpoints: Sequence[str], log: logging.Logger) -> None:
        """Begin to open it; `endpoints` as `_config_of` takes them. Raises SettingsError for wrong
        ones, BusError in a fork of a process that had joined a bus.
        """
        super().__init__(log, Callbacks(log))
        # Chosen here, so that tokens can be told before it is open. Without a leading zero, as
        # Zenoh wants it.
        self.id = f"a{os.urandom(15).hex()}"
        self._config = _config_of(endpoints, self.id)
        self.where = _where(self._config)
        # The matter while it has no link, and whether it ever had none.
        self._why = ""
        self._has_missed = False
        self._lock = scheduler.Lock()
        self._parts: list[_Part] = []
        self._started_s = scheduler.monotonic()
        self._links: set[str] = set()
        self._had_links = self._has_begun = False
        self._timers: list[scheduler.Timer] = []
        self._end_with_python()
        self._opener = scheduler.Thread(target=self._join, name="tfbus-ros", daemon=True)
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
        if not self._why and scheduler.monotonic() >= self._started_s + _SILENT_AFTER_S:
            self._miss()
        return self._why

    def _missing(self) -> str:
        return (
            f"No Zenoh router of ROS answers at {self.where}, tried until one does: {_HOW_TO_START}"
        )

    # Opening

    def _join(self) -> None:
        with suppress(BusError):  # it is closed meanwhile
            self._open(partial(zenoh.open, self._config))
            self._begin()
            # A peer opens without a router.
            if not self._closing.wait(2 * RETRY_S) and not self.is_linked:
                self._miss()

    def _miss(self, error: zenoh.ZError | None = None) -> None:
        # A router that is just being started is no matter.
        if error is not None and scheduler.monotonic() < self._started_s + 2 * RETRY_S:
            return
        self._why = self._missing()
        if error is not None and not is_router_missing(error):
            reason = printable(first_sentence(str(error)))
            self._why = f"Could not join ROS at {self.where}: {reason}"
        self._has_missed = True

    def _begin(self) -> None:
        with self._lock:
            self._has_begun = True
            for part in self._parts:
                try:
                    part.declare()
                except BusError as error:
                    self._log.error("%s", error)
        self.watch_processes(self._on_link)

    def _on_link(self, process: zenoh.Transport, linked: bool) -> None:
        was_linked = self.is_linked
        if linked:
            self._links.add(str(process.zid))
        else:
            self._links.discard(str(process.zid))
        if was_linked == self.is_linked or self._closing.is_set():
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
        self._timers = [scheduler.Timer(after_s, self._refresh) for after_s in _REFRESHING_S]
        for timer in self._timers:
            timer.daemon = True
            timer.start()

    def _refresh(self) -> None:
        with self._lock:
            if not self._closing.is_set() and not zenoh_library.is_lost_by_fork():
                for part in self._parts:
                    with suppress(BusError):
                        part.refresh()

    # Declaring

    def publication(self, key: str, *, retained: int = 0) -> "Publication":
        """Publish on a key. The last `retained` messages also reach late joiners."""
        publication = Publication(self, key, retained)
        self._add(publication)
        return publication

    def subscription(self, key: str, callback: OnSample, *, retained: bool = False) -> _Part:
        """Call `callback(payload, attachment, sample)` for each message of another session; with
        `retained` also for messages that publishers keep for late joiners. From any thread of
        Zenoh's, at times from several at once.
        """
        handler = direct(self.callbacks.guarded(f"message of {key}", self._reader(key, callback)))

        def declare() -> Declaration:
            with self._errors(f"subscribe to {key}"):
                if retained:
                    most = _PUBLISHERS_OF_A_SESSION
                    return Declaration(declare_history_subscriber(self.zenoh, key, most, handler))
                remote = zenoh.Locality.REMOTE
                return Declaration(
                    self.zenoh.declare_subscriber(key, handler, allowed_origin=remote)
                )

        # Publishers are queried again for their retained messages.
        return self._add(_Part(declare, again=retained))

    def token_when_open(self, key: str) -> _Part:
        """Declare that `key` is alive for as long as this session is."""
        return self._add(_Part(partial(self.token, key)))

    def watch_living_when_open(self, key: str, callback: OnToken) -> _Part:
        """Call `callback(key, alive)` for each token within the key expression, also of this
        session, and at each change: if the router is gone, so are they.
        """
        return self._add(_Part(partial(self.watch_living, key, callback)))

    def _add(self, part: P) -> P:
        """Declare a part now, or as soon as it opens."""
        zenoh_library.check_not_forked()
        with self._lock:
            if self._closing.is_set():
                raise BusError("the session in ROS is closed")
            if self._has_begun:
                part.declare()
            self._parts.append(part)
        return part

    def end(self, part: _Part) -> None:
        """End its declaration; twice is fine."""
        with self._lock, suppress(ValueError):
            self._parts.remove(part)
        part.undeclare()

    def _reader(self, key: str, callback: OnSample) -> Callable[[zenoh.Sample], None]:
        first = object()

        def on_sample(sample: zenoh.Sample) -> None:
            payload: Any = sample.payload
            if len(payload) > _LARGEST:
                why = f"at most {size_text(_LARGEST)} are read from ROS"
                self.callbacks.drop(first, key, len(payload), why)
                return
            attachment: Any = sample.attachment
            if attachment is not None:
                attachment = attachment.to_bytes()
            callback(payload.to_bytes(), attachment, sample)

        return on_sample

    def _end(self) -> None:
        self._opener.join(_CLOSING_S)
        for timer in self._timers:
            timer.cancel()
        with self._lock:
            parts, self._parts = self._parts, []
        # Tokens first: Zenoh may leave a link open that began while it closed.
        for part in reversed(parts):
            part.undeclare()


class Publication(_Part):
    """Publishes on a key; made by a session. Messages from before it opens are lost, but for the
    last ones of a retained publisher.
    """

    def __init__(self, session: NetworkSession, key: str, retained: int) -> None:
        self._session = session
        self._key = key
        self._retained = retained
        self._lock = scheduler.Lock()
        self._kept: deque[tuple[bytes, bytes]] = deque(maxlen=retained)
        self._publisher: Any = None
        self._watch: HeardWatch | None = None
        self._ended = False
        zenoh_library.holders.add(self, "_publisher")

    def declare(self) -> None:
        """Declare it in the open session."""
        session = self._session.zenoh
        with bus_errors(f"publish {self._key}"):
            watched = session.declare_publisher(
                self._key,
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )
            with self._lock:
                self._watch = HeardWatch(watched)
                self._publisher = watched
                if self._retained:
                    self._publisher = declare_caching_publisher(session, self._key, self._retained)
                self._put_kept()

    def refresh(self) -> None:
        """Send the retained messages again."""
        with self._lock, bus_errors(f"publish {self._key}"):
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
            with bus_errors(f"publish {self._key}"):
                self._publisher.put(payload, attachment=attachment)

    def undeclare(self) -> None:
        """End it; twice is fine."""
        with self._lock:
            publisher, self._publisher = self._publisher, None
            self._ended = True
        if publisher is not None and not zenoh_library.is_lost_by_fork():
            with suppress(zenoh.ZError):
                publisher.undeclare()
        if self._watch is not None:
            self._watch.close()


def _config_of(endpoints: Sequence[str], session_id: str) -> zenoh.Config:
    """The configuration of a session with this id: a client of the router at one of the endpoints.

    With `peer:` before an endpoint it is a peer, which links to the processes that the router, or
    any of them, tells it of. Without endpoints it is configured as rmw_zenoh is, by
    ZENOH_SESSION_CONFIG_URI, else a client of tcp/localhost:7447; and ZENOH_CONFIG_OVERRIDE goes
    over it. Raises SettingsError for an invalid endpoint or configuration.
    """
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI", "")
    for each in endpoints:
        check_endpoint(each.removeprefix(_PEER))
    values: dict[str, object] = {
        "id": session_id,
        # Late joiners order retained messages by their time.
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": 2 * _LARGEST,
        # Zenoh polls it 30 times a second; ROS then sends by TCP.
        "transport/shared_memory": {"enabled": False},
    }
    if endpoints or not path:
        values |= _linked(endpoints or [_ROUTER])
    what = path or "a configuration of Zenoh"
    try:
        config = zenoh.Config.from_file(path) if path else zenoh.Config()
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
        if not endpoints:
            for key, text in _overrides():
                what = f"ZENOH_CONFIG_OVERRIDE: {key}"
                config.insert_json5(key, text)
    except (zenoh.ZError, OSError) as error:
        raise SettingsError(f"Zenoh does not take {what}: {_reason(error)}") from error
    return config


def _reason(error: Exception) -> str:
    text = first_sentence(str(error)).splitlines()[0]
    said = _MESSAGE.search(text)
    return said[1] if said else text


def _linked(endpoints: Sequence[str]) -> dict[str, object]:
    is_peer = any(each.startswith(_PEER) for each in endpoints)
    return {
        "mode": "peer" if is_peer else "client",
        "connect/endpoints": [each.removeprefix(_PEER) for each in endpoints],
        "listen/endpoints": ["tcp/localhost:0"] if is_peer else [],
        # A peer goes on to try; a client is opened again and again.
        "connect/timeout_ms": {"peer": -1, "client": 0},
        "connect/exit_on_failure": {"peer": False, "client": True},
        # By default 10 s, which a host that is unplugged would hold up the end of the process.
        "transport/unicast/open_timeout": _OPEN_TIMEOUT_MS,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/gossip/autoconnect": {"peer": ["router", "peer"]},
        "scouting/delay": 100,
    }


def _overrides() -> list[tuple[str, str]]:
    """As rmw_zenoh reads them: `mode="client";connect/endpoints=["tcp/robot:7447"]`."""
    pairs = []
    for part in os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";"):
        key, is_pair, text = part.strip().partition("=")
        if is_pair:
            pairs.append((key.strip(), text.strip()))
        elif key:
            raise SettingsError(
                f"ZENOH_CONFIG_OVERRIDE has {key!r} without a value: it is KEY=VALUE;KEY=VALUE"
            )
    return pairs


def _where(config: zenoh.Config) -> str:
    """The endpoints that a session with this configuration connects to, in words."""
    mode = json.loads(config.get_json("mode")) or "peer"
    endpoints = json.loads(config.get_json("connect/endpoints"))
    if isinstance(endpoints, dict):
        endpoints = endpoints.get(mode)
    return " or ".join(map(str, endpoints or ())) or "any address"
