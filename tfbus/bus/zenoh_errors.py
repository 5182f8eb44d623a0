"""Zenoh's errors as errors of tfbus."""

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from tfbus.errors import BusError
from tfbus.wording import printable


@contextmanager
def bus_errors(doing: str) -> Iterator[None]:
    """Raise Zenoh's errors as BusError, and those of a key that UTF-8 cannot hold; `doing` is what
    failed: "publish turtle1/pose".
    """
    try:
        yield
    except (zenoh.ZError, UnicodeEncodeError) as error:
        raise as_bus_error(doing, error) from error


def as_bus_error(doing: str, error: Exception) -> BusError:
    """Zenoh's error as a BusError that says what could not be done."""
    return BusError(f"could not {printable(doing)}: {first_sentence(str(error))}")


def is_router_missing(error: zenoh.ZError) -> bool:
    """Whether a client could not open because no router answers: at its endpoints or, without
    endpoints, to its scouting.
    """
    return str(error).startswith(("Unable to connect", "timeout"))


def first_sentence(text: str) -> str:
    """Zenoh's reason without the position in its source."""
    return text.split(" at /", 1)[0].strip() or text
