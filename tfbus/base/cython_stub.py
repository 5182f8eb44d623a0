"""Stands in for `import cython` if the kernel is interpreted and Cython is not installed."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import TypeVar

compiled = False
nogil = nullcontext()

_Type = TypeVar("_Type", bound=type)


def cclass(decorated: _Type) -> _Type:
    """Nothing to do for a class of Python."""
    return decorated


def no_gc(decorated: _Type) -> _Type:
    """Nothing to do: Python needs no advice."""
    return decorated


def freelist(size: int) -> Callable[[_Type], _Type]:
    """Nothing to do: Python keeps free memory itself."""
    return cclass
