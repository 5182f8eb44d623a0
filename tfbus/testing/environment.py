"""The environment of a simulated network: without the settings of the machine's own bus."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

_PREFIX = "TFBUS_"


@contextmanager
def without_settings() -> Iterator[None]:
    """Hide TFBUS_MODE, TFBUS_CONNECT and the like until the end of the `with`."""
    hidden = {name: os.environ.pop(name) for name in list(os.environ) if name.startswith(_PREFIX)}
    try:
        yield
    finally:
        os.environ.update(hidden)
