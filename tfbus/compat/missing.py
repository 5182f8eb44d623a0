"""The answer of a module with ROS's names for names that it has not."""

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NoReturn


def missing_names(module: str, instead: Mapping[str, str], otherwise: str) -> Callable[[str], Any]:
    """The module's `__getattr__`: imports a module of a package when it is used first, as ROS's
    packages do at once. Its error says what does the same: `instead` by name, and `otherwise` of
    all other names that look like ROS's.
    """

    def missing(name: str) -> Any:
        if not name.startswith("_") and _is_module(f"{module}.{name}"):
            return import_module(f"{module}.{name}")
        raise_missing(module, name, instead.get(name, otherwise))

    return missing


def raise_missing(module: str, name: str, instead: str) -> NoReturn:
    """Raise the error for a name that a module has not."""
    if name.startswith("_"):  # what the import system and inspect ask of any module
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    # Of an AttributeError `from ... import` would not show the sentence.
    raise ImportError(f"{module} has no {name}: {instead}", name=name)


def _is_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # what should hold it is no package
        return False
