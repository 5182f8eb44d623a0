"""An open session of Zenoh: tried until it opens, ended once, with Python, or lost in a fork.

The session of a bus and the one in ROS's network are made of it. It declares publishers, and
watches of the processes at the other end.
"""

import atexit
import logging
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cache
from typing import TYPE_CHECKING, Any, Self

import zenoh

from tfbus.base import scheduler
from tfbus.base.errors import BusError
from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import Callbacks, DroppedSamples, OnToken, direct
from tfbus.bus.zenoh_library import (
    as_bus_error,
    bus_errors,
    configure_zenoh_threads,
    first_sentence,
)
from tfbus.wire.limits import Limits, kind_of

if TYPE_CHECKING:
    from tfbus.bus.large_messages import NewestLarge

# A publisher that is sending when it ends ends as soon as that is done; or with its session.
_TRY_AGAIN_S = 0.001
_MOST_TRIES = 5000

# On a bad network most of a message of this size finds no place in the queue of a link: while it
# waits there, others of its priority cannot be sent.
LARGE_BYTES = 16_384

# As Zenoh says it.
UNDECLARED = "Undeclared publisher"


class Declaration:
    """Something that a session has declared; it ends with the session, or by `close()` before."""

    def __init__(self, declared: Any):
        self._declared = declared
        zenoh_library.holders.add(self, "_declared")

    def close(self) -> None:
        """End it; twice is fine. In a forked child it does nothing."""
        with suppress(zenoh.ZError):
            self._declared.undeclare()


class BytesSubscriber(Declaration):
    """A subscriber to messages."""

    def __init__(self, declared: Any, dropped: DroppedSamples):
        super().__init__(declared)
        self._dropped = dropped

    @property
    def too_large(self) -> int:
        """How many messages were too large, and so dropped unread."""
        return self._dropped.count


class LivelinessToken(Declaration):
    """A liveliness token; it is in `tokens`, its session's, until it ends."""

    def __init__(self, declared: zenoh.LivelinessToken, tokens: dict["LivelinessToken", None]):
        super().__init__(declared)
        self._tokens = tokens
        tokens[self] = None

    def close(self) -> None:
        """End it; twice is fine. In a forked child it does nothing."""
        super().close()
        self._tokens.pop(self, None)


class _MatchWatch:
    """Knows at any time whether a declaration has a counterpart."""

    def __init__(self, declared: zenoh.Querier | zenoh.Publisher):
        self._matched = scheduler.Event()
        # Changed by single operations.
        self._wakes: dict[int, Callable[[], object]] = {}
        self._declared = Declaration(declared)
        self._listener = Declaration(
            declared.declare_matching_listener(direct(lambda status: self._set(status.matching)))
        )
        if _is_matched(declared):
            self._set(True)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a counterpart, at most `timeout_s` (None: for ever); whether there is one."""
        zenoh_library.check_not_forked()
        return self._matched.wait(timeout_s)

    @contextmanager
    def waking(self, wake: Callable[[], object]) -> Iterator[None]:
        """Until the end of its `with`, call `wake()` once there is a counterpart, on any thread."""
        zenoh_library.check_not_forked()
        self._wakes[id(wake)] = wake
        try:
            if self._matched.is_set():
                wake()
            yield
        finally:
            del self._wakes[id(wake)]

    def close(self) -> None:
        """End the watch; twice is fine."""
        self._listener.close()
        self._declared.close()

    def _set(self, matched: bool) -> None:
        if matched:
            self._matched.set()
            for wake in list(self._wakes.values()):
                wake()
        else:
            self._matched.clear()


class ServedWatch(_MatchWatch):
    """Knows at any time whether a process serves a key."""

    @property
    def served(self) -> bool:
        """Whether a process serves it now."""
        return self._matched.is_set()


class HeardWatch(_MatchWatch):
    """Knows at any time whether a process subscribes to a key."""

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to it now."""
        return self._matched.is_set()


class BytesPublisher(Declaration):
    """Sends payloads on one key. By `below` they come after those of other keys: by it go all from
    the first one of LARGE_BYTES on, so that none overtakes another of its key.
    """

    def __init__(
        self,
        key: str,
        publisher: Any,
        limits: Limits,
        node: str = "",
        *,
        below: "NewestLarge | None" = None,
    ):
        super().__init__(publisher)
        self._node = node
        self._key = key
        self._limits = limits
        self._most = limits.limit_of(kind_of(key))
        self._below = below
        self._is_large = False

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to its key now."""
        return _is_matched(self._declared)

    def put(self, payload: bytes) -> None:
        """Send one payload.

        Raises BusError if the session is closed, or the payload larger than readers take.
        """
        if len(payload) > self._most:
            mistake = self._limits.mistake_in(kind_of(self._key), len(payload))
            raise BusError(f"could not publish {self._key}: {mistake}")
        put = self._declared.put
        if self._below is not None and not isinstance(self._declared, _Ended):
            self._is_large = self._is_large or len(payload) >= LARGE_BYTES
            put = self._below.put if self._is_large else put
        try:
            put(payload)
        except zenoh.ZError as error:
            raise as_bus_error(f"publish {self._key}", error, self._node) from error

    def close(self) -> None:
        """End it; twice is fine, and so are other threads that send by it."""
        declared = self._declared
        if zenoh_library.is_lost_by_fork() or isinstance(declared, _Ended):
            return
        # First, so that no further message begins: Zenoh ends no publisher that is sending.
        self._declared = _Ended()
        if self._below is not None:
            self._below.close()
        pause = scheduler.Event()
        for _ in range(_MOST_TRIES):
            try:
                with suppress(zenoh.ZError):
                    declared.undeclare()
                return
            except RuntimeError:  # "Already borrowed"
                pause.wait(_TRY_AGAIN_S)


class _Ended:
    """A publisher that has ended."""

    def put(self, payload: bytes) -> None:
        raise zenoh.ZError(UNDECLARED)

    @property
    def matching_status(self) -> Any:
        raise zenoh.ZError(UNDECLARED)


class PublishersWithin:
    """Makes publishers by the thousand.

    Zenoh's own take a time that grows with the square of their number: 10,000 took 3 s. These
    share one watch, which knows whether any of their keys has a subscriber. `how` are Zenoh's
    options of a put.
    """

    def __init__(
        self,
        session: zenoh.Session,
        watch: HeardWatch,
        how: Mapping[str, Any],
        limits: Limits,
        node: str = "",
    ):
        self.session = session
        self._node = node
        self.how = how
        self._watch = watch
        self._limits = limits
        zenoh_library.holders.add(self, "session")

    @property
    def heard(self) -> bool:
        """Whether a process subscribes to any of the keys now."""
        return self._watch.heard

    def close(self) -> None:
        """End the watch; the publishers need no end. Twice is fine."""
        self._watch.close()

    def publisher(self, key: str) -> BytesPublisher:
        """A publisher of one key."""
        return BytesPublisher(key, _OneOfMany(self, key), self._limits, self._node)


class _OneOfMany:
    """Stands in for a publisher of Zenoh's."""

    def __init__(self, publishers: PublishersWithin, key: str):
        self._publishers = publishers
        self._key = zenoh.KeyExpr(key)

    def put(self, payload: bytes) -> None:
        # Where the session is closed, its put raises.
        session = self._publishers.session
        if self._publishers.heard or session.is_closed():
            session.put(
                self._key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                **self._publishers.how,
            )

    def undeclare(self) -> None:
        """It has declared nothing of its own."""


def _is_matched(declared: Any) -> bool:
    status: Any = declared.matching_status  # a bool in Zenoh's stubs, but not in Zenoh
    return bool(status.matching)


# A session that could not open tries again after this time.
RETRY_S = 0.5


class NetworkSession:
    """A session of Zenoh's, until `close()`, the end of its `with`, or Python's.

    A subclass opens it (`_open`), says which errors end that (`_miss`), and ends its own threads
    and watches (`_end`). All callbacks come on threads of Zenoh's; the first exception of each is
    logged. `node` names whose session it is, in errors.
    """

    def __init__(self, log: logging.Logger, callbacks: Callbacks, node: str = "") -> None:
        """Prepare it. Raises BusError in a fork of a process that had joined a bus."""
        zenoh_library.begin_use()
        configure_zenoh_threads()
        zenoh.try_init_log_from_env()
        self.callbacks = callbacks
        self._log = log
        self._node = node
        self.zenoh: zenoh.Session
        self._is_open = False
        self._closing = scheduler.Event()
        self._tokens: dict[LivelinessToken, None] = {}

    def _open(self, open_once: Callable[[], zenoh.Session]) -> None:
        """Open it by `open_once()`, tried again until it opens, or `_miss` raises. Raises BusError
        if it is closed meanwhile.

        Tried here, since neither Ctrl-C nor `close()` interrupts Zenoh's own retry.
        """
        while not self._closing.is_set():
            try:
                opened = open_once()
            except zenoh.ZError as error:
                self._miss(error)
                self._closing.wait(RETRY_S)
                continue
            if self._closing.is_set():
                opened.close()
                break
            self.zenoh, self._is_open = opened, True
            zenoh_library.holders.add(self, "zenoh")
            return
        raise BusError("the session is closed")

    def _miss(self, error: zenoh.ZError) -> None:
        """Take note that it could not open; raises an error that ends the tries."""
        raise error

    def _end_with_python(self) -> None:
        """From now on close with Python."""
        if not scheduler.is_simulated:  # a simulated process ends by itself
            atexit.register(self._close_with_python)
        _end_at_a_signal_once_main_has_ended()

    def _close_with_python(self) -> None:
        # Zenoh's threads that return into an interpreter that shuts down abort the process. A
        # child of a fork has none of them, and nothing to close.
        if not zenoh_library.is_lost_by_fork():
            _end_at_a_signal()
            self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network, within 10 s: every declaration of this session ends. Twice is fine.

        If Zenoh does not close in that time, the log says so. In a callback of Zenoh's it
        returns before that is done. In a forked child it does nothing.
        """
        if self._closing.is_set() or zenoh_library.is_lost_by_fork():
            return
        self._closing.set()
        self.callbacks.mute()
        atexit.unregister(self._close_with_python)
        self._end()
        # Zenoh may open a link while it closes, if it learns of a peer just then. That link
        # stays until the process ends, and its far end would take our tokens for alive.
        for token in tuple(self._tokens):
            token.close()
        if _is_zenohs(scheduler.current_thread()):
            # Zenoh's end waits for this callback, and for 10 s at most. Python's end waits for
            # the thread.
            scheduler.Thread(target=self._close_zenoh, name="end of the session").start()
        else:
            self._close_zenoh()

    def _end(self) -> None:
        """End all that it has beside its declarations."""

    def _close_zenoh(self) -> None:
        try:
            if self._is_open:
                self.zenoh.close()
        except zenoh.ZError as error:
            # As of a peer that has stopped in the middle of a message. The caller could do nothing
            # about an error, and the end of the process ends the session too.
            self._log.warning("Session did not close cleanly: %s", first_sentence(str(error)))

    def _errors(self, doing: str) -> AbstractContextManager[None]:
        """Raise Zenoh's errors as errors of this node."""
        return bus_errors(doing, self._node)

    # Who is alive, and linked

    def token(self, key: str) -> Declaration:
        """Declare that `key` is alive for as long as this session is."""
        with self._errors(f"declare {key}"):
            return LivelinessToken(self.zenoh.liveliness().declare_token(key), self._tokens)

    def watch_living(self, key: str, callback: OnToken) -> Declaration:
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

    def watch_processes(
        self, callback: Callable[[zenoh.Transport, bool], None], *, history: bool = True
    ) -> Declaration:
        """Call `callback(transport, linked)` whenever the link to another process opens or closes;
        with `history` first for open links.
        """

        def on_event(event: zenoh.TransportEvent) -> None:
            callback(event.transport, event.kind == zenoh.SampleKind.PUT)

        with self._errors("watch links"):
            handler = direct(self.callbacks.guarded("link", on_event))
            info = self.zenoh.info
            return Declaration(info.declare_transport_events_listener(handler, history=history))


def _end_at_a_signal() -> None:
    """From here on a signal ends the process at once, without a traceback."""
    with suppress(ValueError):  # this interpreter has no signals
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                signal.signal(number, signal.SIG_DFL)


@cache
def _end_at_a_signal_once_main_has_ended() -> None:
    # Python waits for threads before it calls atexit's functions; a KeyboardInterrupt meanwhile
    # would print a traceback. Its own thread pools end by this function of threading's, too.
    register: Callable[[Callable[[], None]], object]
    register = getattr(threading, "_register_atexit", atexit.register)
    with suppress(RuntimeError):  # main has ended already
        register(_end_at_a_signal)


def _is_zenohs(thread: scheduler.Thread) -> bool:
    """Whether a thread is not Python's own, as the threads are on which callbacks come."""
    return isinstance(thread, threading._DummyThread)
