"""The version of the installed tfbus."""

from functools import cache


@cache
def installed_version() -> str:
    """As pip knows it; read when it is first asked for, as that takes longer than to join a bus."""
    from importlib.metadata import version

    return version("tfbus")
