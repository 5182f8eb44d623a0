"""Names of Python's own that modules have bound before a simulation replaces them, and their locks.

By `from time import sleep`, as the default of an argument (`clock=time.monotonic`), as an attribute
of a class or of an object of its own, in a dict, in a `partial`, or in a closure, as the factories
of a dataclass are.
"""

import _thread
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from operator import is_
from threading import Condition
from types import FunctionType
from typing import Any, NamedTuple

from tfbus.testing.primitives import Lock
from tfbus.testing.tasks import Tasks


class Replaced:
    """Values, and the ones in their places.

    They are given in `pairs`, or made when one is met: for a lock by `locks`, by its type; for a
    condition or a `partial` that has any of these, another one.
    """

    def __init__(
        self, pairs: Iterable[tuple[Any, Any]], locks: Mapping[type, Callable[[Any], Any]]
    ) -> None:
        # By the identity of a value: it, and the one in its place.
        self._pairs = {id(value): (value, other) for value, other in pairs}
        self._locks = locks
        self._kinds = {*locks, Condition, partial}

    def has_any(self, values: Collection[Any]) -> bool:
        """Whether another value may take the place of one of these."""
        is_none = self._pairs.keys().isdisjoint(map(id, values))
        if is_none and self._kinds.isdisjoint(map(type, values)):
            return False
        return any(map(self.has, values))

    def has(self, value: Any) -> bool:
        """Whether another value may take the place of this one."""
        if type(value) is partial:
            return self.has_any(_parts_of(value))
        return id(value) in self._pairs or type(value) in self._kinds

    def other(self, value: Any) -> Any:
        """The value in the place of this one: another, or itself."""
        if id(value) not in self._pairs:
            other = self._made(value)
            if other is value:
                return value
            self._pairs[id(value)] = value, other
        return self._pairs[id(value)][1]

    def undone(self) -> "Replaced":
        """The same the other way round."""
        return Replaced(
            ((other, value) for value, other in self._pairs.values()),
            dict.fromkeys(self._locks, lambda lock: lock),
        )

    def _made(self, value: Any) -> Any:
        kind = type(value)
        if kind is Condition:
            lock = self.other(value._lock)
            return value if lock is value._lock else Condition(lock)
        if kind is partial:
            return self._made_partial(value)
        return self._locks[kind](value) if kind in self._locks else value

    def _made_partial(self, value: "partial[Any]") -> "partial[Any]":
        before = _parts_of(value)
        after = [*map(self.other, before)]
        if all(map(is_, before, after)):
            return value
        func, *args = after[: 1 + len(value.args)]
        named = dict(zip(value.keywords, after[1 + len(args) :], strict=True))
        made = partial(func, *args, **named)
        vars(made).update(vars(value))
        return made


def _parts_of(value: "partial[Any]") -> tuple[Any, ...]:
    return value.func, *value.args, *value.keywords.values()


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


class _Module(NamedTuple):
    """A module that was searched: its names, how many these were, and the found swaps."""

    module: Any
    namespace: dict[str, Any]
    size: int
    found: tuple[_Swap, ...]


class _Searched:
    """Modules that were searched for names that a simulation replaces."""

    def __init__(self) -> None:
        # There are thousands, and all are looked at twice in each simulation.
        self._modules: list[Any] = []
        self._searched: list[_Module] = []
        self._namespaces: list[dict[str, Any]] = []
        self._sizes: list[int] = []
        self._swaps: list[_Swap] = []

    def swaps(self, replaced: Replaced) -> list[_Swap]:
        """The places that have some of the values; a module is searched if it is new, or has new
        names.
        """
        has_all = self._modules == list(sys.modules.values())
        if not has_all or self._sizes != list(map(len, self._namespaces)):
            self._search(replaced)
        return self._swaps

    def _search(self, replaced: Replaced) -> None:
        former = {id(each.module): each for each in self._searched}
        # Once, as a module that is looked at may import others.
        named = list(sys.modules.items())
        self._modules = [module for _, module in named]
        self._searched = []
        for name, module in named:
            searched = former.get(id(module))
            if searched is None or searched.size != len(searched.namespace):
                searched = _searched_module(name, module, replaced)
            self._searched.append(searched)
        with_names = [each for each in self._searched if each.namespace]
        self._namespaces = [each.namespace for each in with_names]
        self._sizes = [each.size for each in with_names]
        self._swaps = [swap for each in with_names for swap in each.found]


def _searched_module(name: str, module: Any, replaced: Replaced) -> _Module:
    is_real = name.partition(".")[0] in _REAL
    namespace = {} if is_real else getattr(module, "__dict__", {})
    size = len(namespace)
    return _Module(module, namespace, size, tuple(_of_module(module, namespace, replaced)))


_searched = _Searched()


def _of_module(module: Any, namespace: dict[str, Any], replaced: Replaced) -> Iterator[_Swap]:
    own = namespace.get("__name__")
    for name, value in list(namespace.items()):
        # By its type: a value may stand for a package that is missing, and raise if it is asked.
        kind = type(value)
        if replaced.has(value):
            yield partial(_swap_attribute, module, name)
        elif kind is FunctionType and value.__module__ == own:
            yield from _of_function(value, replaced)
        elif issubclass(kind, type) and value.__module__ == own:
            yield from _of_class(value, replaced)
        elif kind is dict:
            yield from _of_items(value, replaced)
        elif kind.__module__ == own:
            yield from _of_items(_attributes_of(value), replaced)


def _of_class(owner: type, replaced: Replaced) -> Iterator[_Swap]:
    for name, value in list(vars(owner).items()):
        kind = type(value)
        if replaced.has(value.__func__ if kind in (staticmethod, classmethod) else value):
            yield partial(_swap_attribute, owner, name)
        elif kind is FunctionType:
            yield from _of_function(value, replaced)


def _of_function(function: FunctionType, replaced: Replaced) -> Iterator[_Swap]:
    if replaced.has_any(function.__defaults__ or ()):
        yield partial(_swap_defaults, function)
    yield from _of_items(function.__kwdefaults__ or {}, replaced)
    for cell in function.__closure__ or ():
        if _is_full(cell) and replaced.has(cell.cell_contents):
            yield partial(_swap_cell, cell)


def _of_items(items: dict[Any, Any], replaced: Replaced) -> Iterator[_Swap]:
    if replaced.has_any(items.values()):
        yield partial(_swap_items, items)


def _attributes_of(value: Any) -> dict[str, Any]:
    try:
        attributes: dict[str, Any] = object.__getattribute__(value, "__dict__")
    except AttributeError:
        return {}
    return attributes


def _is_full(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False


def _swap_attribute(owner: Any, name: str, replaced: Replaced) -> None:
    held = vars(owner).get(name)
    value = held.__func__ if isinstance(held, staticmethod) else held
    other = replaced.other(value)
    if other is not value:
        # Of a class only a method may take the instance as its argument.
        is_as_before = type(held) is type(other) or not callable(other)
        is_bare = is_as_before or not isinstance(owner, type)
        setattr(owner, name, other if is_bare else staticmethod(other))


def _swap_defaults(function: FunctionType, replaced: Replaced) -> None:
    function.__defaults__ = tuple(map(replaced.other, function.__defaults__ or ()))


def _swap_items(items: dict[Any, Any], replaced: Replaced) -> None:
    for name, value in list(items.items()):
        other = replaced.other(value)
        if other is not value:
            items[name] = other


def _swap_cell(cell: Any, replaced: Replaced) -> None:
    cell.cell_contents = replaced.other(cell.cell_contents)


class ModuleLock:
    """A lock of a module: one of tasks in tasks, and Python's own on other threads."""

    def __init__(self, tasks: Tasks, real: Any, *, reentrant: bool = False) -> None:
        self._thread_ids = tasks.thread_ids
        self._real = real
        self._simulated = Lock(tasks, reentrant=reentrant)
        if _is_held(real):
            self._simulated.holder, self._simulated._depth = tasks.main, 1

    @property
    def _lock(self) -> Any:
        return self._simulated if _thread.get_ident() in self._thread_ids else self._real

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        taken: bool = self._lock.acquire(blocking, timeout)
        return taken

    __enter__ = acquire

    def release(self) -> None:
        self._lock.release()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def locked(self) -> bool:
        return _is_held(self._lock)

    def _is_owned(self) -> bool:
        # As conditions ask for it.
        lock = self._lock
        owned: bool = getattr(lock, "_is_owned", lock.locked)()
        return owned


def _is_held(lock: Any) -> bool:
    # Python's own reentrant locks tell it from 3.14 on.
    held: bool = lock.locked() if hasattr(lock, "locked") else lock._is_owned()
    return held


def locks_of_modules(tasks: Tasks) -> dict[type, Callable[[Any], ModuleLock]]:
    """By the type of a lock, the one that takes its place, so that no task waits in real time."""
    return {
        _thread.LockType: partial(ModuleLock, tasks),
        _thread.RLock: partial(ModuleLock, tasks, reentrant=True),
    }
