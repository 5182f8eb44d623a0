"""Zenoh as a library: the network that sessions join, its threads, and its errors as ours."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from tfbus.errors import BusError
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
