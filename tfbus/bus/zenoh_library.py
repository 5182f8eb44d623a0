"""Which network sessions join: Zenoh's own, or a simulated one while a test has it in force."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

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
