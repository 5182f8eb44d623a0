"""numpy, imported when one of its names is first used: `from tfbus.base import lazy_numpy as np`.

Importing it takes longer than all else of a node's start, and 20 MB; a node that sends and looks
up single transforms never uses it.
"""

from typing import Any


class NDArray:
    """The type of an array in annotations, `NDArray[np.int64]`; to type checkers numpy's own."""

    def __class_getitem__(cls, item: object) -> Any:
        return cls


class ArrayLike:
    """The type of array-likes, in annotations; to type checkers numpy's own."""


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        # The import system and inspect ask any module for such names.
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import numpy

    value = globals()[name] = getattr(numpy, name)
    return value
