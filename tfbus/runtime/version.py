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


def version_and_origin() -> str:
    """For people, as in "0.1.0 (clone at 1a2b3c4, changed)"; asks git if there is a clone."""
    from tfbus.runtime.clone import commit_of_clone  # subprocess: 8 ms

    origin = commit_of_clone()
    return installed_version() + (f" ({origin})" if origin else "")
