"""Names of Python's own that modules have bound before a simulation replaces them.

By `from time import sleep`, as the default of an argument (`clock=time.monotonic`), as an attribute
of a class, or in a closure, as the factories of a dataclass are.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import FunctionType
from typing import Any

# By the identity of a value: it, and the one in its place.
Replaced = Mapping[int, tuple[Any, Any]]
# Replaces the values of one place that has some of them.
_Swap = Callable[[Replaced], object]

# Modules that measure or wait in real time, whoever is running.
_REAL = (frozenset(sys.stdlib_module_names) - {"sched"}) | {
    "_pytest",
    "execnet",
    "hypothesis",
    "pluggy",
    "pytest",
    "tfbus",
    "xdist",
    "zenoh",
}


def rebind(replaced: Replaced) -> None:
    """Replace values wherever modules have bound them."""
    for swap in _searched.swaps(replaced):
        swap(replaced)


class _Searched:
    """Modules that were searched for names that a simulation replaces."""

    def __init__(self) -> None:
        # There are thousands: beside each its names, how many these were, and what was found.
        self._modules: list[Any] = []
        self._namespaces: list[dict[str, Any]] = []
        self._sizes: list[int] = []
        self._found: list[tuple[_Swap, ...]] = []

    def swaps(self, replaced: Replaced) -> list[_Swap]:
        """The places that have some of the values; a module is searched if it is new, or has new
        names.
        """
        # Once, as a module that is looked at may import others.
        named = list(sys.modules.items())
        modules = [module for _, module in named]
        if modules != self._modules or list(map(len, self._namespaces)) != self._sizes:
            former = dict(
                zip(map(id, self._modules), zip(self._sizes, self._found, strict=True), strict=True)
            )
            namespaces: list[dict[str, Any]] = []
            sizes: list[int] = []
            places: list[tuple[_Swap, ...]] = []
            for name, module in named:
                is_real = name.partition(".")[0] in _REAL
                namespace = {} if is_real else getattr(module, "__dict__", {})
                size, found = former.get(id(module), (-1, ()))
                if size != len(namespace):
                    found = tuple(_of_module(module, namespace, replaced))
                namespaces.append(namespace)
                sizes.append(len(namespace))
                places.append(found)
            self._modules, self._namespaces = modules, namespaces
            self._sizes, self._found = sizes, places
        return [swap for found in self._found for swap in found]


_searched = _Searched()


def _of_module(module: Any, namespace: dict[str, Any], replaced: Replaced) -> Iterator[_Swap]:
    for name, value in list(namespace.items()):
        # By its type: a value may stand for a package that is missing, and raise if it is asked.
        kind = type(value)
        if id(value) in replaced:
            yield partial(_swap_attribute, module, name)
        elif kind is FunctionType and value.__module__ == namespace.get("__name__"):
            yield from _of_function(value, replaced)
        elif issubclass(kind, type) and value.__module__ == namespace.get("__name__"):
            yield from _of_class(value, replaced)


def _of_class(owner: type, replaced: Replaced) -> Iterator[_Swap]:
    for name, value in list(vars(owner).items()):
        kind = type(value)
        if id(value.__func__ if kind in (staticmethod, classmethod) else value) in replaced:
            yield partial(_swap_attribute, owner, name)
        elif kind is FunctionType:
            yield from _of_function(value, replaced)


def _of_function(function: FunctionType, replaced: Replaced) -> Iterator[_Swap]:
    if any(id(value) in replaced for value in function.__defaults__ or ()):
        yield partial(_swap_defaults, function)
    named = function.__kwdefaults__ or {}
    if any(id(value) in replaced for value in named.values()):
        yield partial(_swap_items, named)
    for cell in function.__closure__ or ():
        if _is_full(cell) and id(cell.cell_contents) in replaced:
            yield partial(_swap_cell, cell)


def _is_full(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False


def _other(value: Any, replaced: Replaced) -> Any:
    """The value in the place of this one: another, or itself."""
    return replaced.get(id(value), (value, value))[1]


def _swap_attribute(owner: Any, name: str, replaced: Replaced) -> None:
    held = vars(owner).get(name)
    value = held.__func__ if isinstance(held, staticmethod) else held
    other = _other(value, replaced)
    if other is not value:
        # Of a class only a method may take the instance as its argument.
        is_bare = isinstance(held, FunctionType) or not isinstance(owner, type)
        setattr(owner, name, other if is_bare else staticmethod(other))


def _swap_defaults(function: FunctionType, replaced: Replaced) -> None:
    function.__defaults__ = tuple(_other(each, replaced) for each in function.__defaults__ or ())


def _swap_items(named: dict[str, Any], replaced: Replaced) -> None:
    named.update({name: _other(value, replaced) for name, value in named.items()})


def _swap_cell(cell: Any, replaced: Replaced) -> None:
    cell.cell_contents = _other(cell.cell_contents, replaced)
