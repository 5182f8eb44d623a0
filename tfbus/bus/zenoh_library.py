"""Which network sessions join: Zenoh's own, or a simulated one while a test has it in force."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_networks: list[Any] = []


def simulated() -> Any:
    """The simulated network that is in force, with Zenoh's `open_session`, `scout` and its
    extensions `declare_advanced_publisher` and `declare_advanced_subscriber`; None for Zenoh.
    """
    return _networks[-1] if _networks else None


@contextmanager
def replaced_by(network: Any) -> Iterator[None]:
    """Until the end of the `with` sessions join a simulated network."""
    _networks.append(network)
    try:
        yield
    finally:
        _networks.pop()
