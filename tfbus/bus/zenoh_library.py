"""Zenoh as a library: its network, its threads, its errors as ours; and it survives no fork.

A forked child has none of Zenoh's threads, so that a new session hangs in it, and it shares with
its parent the file through which Zenoh hears of its sockets: a link that the child opens or closes
takes the parent's links away. So nothing of Zenoh's is used in such a child, nor ended: its
parent's objects are kept for as long as the child lives, and stand-ins for them raise BusError.
"""

import ctypes
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Never

import zenoh

from tfbus.base.errors import BusError
from tfbus.base.wording import printable

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
    """Raise Zenoh's errors, and the error of a key that UTF-8 cannot hold, as BusError; `doing` is
    the action that failed: "publish turtle1/pose". `node` is whose session it is.
    """
    try:
        yield
    except (zenoh.ZError, UnicodeEncodeError) as error:
        raise as_bus_error(doing, error, node) from error


def as_bus_error(doing: str, error: Exception, node: str = "") -> BusError:
    """Zenoh's error as a BusError that names the action that failed."""
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
        """Do nothing: the parent ends its declarations."""

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
        """Replace Zenoh's object in each holder, and keep it for ever: ending it would harm the
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
