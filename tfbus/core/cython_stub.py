"""Stands in for `import cython` where the kernel is interpreted and Cython is not installed."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import TypeVar

compiled = False
nogil = nullcontext()

_Type = TypeVar("_Type", bound=type)


def cclass(decorated: _Type) -> _Type:
    """A class stays a class."""
    return decorated


def freelist(size: int) -> Callable[[_Type], _Type]:
    """Python keeps free memory by itself."""
    return cclass
