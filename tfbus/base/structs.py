"""Classes of named values as `dataclasses` makes them, for the modules that each process imports.

`dataclasses` imports inspect, and compiles up to six functions for each class: 33 million
instructions for the import and 3.7 million for each of the 16 classes that `from tfbus import
Buffer, Node` makes, which takes 178 million without. A class made here takes 0.14 million: its
functions are written once, for all classes. Modules that only some processes import have
dataclasses.
"""

import sys
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar, dataclass_transform

_MISSING = object()

_T = TypeVar("_T")


class Field(NamedTuple):
    """A field of a `Struct`: its name, its default or a function that makes one, and its uses."""

    name: str = ""
    default: Any = _MISSING
    default_factory: Callable[[], Any] | None = None
    init: bool = True
    repr: bool = True
    compare: bool = True

    @property
    def is_required(self) -> bool:
        """Whether the constructor must be given it."""
        return self.default is _MISSING and self.default_factory is None


def field(
    *,
    default: Any = _MISSING,
    default_factory: Callable[[], Any] | None = None,
    init: bool = True,
    repr: bool = True,  # as in dataclasses
    compare: bool = True,
) -> Any:
    """As `dataclasses.field`."""
    return Field("", default, default_factory, init, repr, compare)


class _AsDataclass:
    """The record that dataclasses keeps in a class, made once when it is asked for: so
    `dataclasses.fields`, `replace` and `asdict` take a `Struct`, and a dataclass may inherit from
    one.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: object, owner: "type[Struct]") -> Any:
        # Not that of a class above, which has other fields.
        like = vars(owner).get("_like")
        if like is None:
            like = owner._like = self._made(owner)
        return getattr(like, self._name)

    @staticmethod
    def _made(owner: "type[Struct]") -> Any:
        import dataclasses

        values: dict[str, Any] = {"__annotations__": owner._types}
        for each in owner._fields:
            made = dataclasses.field(init=each.init, repr=each.repr, compare=each.compare)
            if each.default_factory is not None:
                made.default_factory = each.default_factory
            elif not each.is_required:
                made.default = each.default
            values[each.name] = made
        like: Any = type(owner.__name__, (), values)
        return dataclasses.dataclass(frozen=owner._is_frozen)(like)


class _Signature:
    """The signature of the constructor, made when it is asked for."""

    def __get__(self, instance: object, owner: "type[Struct]") -> Any:
        from inspect import Parameter, Signature

        return Signature(
            [
                Parameter(
                    each.name,
                    Parameter.POSITIONAL_OR_KEYWORD,
                    annotation=owner._types[each.name],
                    default=Parameter.empty
                    if each.is_required
                    else _FACTORY
                    if each.default_factory is not None
                    else each.default,
                )
                for each in owner._fields
                if each.init
            ],
            return_annotation=None,
        )


class _Factory:
    def __repr__(self) -> str:
        return "<factory>"


_FACTORY = _Factory()


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Struct:
    """A class with annotated fields: constructor, repr, comparison and hash are by them.

    As a frozen dataclass; `class Counts(Struct, frozen=False)` can be changed and has no hash, and
    with `eq=False` each instance is equal to itself only. `__post_init__` is called if there is
    one.
    """

    _fields: ClassVar[tuple[Field, ...]] = ()
    _types: ClassVar[dict[str, Any]] = {}
    _is_frozen: ClassVar[bool] = True
    # The defaults of all fields, and the fields that have to be given or made.
    _defaults: ClassVar[dict[str, Any]] = {}
    _unset: ClassVar[tuple[Field, ...]] = ()
    # A dataclass with the same fields, once dataclasses was asked for one.
    _like: ClassVar[type | None] = None
    __dataclass_fields__: ClassVar[dict[str, Any]] = _AsDataclass("__dataclass_fields__")  # type: ignore[assignment]
    __dataclass_params__: ClassVar[Any] = _AsDataclass("__dataclass_params__")
    __signature__: ClassVar[Any] = _Signature()
    __match_args__: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, *, frozen: bool = True, eq: bool = True) -> None:
        own = {name: each for name, each in _annotated(cls).items() if not _is_of_class(each)}
        cls._types = {**cls._types, **own}
        cls._fields = (*cls._fields, *(_field_of(cls, name) for name in own))
        cls._is_frozen = frozen
        cls._defaults = {each.name: each.default for each in cls._fields}
        cls._unset = tuple(each for each in cls._fields if each.default is _MISSING)
        cls.__match_args__ = tuple(  # type: ignore[misc]  # not a tuple of constants
            each.name for each in cls._fields if each.init
        )
        if not frozen:
            cls.__setattr__ = object.__setattr__  # type: ignore[method-assign,assignment]
            cls.__delattr__ = object.__delattr__  # type: ignore[method-assign]
        if not eq:
            cls.__eq__ = object.__eq__  # type: ignore[method-assign]
            cls.__hash__ = object.__hash__  # type: ignore[method-assign]
        elif not frozen:
            cls.__hash__ = None  # type: ignore[assignment]

    def __init__(self, *args: Any, **named: Any) -> None:
        names = self.__match_args__
        if len(args) > len(names):
            raise TypeError(
                f"{type(self).__name__}() takes at most {len(names)} arguments, not {len(args)}"
            )
        values = self.__dict__
        # First, so that they are in their order.
        values.update(self._defaults)
        values.update(zip(names, args, strict=False))
        for name in named:
            if name not in names[len(args) :]:
                why = "two values for" if name in names else "an unexpected keyword argument"
                raise TypeError(f"{type(self).__name__}() got {why} {name!r}")
        values.update(named)
        for each in self._unset:
            if values[each.name] is _MISSING:
                if each.default_factory is None:
                    raise TypeError(f"{type(self).__name__}() is missing argument {each.name!r}")
                values[each.name] = each.default_factory()
        self.__post_init__()

    def __post_init__(self) -> None:
        """For subclasses: check the values."""

    def __repr__(self) -> str:
        shown = ", ".join(
            f"{each.name}={getattr(self, each.name)!r}" for each in self._fields if each.repr
        )
        return f"{type(self).__qualname__}({shown})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._compared() == other._compared()

    def __hash__(self) -> int:
        return hash(self._compared())

    def __setattr__(self, name: str, value: Any) -> None:
        raise _frozen_error(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> None:
        raise _frozen_error(f"cannot delete field {name!r}")

    def __replace__(self: _T, **changes: Any) -> _T:
        return replace(self, **changes)

    def _compared(self) -> tuple[Any, ...]:
        return tuple([getattr(self, each.name) for each in self._fields if each.compare])


def fields_of(type_: type[Struct]) -> tuple[Field, ...]:
    """The fields, in their order."""
    return type_._fields


def replace(struct: _T, **changes: Any) -> _T:
    """As `dataclasses.replace`: the same with other values."""
    assert isinstance(struct, Struct)
    for each in struct._fields:
        if each.init and each.name not in changes:
            changes[each.name] = getattr(struct, each.name)
    return type(struct)(**changes)


def _annotated(cls: type) -> Mapping[str, Any]:
    """The annotations of the class itself."""
    if sys.version_info >= (3, 14):
        import annotationlib

        # Names imported for type checkers only have no value.
        return annotationlib.get_annotations(cls, format=annotationlib.Format.FORWARDREF)
    return vars(cls).get("__annotations__", {})  # type: ignore[no-any-return]


def _is_of_class(annotation: Any) -> bool:
    return "ClassVar" in str(annotation)


def _field_of(cls: type, name: str) -> Field:
    value = vars(cls).get(name, _MISSING)
    if not isinstance(value, Field):
        return Field(name, value)
    if value.default is _MISSING:
        delattr(cls, name)
    else:
        setattr(cls, name, value.default)
    return value._replace(name=name)


def _frozen_error(text: str) -> AttributeError:
    from dataclasses import FrozenInstanceError

    return FrozenInstanceError(text)
