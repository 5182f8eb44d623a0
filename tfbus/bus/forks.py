"""Forks: Zenoh does not survive one, and a child that used it would harm its parent.

A forked child has none of Zenoh's threads, so that a new session hangs in it, and it shares with
its parent the file through which Zenoh hears of its sockets: what the child opens or closes takes
the parent's links away. So nothing of Zenoh's is used in such a child, nor ended: what its parent
had is kept for as long as the child lives, and what stands in its place raises BusError.
"""

import os
import weakref
from typing import Any, Never

from tfbus.errors import BusError

_REMEDY = (
    "Zenoh does not survive a fork: start processes by spawn "
    "(multiprocessing.set_start_method('spawn')) or before the first node"
)


class OfParent:
    """Stands in a forked child for an object of Zenoh's that its parent had."""

    def undeclare(self) -> None:
        """The parent ends what it has declared."""

    def __getattr__(self, name: str) -> Never:
        raise BusError(f"this belongs to the process that this one is a fork of, and {_REMEDY}")


class Holders:
    """The objects that hold something of Zenoh's, each in the attribute that it was added with."""

    def __init__(self) -> None:
        self._attribute_of: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()

    def add(self, holder: Any, attribute: str) -> None:
        """Replace this attribute in a forked child."""
        self._attribute_of[holder] = attribute

    def give_up(self) -> None:
        """Replace what all of them hold, which is kept for ever: ending it would harm the
        parent.
        """
        import ctypes  # slow to import, and few processes fork

        for holder, attribute in list(self._attribute_of.items()):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(getattr(holder, attribute)))
            setattr(holder, attribute, OfParent())


class _ZenohOfProcess:
    """Whether Zenoh has run in this process, or had before this process was forked off."""

    has_run = False
    is_lost = False


holders = Holders()
_zenoh = _ZenohOfProcess()


def is_lost() -> bool:
    """Whether this process is a fork of one in which Zenoh had run."""
    return _zenoh.is_lost


def check() -> None:
    """Raise BusError if this process is a fork of one in which Zenoh had run."""
    if _zenoh.is_lost:
        raise BusError(f"this process is a fork of one that had joined the bus, and {_REMEDY}")


def begin() -> None:
    """Note that Zenoh runs from now on. Errors as `check`."""
    check()
    _zenoh.has_run = True


def _on_fork() -> None:
    if _zenoh.has_run:
        _zenoh.is_lost = True
        holders.give_up()


if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(after_in_child=_on_fork)
