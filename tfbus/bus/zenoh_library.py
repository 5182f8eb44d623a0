"""Zenoh as a library: its network, errors as ours, callbacks on its threads; it survives no fork.

A forked child has none of Zenoh's threads, so that a new session hangs in it, and it shares with
its parent the file through which Zenoh hears of its sockets: what the child opens or closes takes
the parent's links away. So nothing of Zenoh's is used in such a child, nor ended: what its parent
had is kept for as long as the child lives, and what stands in its place raises BusError.

Python makes a thread state when a foreign thread calls in, and throws it away when the call ends.
That takes several times as long as all the rest: of a message received from Zenoh 11.1 us of CPU,
against 2.7 us if the state is kept.
"""

import ctypes
import itertools
import logging
import os
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Never

import zenoh

from tfbus.errors import BusError
from tfbus.runtime.bounded import Bounded
from tfbus.runtime.log import LogOnce
from tfbus.runtime.signals import interrupt_again
from tfbus.wire.limits import DEFAULT_LIMITS, Limits, kind_of, kind_of_query, size_text
from tfbus.wording import printable

_networks: list[Any] = []


def simulated() -> Any:
    """The simulated network that is in force, with Zenoh's `open_session`, `scout`, its extensions
    `declare_advanced_publisher` and `declare_advanced_subscriber`, and `new_cancellation`; None for
    Zenoh itself.
    """
    return _networks[-1] if _networks else None


def new_cancellation() -> zenoh.CancellationToken:
    """An object whose `cancel()` ends the queries that are made with it."""
    network = simulated()
    return zenoh.CancellationToken() if network is None else network.new_cancellation()


@contextmanager
def replaced_by(network: Any) -> Iterator[None]:
    """Until the end of the `with` sessions join a simulated network."""
    _networks.append(network)
    try:
        yield
    finally:
        _networks.pop()


# Zenoh's default is two threads for all links. Closing the link to a host that no longer answers
# blocks one for 10 s (eclipse-zenoh/zenoh#1101, #2718): if two links of such a host end, nothing is
# received from any other. These are one more than the processes of an unplugged host that may be
# linked to this one: from some thirty on a host needs a router, which is one link. A thread that
# waits takes 20 kB and no CPU.
_RECEIVING = 32


def configure_zenoh_threads() -> None:
    """Let Zenoh receive with 32 threads, unless ZENOH_RUNTIME is set.

    Zenoh reads it once, when its first session opens in this process.
    """
    os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {_RECEIVING}))")


# As Zenoh says it.
_SESSION_CLOSED = "session closed"


@contextmanager
def bus_errors(doing: str, node: str = "") -> Iterator[None]:
    """Raise Zenoh's errors as BusError, and those of a key that UTF-8 cannot hold; `doing` is what
    failed: "publish turtle1/pose". `node` is whose session it is.
    """
    try:
        yield
    except (zenoh.ZError, UnicodeEncodeError) as error:
        raise as_bus_error(doing, error, node) from error


def as_bus_error(doing: str, error: Exception, node: str = "") -> BusError:
    """Zenoh's error as a BusError that says what could not be done."""
    why = first_sentence(str(error))
    if node and why == _SESSION_CLOSED:
        why = f"node {node!r} is closed"
    return BusError(f"could not {printable(doing)}: {why}")


def is_router_missing(error: zenoh.ZError) -> bool:
    """Whether a client could not open because no router answers: at its endpoints or, without
    endpoints, to its scouting.
    """
    return str(error).startswith(("Unable to connect", "timeout"))


def first_sentence(text: str) -> str:
    """Zenoh's reason without the position in its source."""
    return text.split(" at /", 1)[0].strip() or text


_REMEDY = (
    "Zenoh does not survive a fork: start processes by spawn "
    "(multiprocessing.set_start_method('spawn')) or before the first node"
)


class OfParent:
    """Stands in a forked child for an object of Zenoh's that its parent had."""

    def undeclare(self) -> None:
        """The parent ends what it has declared."""

    def __getattr__(self, name: str) -> Never:
        raise BusError(f"this belongs to the process that this one is a fork of, and {_REMEDY}")


class Holders:
    """The objects that hold something of Zenoh's, each in the attribute that it was added with."""

    def __init__(self) -> None:
        self._attribute_of: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()

    def add(self, holder: Any, attribute: str) -> None:
        """Replace this attribute in a forked child."""
        self._attribute_of[holder] = attribute

    def give_up(self) -> None:
        """Replace what all of them hold, which is kept for ever: ending it would harm the
        parent.
        """
        for holder, attribute in list(self._attribute_of.items()):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(getattr(holder, attribute)))
            setattr(holder, attribute, OfParent())


class _ZenohOfProcess:
    """Whether Zenoh has run in this process, or had before this process was forked off."""

    has_run = False
    is_lost = False


holders = Holders()
_zenoh = _ZenohOfProcess()


def is_lost_by_fork() -> bool:
    """Whether this process is a fork of one in which Zenoh had run."""
    return _zenoh.is_lost


def check_not_forked() -> None:
    """Raise BusError if this process is a fork of one in which Zenoh had run."""
    if _zenoh.is_lost:
        raise BusError(f"this process is a fork of one that had joined the bus, and {_REMEDY}")


def begin_use() -> None:
    """Note that Zenoh runs from now on. Errors as `check_not_forked`."""
    check_not_forked()
    _zenoh.has_run = True


def _on_fork() -> None:
    if _zenoh.has_run:
        _zenoh.is_lost = True
        holders.give_up()


if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(after_in_child=_on_fork)


# At most as many threads are kept; Zenoh has a few that live as long as the process.
_MOST_KEPT = 64

# A sender may make up keys: beyond this number they are judged again.
_MOST_KEYS = 10_000


class StrayKeys:
    """Tells the keys that a closed bus does not take: those not within `expression`.

    Zenoh lets a message in where the sender's rights include its key, which may be a key expression
    of many: who may publish `*` but not `clock` would reach the subscribers of `clock` by `*`. And
    an answer may come at any key that its sender may answer at. The first is logged.
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
    of their subscription. On a closed bus neither do messages and answers at other keys than those
    asked for: see `StrayKeys`.
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
        """Log no further exceptions: the session ends, and what callbacks use with it."""
        self._is_muted = True

    def of_samples(
        self,
        key: str,
        callback: Callable[[str, bytes], None],
        on_too_large: Callable[[], object] = lambda: None,
    ) -> Any:
        """A handler of Zenoh's that calls `callback(key, payload)` for each sample, and
        `on_too_large()` for one that is dropped unread.
        """
        report = self._reporter(f"message of {key}")
        most = self._limits.limit_of(kind_of(key))
        drop = self._dropper(key, on_too_large)
        is_stray = self.strays(key)

        # What `direct` and `guarded` do, in one call instead of three: where messages come one
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

        return zenoh.handlers.Callback(on_sample, None, indirect=False)

    def strays(self, expression: str) -> "StrayKeys | None":
        """The key expression that keys have to be within, on a closed bus; None on an open one."""
        return StrayKeys(expression, self._once) if self._is_closed else None

    def _dropper(
        self, key: str, on_too_large: Callable[[], object] = lambda: None
    ) -> Callable[[zenoh.Sample, int], None]:
        """Counts and names the samples of one subscription that are too large."""
        kind = kind_of(key)
        first = object()

        def drop(sample: zenoh.Sample, size: int) -> None:
            self.too_large[key] += 1
            on_too_large()
            self.drop(first, str(sample.key_expr), size, self._limits.mistake_in(kind, size))

        return drop

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

    def of_signed_samples(self, key: str, callback: Callable[[str, bytes, str], None]) -> Any:
        """As `of_samples`; `callback(key, payload, sender)` also gets the id of the session that
        the sample is from, "" if it does not say. Retained samples do.
        """
        most = self._limits.limit_of(kind_of(key))
        drop = self._dropper(key)
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

    def guarded(self, what: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
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
            # Zenoh calls on the thread that declares, too, for what it knows already.
            interrupt_again()

    return zenoh.handlers.Callback(call, drop, indirect=False)


class _Thread(threading.local):
    """Keeps the Python state of the thread that makes it."""

    known = False
    _kept = itertools.count()

    def __init__(self) -> None:
        if next(self._kept) < _MOST_KEPT:
            # Python drops a thread's state when what was ensured is released: this never is.
            ctypes.pythonapi.PyGILState_Ensure()


# Setting `kept.known` makes the _Thread of the current thread, the first time in each thread.
kept = _Thread()
