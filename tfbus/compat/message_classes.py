"""Classes of ROS's messages, services and actions, made from their definitions when first used."""

import sys
from array import array
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

from tfbus.compat.message_fields import FieldCodec, field_codec
from tfbus.errors import DecodeError
from tfbus.ros.definitions import message_named
from tfbus.ros.message_type import MessageType, Scalar
from tfbus.wording import printable

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
