"""What a module with ROS's names says of names that it has not."""

from collections.abc import Callable, Mapping
from typing import NoReturn


def missing_names(
    module: str, instead: Mapping[str, str], otherwise: str
) -> Callable[[str], NoReturn]:
    """The module's `__getattr__`, whose error says what does the same: `instead` by name, and
    `otherwise` of all other names that look like ROS's.
    """

    def missing(name: str) -> NoReturn:
        raise_missing(module, name, instead.get(name, otherwise))

    return missing


def raise_missing(module: str, name: str, instead: str) -> NoReturn:
    """Raise the error for a name that a module has not."""
    if name.startswith("_"):  # what the import system and inspect ask of any module
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    # Of an AttributeError `from ... import` would not show the sentence.
    raise ImportError(f"{module} has no {name}: {instead}", name=name)
