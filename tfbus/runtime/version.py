"""The version of the installed tfbus."""

from functools import cache


@cache
def installed_version() -> str:
    """As pip knows it; read at the first call, as that takes longer than to join a bus."""
    from importlib.metadata import version

    return version("tfbus")
