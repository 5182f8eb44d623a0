"""Classes of ROS's messages, services and actions, made from their definitions when first used.

In a program sequences of numbers are arrays, as in rclpy: array.array, and numpy's if their size
is fixed. A byte is `bytes` of length 1.
"""

import operator
import struct
import sys
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError
from tfbus.base.wording import printable
from tfbus.ros.definitions import message_named
from tfbus.ros.message_type import SCALARS, MessageType, Scalar, Sequence, Text, Type, rows_of
from tfbus.ros.value_codec import array_of

Convert = Callable[[Any, str], Any]


@dataclass(frozen=True)
class FieldCodec:
    """A field's values.

    `make()` is the value of a new message. `write(value, path)` makes the value for the bus, and
    raises TypeError or ValueError; `read(value, path)` reverses it, and raises
    DecodeError. `accept`, if there is one, converts a value that a program assigns.
    `check_names(value, path)`, if there are messages in it, raises DecodeError for a field that
    one of them does not have.
    """

    make: Callable[[], Any]
    write: Convert
    read: Convert
    shown: str
    accept: Convert | None = None
    check_names: Convert | None = None


ClassOf = Callable[[str], type[Any]]


def field_codec(type_: Type, default: Any, class_of: ClassOf) -> FieldCodec:
    """The codec of fields of a type; `class_of` has the classes of messages by their names."""
    if isinstance(type_, Scalar):
        return _scalar(type_.name, default)
    if isinstance(type_, Text):
        return _text(type_, default or "")
    if isinstance(type_, MessageType):
        return _message(class_of(type_.name))
    return _sequence(type_, default, class_of)


# Single values

# As ROS calls them to programs.
_SHOWN = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}


def _scalar(name: str, default: Any) -> FieldCodec:
    shown = _SHOWN.get(name, name)
    if name == "byte":
        value = bytes([default or 0])
        return FieldCodec(lambda: value, _write_byte, _read_byte, shown)
    if name == "bool":
        return FieldCodec(lambda: default or False, _write_bool, _read(_write_bool), shown)
    if name == "float64":
        return FieldCodec(lambda: default or 0.0, _write_float, _read(_write_float), shown)
    if name == "float32":
        rounded = _rounded(default or 0.0, "")
        return FieldCodec(lambda: rounded, _rounded, _read(_rounded), shown)
    write = _integers(name)
    return FieldCodec(lambda: default or 0, write, _read(write), shown)


def _write_float(value: Any, path: str) -> float:
    if type(value) is float:
        return value
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        raise _wrong(path, "a number", value)
    try:
        return float(value)
    except TypeError:  # such as an array of several numbers
        raise _wrong(path, "a number", value) from None


def _rounded(value: Any, path: str) -> float:
    number = _write_float(value, path)
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", number))[0]
    except OverflowError:
        raise ValueError(f"field {path!r} is {number}, which does not fit a float32") from None
    return rounded


def _write_bool(value: Any, path: str) -> bool:
    if isinstance(value, bool) or type(value).__name__ in ("bool", "bool_"):  # numpy's, too
        return bool(value)
    if type(value) is int and value in (0, 1):
        return bool(value)
    raise _wrong(path, "a boolean", value)


def _integers(name: str) -> Convert:
    bits = 8 * struct.calcsize(f"={SCALARS[name]}")
    is_signed = SCALARS[name].islower()
    least = -(2 ** (bits - 1)) if is_signed else 0
    most = 2 ** (bits - is_signed) - 1

    def write(value: Any, path: str) -> int:
        try:
            number = operator.index(value)
        except TypeError:
            raise _wrong(path, "an integer", value) from None
        if not least <= number <= most:
            raise ValueError(f"field {path!r} is {number}: it must be from {least} to {most}")
        return number

    return write


def _write_byte(value: Any, path: str) -> int:
    if isinstance(value, bytes) and len(value) == 1:
        return value[0]
    if isinstance(value, int) and 0 <= value <= 255:
        return int(value)
    raise _wrong(path, "bytes of length 1", value)


def _read_byte(value: Any, path: str) -> bytes:
    if type(value) is not int or not 0 <= value <= 255:
        raise DecodeError(f"field {path!r} must be an integer from 0 to 255")
    return bytes([value])


def _text(type_: Text, default: str) -> FieldCodec:
    def write(value: Any, path: str) -> str:
        if not isinstance(value, str):
            raise _wrong(path, "a text", value)
        if type_.most and len(value) > type_.most:
            raise ValueError(f"field {path!r} must have at most {type_.most} letters")
        return value

    return FieldCodec(lambda: default, write, _read(write), _type_shown(type_))


def _message(cls: type[Any]) -> FieldCodec:
    def write(value: Any, path: str) -> dict[str, Any]:
        written: dict[str, Any] = cls.__write__(value, f"{path}.")
        return written

    def read(value: Any, path: str) -> Any:
        if not isinstance(value, dict):
            raise DecodeError(f"field {path!r} must be a map, not {_kind(value)}")
        return cls.__of_bus_map__(value, f"{path}.")

    def check_names(value: Any, path: str) -> None:
        if isinstance(value, dict):
            cls.__check_names__(value, f"{path}.")

    shown = cls.__ros_name__.replace("/msg/", "/")
    return FieldCodec(cls, write, read, shown, check_names=check_names)


def _read(write: Convert) -> Convert:
    """The reader of values that `write` takes as well."""

    def read(value: Any, path: str) -> Any:
        try:
            return write(value, path)
        except (TypeError, ValueError) as error:
            raise DecodeError(str(error)) from error

    return read


# Several

# The letters of array.array, by the types' names in ROS; a bool and a byte have none.
_ARRAYS = {name: code for name, code in SCALARS.items() if name not in ("bool", "byte")}


def _sequence(type_: Sequence, default: Any, class_of: ClassOf) -> FieldCodec:
    if isinstance(type_.item, Scalar) and type_.item.name in _ARRAYS:
        return _numbers(type_, _ARRAYS[type_.item.name], default)
    return _list(type_, default, field_codec(type_.item, None, class_of))


def _list(type_: Sequence, default: Any, item: FieldCodec) -> FieldCodec:
    rows = rows_of(type_) if isinstance(type_.item, MessageType) else None

    def make() -> list[Any]:
        return list(default) if default else [item.make() for _ in range(type_.size or 0)]

    def accept(value: Any, path: str) -> Any:
        if isinstance(value, list):
            return value
        if isinstance(value, str | bytes) or not hasattr(value, "__iter__"):
            raise _wrong(path, "a list", value)
        return list(value)

    def write(value: Any, path: str) -> list[Any]:
        _check_size(value, type_, path)
        return [item.write(each, f"{path}[{at}]") for at, each in enumerate(value)]

    def read(value: Any, path: str) -> list[Any]:
        if rows is not None and (array := array_of(value, rows)) is not None:
            value = rows.maps_of(array)
        elif isinstance(value, bytes | memoryview) or hasattr(value, "dtype"):  # or booleans
            value = list(value)
        if not isinstance(value, list):
            raise DecodeError(f"field {path!r} must be a list, not {_kind(value)}")
        _check_received(value, type_, path)
        return [item.read(each, f"{path}[{at}]") for at, each in enumerate(value)]

    check_item = item.check_names

    def check_names(value: Any, path: str) -> None:
        if check_item is not None and isinstance(value, list):
            for at, each in enumerate(value):
                check_item(each, f"{path}[{at}]")

    shown = _type_shown(type_, item.shown)
    return FieldCodec(make, write, read, shown, accept, check_names if check_item else None)


def _numbers(type_: Sequence, code: str, default: Any) -> FieldCodec:
    is_fixed = type_.size is not None
    rows = rows_of(type_)
    assert isinstance(type_.item, Scalar)
    shown = _SHOWN.get(type_.item.name, type_.item.name)

    def packed(value: Any, path: str) -> "array[Any]":
        if isinstance(value, array) and value.typecode == code:
            return value
        try:
            if isinstance(value, bytes | bytearray | memoryview) and code in "bB":
                return array(code, bytes(value))
            if hasattr(value, "dtype"):  # numpy's
                if value.ndim == 1 and value.dtype == np.dtype(code):
                    return array(code, value.tobytes())
                if value.ndim != 1 or (code not in "fd" and value.dtype.kind not in "iu"):
                    raise TypeError
                exact = value.astype(code, casting="same_kind" if code in "fd" else "unsafe")
                if code not in "fd" and (exact != value).any():
                    raise OverflowError
                return array(code, exact.tobytes())
            if isinstance(value, str | bytes):
                raise TypeError
            return array(code, value)
        except TypeError:
            kind = "numbers" if code in "fd" else "integers"
            raise _wrong(path, f"a list or array of {kind} in one dimension", value) from None
        except (OverflowError, ValueError):
            raise ValueError(f"field {path!r} has a number that is no {shown}") from None

    def accept(value: Any, path: str) -> Any:
        if not is_fixed:
            return packed(value, path)
        _check_size(value, type_, path)
        return np.array(packed(value, path), dtype=code)

    def make() -> Any:
        if is_fixed:
            return np.array(default, code) if default else np.zeros(type_.size or 0, code)
        return array(code, default or ())

    def write(value: Any, path: str) -> Any:
        _check_size(value, type_, path)
        if type_.is_octets:
            return bytes(packed(value, path))
        return packed(value, path).tolist() if is_fixed else packed(value, path)

    def read(value: Any, path: str) -> Any:
        if not isinstance(value, list | bytes | memoryview | array) and not hasattr(value, "dtype"):
            raise DecodeError(f"field {path!r} must be a list of numbers, not {_kind(value)}")
        _check_received(value, type_, path)
        if rows is not None and isinstance(value, bytes | memoryview):
            value = array_of(value, rows)
            if value is None:
                raise DecodeError(f"field {path!r} must be a multiple of {rows.size} bytes")
        try:
            numbers = packed(value, path)
        except (TypeError, ValueError) as error:
            raise DecodeError(str(error)) from error
        return np.array(numbers, dtype=code) if is_fixed else numbers

    return FieldCodec(make, write, read, _type_shown(type_, shown), accept)


def _check_size(value: Any, type_: Sequence, path: str) -> None:
    try:
        count = len(value)
    except TypeError:
        raise _wrong(path, "a list", value) from None
    if mistake := _mistake_in_size(count, type_, path):
        raise ValueError(mistake)


def _check_received(value: Any, type_: Sequence, path: str) -> None:
    if mistake := _mistake_in_size(len(value), type_, path):
        raise DecodeError(mistake)


def _mistake_in_size(count: int, type_: Sequence, path: str) -> str:
    if type_.size is not None and count != type_.size:
        return f"field {path!r} must have {type_.size} items, not {count}"
    if type_.most and count > type_.most:
        return f"field {path!r} must have at most {type_.most} items, not {count}"
    return ""


# In sentences


def _type_shown(type_: Text | Sequence, item: str = "") -> str:
    if isinstance(type_, Text):
        return f"string<{type_.most}>" if type_.most else "string"
    if type_.size is not None:
        return f"{item}[{type_.size}]"
    return f"sequence<{item}, {type_.most}>" if type_.most else f"sequence<{item}>"


def _wrong(path: str, wanted: str, value: Any) -> TypeError:
    return TypeError(f"field {path!r} must be {wanted}, not {_kind(value)}")


def _kind(value: Any) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"


PACKAGE = "tfbus.compat"

# The parts of services and actions.
_SERVICE, _ACTION = ("Request", "Response"), ("Goal", "Result", "Feedback")

# Supplied nodes have these under the names that tfbus has.
_OURS = ("turtlesim/", "std_srvs/srv/Empty")


class RosMessage:
    """The base of all messages. Fields are set by keywords of the constructor, or as attributes.

    A value is checked when the message is sent: TypeError and ValueError name the field. Sequences
    of numbers become arrays when they are set.
    """

    __slots__ = ()
    # Of each class: the full name in ROS, the name on the bus, and the fields.
    __ros_name__ = ""
    __msgtype__ = ""
    __codecs__: ClassVar[dict[str, FieldCodec]] = {}

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """The fields by name, with their types as ROS names them: `double`, `std_msgs/Header`."""
        return {name: codec.shown for name, codec in cls.__codecs__.items()}

    def __bus_map__(self) -> dict[str, Any]:
        """The message as it goes over the bus, with the memory of its arrays."""
        written: dict[str, Any] = _written(self.__write__(self, ""), _in_memory)
        return written

    def __listed__(self) -> dict[str, Any]:
        """The same with lists in the place of arrays."""
        written: dict[str, Any] = _written(self.__write__(self, ""), array.tolist)
        return written

    @classmethod
    def __write__(cls, message: Any, path: str) -> dict[str, Any]:
        """A message, or any object with its fields. Raises TypeError, ValueError."""
        place = f"field {path[:-1]!r}" if path else "the message"
        if isinstance(message, RosMessage) and type(message).__ros_name__ != cls.__ros_name__:
            raise TypeError(f"{place} must be a {cls.__ros_name__}, not a {message.__ros_name__}")
        try:
            return {
                name: codec.write(getattr(message, name), path + name)
                for name, codec in cls.__codecs__.items()
            }
        except AttributeError as error:
            raise TypeError(
                f"{place} must be a {cls.__ros_name__}, not a value of type "
                f"{type(message).__name__}: {error}"
            ) from None

    @classmethod
    def __of_bus_map__(
        cls, values: dict[str, Any], path: str = "", unknown_fields: bool = True
    ) -> Any:
        """The message of a map; fields that it lacks are as in a new one. Raises DecodeError."""
        codecs = cls.__codecs__
        if not unknown_fields:
            cls.__check_names__(values, path)
        return cls(
            **{
                name: codec.read(values[name], path + name)
                for name, codec in codecs.items()
                if name in values
            }
        )

    @classmethod
    def __check_names__(cls, values: dict[str, Any], path: str) -> None:
        """Raise DecodeError for a field that it has not, or a message in it."""
        codecs = cls.__codecs__
        for name, value in values.items():
            if name not in codecs:
                raise DecodeError(
                    f"there is no field '{printable(path + str(name), 60)}'; "
                    f"{cls.__ros_name__} has {', '.join(codecs) or 'no fields'}"
                )
            check_names = codecs[name].check_names
            if check_names is not None:
                check_names(value, path + name)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(
            _are_equal(getattr(self, name), getattr(other, name)) for name in self.__codecs__
        )

    __hash__ = None  # type: ignore[assignment]  # it changes

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={_shown(getattr(self, name))}" for name in self.__codecs__)
        return f"{self.__module__.removeprefix(f'{PACKAGE}.')}.{type(self).__name__}({fields})"


@cache
def interface_class(name: str) -> type[Any]:
    """The class of a message, service or action of this full name, `nav_msgs/msg/Odometry`.

    Raises DecodeError if it is not known, or its definition is not valid.
    """
    package, kind, leaf = name.split("/")
    if kind == "msg":
        made: type[Any] = message_class(name)
        return made
    holder = type(leaf, (), {"__slots__": (), "__module__": f"{PACKAGE}.{package}.{kind}"})
    for part in _SERVICE if kind == "srv" else _ACTION:
        made = message_class(f"{name}_{part}")
        made.__qualname__ = f"{leaf}.{part}"
        setattr(holder, part, made)
    holder.__doc__ = f"ROS's {name}."
    holder.__msgtype__ = bus_name(name)  # type: ignore[attr-defined]
    return holder


def bus_name(name: str) -> str:
    """The name of an interface of ROS on the bus: its full name there too, unless tfbus's own
    nodes have it.
    """
    return name.rpartition("/")[2] if name.startswith(_OURS) else name


@cache
def message_class(name: str) -> Any:
    """The class of a message of this full name."""
    message = message_named(name)
    package, kind, leaf = name.split("/")
    codecs = {
        field.name: field_codec(field.type, field.default, message_class)
        for field in message.fields
    }
    # Values that are assigned to these become arrays or lists, behind another name.
    accepted = {name: codec for name, codec in codecs.items() if codec.accept is not None}
    slots = [f"_{name}" if name in accepted else name for name in codecs]
    contents: dict[str, Any] = {
        "__slots__": tuple(slots),
        "__module__": f"{PACKAGE}.{package}.{kind}",
        "__doc__": _doc(message),
        "__ros_name__": name,
        "__msgtype__": bus_name(name),
        "__codecs__": codecs,
        "__init__": _constructor(codecs),
        **{name: _array_property(name, codec) for name, codec in accepted.items()},
        **_constants(message),
    }
    return type(leaf, (RosMessage,), contents)


_NOT_GIVEN: Any = object()


def _constructor(codecs: dict[str, FieldCodec]) -> Any:
    """`__init__`, with a keyword for each field. Written out, it takes a third of a loop's time."""
    names: dict[str, Any] = {"_": _NOT_GIVEN}
    lines = []
    for at, (name, codec) in enumerate(codecs.items()):
        names[f"_{at}"] = codec.make
        lines.append(f" self.{name} = _{at}() if {name} is _ else {name}")
    keywords = [f"{name}=_" for name in codecs]
    head = f"def __init__(self, *, {', '.join([*keywords, 'check_fields=None'])}):"
    exec("\n".join([head, *lines, " pass"]), names)
    return names["__init__"]


def _array_property(name: str, codec: FieldCodec) -> property:
    slot = f"_{name}"
    accept = codec.accept
    assert accept is not None

    def get(self: Any) -> Any:
        return getattr(self, slot)

    def set_(self: Any, value: Any) -> None:
        setattr(self, slot, accept(value, name))

    return property(get, set_)


def _constants(message: MessageType) -> dict[str, Any]:
    return {
        each.name: bytes([each.value]) if each.type == Scalar("byte") else each.value
        for each in message.constants
    }


def _doc(message: MessageType) -> str:
    return f"ROS's {message.name}: {', '.join(field.name for field in message.fields) or 'empty'}."


def _written(value: Any, of_array: Callable[["array[Any]"], Any]) -> Any:
    if isinstance(value, array):
        return of_array(value)
    if type(value) is dict:
        return {name: _written(each, of_array) for name, each in value.items()}
    return [_written(each, of_array) for each in value] if type(value) is list else value


def _in_memory(numbers: "array[Any]") -> bytes:
    """The numbers as they are on the bus, little-endian."""
    if sys.byteorder == "big":
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()


def _are_equal(one: Any, other: Any) -> bool:
    if hasattr(one, "dtype"):
        return bool((one == other).all())
    return bool(one == other)


def _shown(value: Any) -> str:
    return repr(value.tolist()) if isinstance(value, array) else repr(value)
