"""Callbacks for Zenoh: our callbacks, their exceptions logged, on threads whose state Python keeps.

Python makes a thread state when a foreign thread calls in, and throws it away when the call ends.
That takes several times as long as all the rest: of a message received from Zenoh 11.1 us of CPU,
against 2.7 us if the state is kept.
"""

import ctypes
import itertools
import logging
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import zenoh

from tfbus.base.bounded import Bounded
from tfbus.base.log import LogOnce
from tfbus.base.signals import interrupt_again
from tfbus.base.wording import printable
from tfbus.wire.limits import DEFAULT_LIMITS, Limits, kind_of, kind_of_query, size_text

# Takes the key of a sample, and its payload.
OnSample = Callable[[str, bytes], None]

# Takes also the id of the session that it is from; "" if it does not say.
OnSignedSample = Callable[[str, bytes, str], None]

# Takes the key of a token, a name or an id, and whether it is there now.
OnToken = Callable[[str, bool], None]

# At most as many threads are kept; Zenoh has a few that live as long as the process.
_MOST_KEPT = 64

# A sender may make up keys: beyond this number they are judged again.
_MOST_KEYS = 10_000


class StrayKeys:
    """Tells the keys that a closed bus does not take: all keys not within `expression`.

    Zenoh lets a message in if the sender's rights include its key, which may be a key expression
    of many: a peer that may publish `*` but not `clock` would reach the subscribers of `clock` by
    `*`. And an answer may come at any key that its sender may answer at. The first is logged.
    """

    def __init__(self, expression: str, once: LogOnce) -> None:
        self._expression = zenoh.KeyExpr.autocanonize(expression)
        self._once = once
        self._within: Bounded[str, None] = Bounded(_MOST_KEYS)

    def __call__(self, key: str) -> bool:
        """Whether a key is one of them."""
        if key in self._within:
            return False
        if "*" in key or not self._expression.includes(zenoh.KeyExpr(key)):
            self._once.warning(
                ("stray", str(self._expression)),
                "Refused a message at %r: only those at one key within %r are taken",
                printable(key),
                printable(str(self._expression)),
            )
            return True
        self._within[key] = None
        return False


class Callbacks:
    """The callbacks of one session, as Zenoh takes them.

    Zenoh swallows the exceptions of its callbacks: here the first of each callback is logged.
    After `mute()` none is. Messages larger than the limit of their kind reach no callback: the
    first that a callback misses is logged, and `too_large` counts them by the key or key expression
    of their subscription. On a closed bus neither do messages and answers at stray keys: see
    `StrayKeys`.
    """

    def __init__(
        self,
        log: logging.Logger,
        limits: Limits = DEFAULT_LIMITS,
        *,
        is_closed: bool = False,
    ) -> None:
        self.too_large: Counter[str] = Counter()
        self._limits = limits
        self._is_closed = is_closed
        self._once = LogOnce(log)
        self._is_muted = False

    def mute(self) -> None:
        """Log no further exceptions: the session ends, and all that callbacks use with it."""
        self._is_muted = True

    def of_samples(self, key: str, callback: OnSample) -> tuple[Any, "DroppedSamples"]:
        """A handler of Zenoh's that calls `callback(key, payload)` for each sample, and counts the
        samples that it drops unread.
        """
        report = self._reporter(f"message of {key}")
        most = self._limits.limit_of(kind_of(key))
        dropped = DroppedSamples(self, key)
        drop = dropped.drop
        is_stray = self.strays(key)

        # The work of `direct` and `guarded`, in one call instead of three: if messages come one
        # by one, the calls take their time.
        def on_sample(sample: zenoh.Sample) -> None:
            kept.known = True
            try:
                payload: Any = sample.payload
                size = len(payload)
                if size > most:
                    drop(sample, size)
                    return
                name = str(sample.key_expr)
                if is_stray is None or not is_stray(name):
                    callback(name, payload.to_bytes())
            except Exception:
                report()
            except KeyboardInterrupt:
                interrupt_again()

        return zenoh.handlers.Callback(on_sample, None, indirect=False), dropped

    def strays(self, expression: str) -> "StrayKeys | None":
        """The key expression that keys have to be within, on a closed bus; None on an open one."""
        return StrayKeys(expression, self._once) if self._is_closed else None

    def drop(self, first: object, key: str, size: int, why: str) -> None:
        """Log that a message was dropped unread, once for each object `first`."""
        self._once.warning(
            first, "Dropped a message of %s on %r unread: %s", size_text(size), printable(key), why
        )

    def mistake_in_answer(self, key: str, size: int) -> str:
        """Why an answer of this size to a query of `key` is not read, "" if it is; the first of
        a kind is logged, and `too_large` counts them by kind.
        """
        kind = kind_of_query(key)
        mistake = self._limits.mistake_in(kind, size)
        if mistake:
            self.too_large[kind] += 1
            self._once.warning(kind, "Dropped an answer to %r unread: %s", printable(key), mistake)
        return mistake

    def of_signed_samples(self, key: str, callback: OnSignedSample) -> Any:
        """As `of_samples`; `callback(key, payload, sender)` also gets the id of the session that
        the sample is from, "" if it does not say. Retained samples do.
        """
        most = self._limits.limit_of(kind_of(key))
        drop = DroppedSamples(self, key).drop
        is_stray = self.strays(key)

        def on_sample(sample: zenoh.Sample) -> None:
            size = len(sample.payload)
            if size > most:
                drop(sample, size)
                return
            name = str(sample.key_expr)
            if is_stray is not None and is_stray(name):
                return
            source = sample.source_info
            sender = "" if source is None else str(source.source_id.zid)
            callback(name, sample.payload.to_bytes(), sender)

        return direct(self.guarded(f"message of {key}", on_sample))

    def guarded(self, what: str, callback: Callable[[Any], object]) -> Callable[[Any], None]:
        """The callback, which raises nothing: its first exception is logged, with `what` it is."""
        report = self._reporter(what)

        def call(event: Any) -> None:
            try:
                callback(event)
            except Exception:
                report()

        return call

    def _reporter(self, what: str) -> Callable[[], None]:
        # A key may have several callbacks.
        kind = object()

        def report() -> None:
            if not self._is_muted:
                self._once.exception(kind, "Could not handle the %s", what)

        return report


class DroppedSamples:
    """The samples of one subscription that were too large, and so dropped unread."""

    def __init__(self, callbacks: Callbacks, key: str) -> None:
        self.count = 0
        self._callbacks = callbacks
        self._key = key

    def drop(self, sample: zenoh.Sample, size: int) -> None:
        """Count a sample, and log the first."""
        callbacks, key = self._callbacks, self._key
        self.count += 1
        callbacks.too_large[key] += 1
        why = callbacks._limits.mistake_in(kind_of(key), size)
        callbacks.drop(self, str(sample.key_expr), size, why)


def direct(callback: Callable[[Any], None], drop: Callable[[], None] | None = None) -> Any:
    """A handler of Zenoh's that calls back on Zenoh's own thread.

    By default zenoh-python starts a thread for each callback, which now and then outlives its
    session and then keeps the process from ending. Ours only decode and store, or hand over to
    the node's thread, so one that falls behind holds up its own link, not the memory.
    """

    def call(event: Any) -> None:
        kept.known = True
        try:
            callback(event)
        except KeyboardInterrupt:
            # Zenoh calls on the thread that declares, too, for tokens that it knows already.
            interrupt_again()

    return zenoh.handlers.Callback(call, drop, indirect=False)


class _Thread(threading.local):
    """Keeps the Python state of the thread that makes it."""

    known = False
    _kept = itertools.count()

    def __init__(self) -> None:
        if next(self._kept) < _MOST_KEPT:
            # Python drops a thread's state when the last `Ensure` is released: this never is.
            ctypes.pythonapi.PyGILState_Ensure()


# Setting `kept.known` makes the _Thread of the current thread, the first time in each thread.
kept = _Thread()
