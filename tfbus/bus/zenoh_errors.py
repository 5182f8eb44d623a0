"""Zenoh's errors as errors of tfbus."""

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from tfbus.errors import BusError
from tfbus.wording import printable

_SESSION_CLOSED = "session closed"  # as Zenoh says it


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
