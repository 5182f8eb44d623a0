"""The version of the installed tfbus."""

import os
import sys
from contextlib import suppress
from functools import cache

_NAME, _END = "tfbus-", ".dist-info"


@cache
def installed_version() -> str:
    """As pip knows it; read at the first call."""
    # importlib.metadata would import as much as the rest of a node, for the name of a folder.
    for folder in sys.path:
        with suppress(OSError):
            for name in os.listdir(folder or "."):
                if name.startswith(_NAME) and name.endswith(_END):
                    return name[len(_NAME) : -len(_END)]
    from importlib.metadata import version

    return version("tfbus")
