"""Declarations of a session: publishers, and watches of who is at the other end."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import zenoh

from tfbus.bus import zenoh_library
from tfbus.bus.zenoh_library import as_bus_error, direct
from tfbus.errors import BusError
from tfbus.runtime import scheduler
from tfbus.wire.limits import Limits, kind_of

# A publisher that is sending when it ends ends as soon as that is done; or with its session.
_TRY_AGAIN_S = 0.001
_MOST_TRIES = 5000

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


class LivelinessToken(Declaration):
    """A liveliness token; it is in `tokens`, those of its session, until it ends."""

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
    """Sends payloads on one key."""

    def __init__(self, key: str, publisher: Any, limits: Limits, node: str = ""):
        super().__init__(publisher)
        self._node = node
        self._key = key
        self._limits = limits
        self._most = limits.limit_of(kind_of(key))

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
        try:
            self._declared.put(payload)
        except zenoh.ZError as error:
            raise as_bus_error(f"publish {self._key}", error, self._node) from error

    def close(self) -> None:
        """End it; twice is fine, and so are other threads that send by it."""
        declared = self._declared
        if zenoh_library.is_lost_by_fork() or isinstance(declared, _Ended):
            return
        # First, so that no further message begins: Zenoh ends no publisher that is sending.
        self._declared = _Ended()
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
