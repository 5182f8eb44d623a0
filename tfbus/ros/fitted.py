"""Values made to fit a type of ROS, and back: for messages whose types are not quite the same."""

import struct
from collections.abc import Callable, Mapping
from typing import Any

from tfbus.ros.message_type import SCALARS, Message, Scalar, Sequence, Text, Type
from tfbus.ros.value_codec import UnfitError
from tfbus.wording import printable

_SECOND_NS = 1_000_000_000

# Ours are integers, in nanoseconds.
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

_FLOATS = ("float32", "float64")


def zero(type_: Type) -> Any:
    """The value that ROS gives a field that is not set."""
    if isinstance(type_, Scalar):
        return False if type_.name == "bool" else 0.0 if type_.name in _FLOATS else 0
    if isinstance(type_, Text):
        return ""
    if isinstance(type_, Sequence):
        size = type_.size or 0
        return bytes(size) if type_.is_octets else [zero(type_.item) for _ in range(size)]
    return {field.key: zero(field.type) for field in type_.fields}


def fitted(value: Any, type_: Type, path: str = "") -> Any:
    """The value as one of this type: integers as floats, floats rounded to 32 bits, nanoseconds as
    seconds and nanoseconds, and fields that are not there as `zero`.

    Raises UnfitError with the `path` of the field for any other.
    """
    if isinstance(type_, Scalar):
        return _number(value, type_.name, path)
    if isinstance(type_, Text):
        return value if isinstance(value, str) else _refuse(value, "a text", path)
    if isinstance(type_, Sequence):
        return _items(value, type_, path)
    if type_.name in _TIMES and type(value) is int:
        seconds, nanoseconds = divmod(value, _SECOND_NS)
        value = {"sec": seconds, "nanosec": nanoseconds}
    if not isinstance(value, Mapping):
        return _refuse(value, "a map of fields", path)
    fields = {field.key: field.type for field in type_.fields}
    for key in value:
        if key not in fields:
            within = f" of {path}" if path else ""
            name = printable(str(key), 60)
            raise UnfitError(f"{type_.name}{within} has no field '{name}'")
    return {
        key: fitted(value[key], each, _below(path, key)) if key in value else zero(each)
        for key, each in fields.items()
    }


def plain(value: Any, type_: Type) -> Any:
    """A value of this type as ours: times are nanoseconds, all else stays as it is."""
    if isinstance(type_, Message):
        if type_.name in _TIMES:
            return value["sec"] * _SECOND_NS + value["nanosec"]
        return {field.key: plain(value[field.key], field.type) for field in type_.fields}
    if isinstance(type_, Sequence) and isinstance(type_.item, Message):
        return [plain(each, type_.item) for each in value]
    return value


def field_at(type_: Type, path: str) -> Type | None:
    """The type of the field at a path, such as "header.stamp"; None if there is none."""
    for name in path.split("."):
        if not isinstance(type_, Message):
            return None
        found = [field.type for field in type_.fields if field.key == name]
        if not found:
            return None
        type_ = found[0]
    return type_


def _number(value: Any, name: str, path: str) -> Any:
    if name == "bool":
        return value if isinstance(value, bool) else _refuse(value, "true or false", path)
    if name in _FLOATS:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return _refuse(value, "a number", path)
        return _packed(float, value, name, path)
    if isinstance(value, bool) or not isinstance(value, int):
        return _refuse(value, "an integer", path)
    return _packed(int, value, name, path)


def _packed(kind: Callable[[Any], Any], value: Any, name: str, path: str) -> Any:
    """The number as it comes out of its bytes."""
    code = f"<{SCALARS[name]}"
    try:
        return struct.unpack(code, struct.pack(code, kind(value)))[0]
    except (struct.error, OverflowError) as error:
        raise UnfitError(f"{path or 'the value'} is {value}, which is no {name}") from error


def _items(value: Any, type_: Sequence, path: str) -> Any:
    if type_.is_octets and isinstance(value, bytes):
        found: Any = value
    elif not isinstance(value, list | tuple):
        return _refuse(value, "a list", path)
    else:
        found = [fitted(each, type_.item, f"{path}[{at}]") for at, each in enumerate(value)]
        if type_.is_octets:
            found = bytes(found)
    if type_.size is not None and len(found) != type_.size:
        raise UnfitError(f"{path} must have {type_.size} items, not {len(found)}")
    if type_.most and len(found) > type_.most:
        raise UnfitError(f"{path} must have at most {type_.most} items, not {len(found)}")
    return found


def _below(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _refuse(value: Any, wanted: str, path: str) -> Any:
    raise UnfitError(f"{path or 'the value'} must be {wanted}, not {_kind(value)}")


def _kind(value: Any) -> str:
    return "nothing" if value is None else f"a value of type {type(value).__name__}"
