"""Our messages and ROS's: one rule for all types, made from the definition; three are exceptions.

By the rule fields have ROS's names, and a header is `stamp_ns` and `frame_id`. Values of messages
whose types are not quite the same are made to fit.
"""

import json
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from tfbus import messages
from tfbus.base import lazy_numpy as np
from tfbus.base.errors import DecodeError
from tfbus.base.wording import printable
from tfbus.ros.definitions import STRING, Definition, known_definition, message_named
from tfbus.ros.message_type import SCALARS, MessageType, Scalar, Sequence, Text, Type, rows_of
from tfbus.ros.value_codec import UnfitError, array_of, buffer_of
from tfbus.wire.codec import HEADER, renewed_map, with_header, without_header

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
    if isinstance(type_, MessageType):
        if type_.name in _TIMES:
            return value["sec"] * _SECOND_NS + value["nanosec"]
        return {field.key: plain(value[field.key], field.type) for field in type_.fields}
    if isinstance(type_, Sequence) and isinstance(type_.item, MessageType):
        return [plain(each, type_.item) for each in value]
    return value


def with_floats(value: Any, type_: Type) -> Any:
    """A value with floats in the place of integers in fields of floats, where these are the same
    numbers; all else as it is.
    """
    if isinstance(type_, MessageType) and isinstance(value, Mapping):
        types = {field.key: field.type for field in type_.fields}
        return {
            key: with_floats(each, types[key]) if key in types else each
            for key, each in value.items()
        }
    if isinstance(type_, Sequence) and isinstance(value, list | tuple):
        return [with_floats(each, type_.item) for each in value]
    if type(value) is int and isinstance(type_, Scalar) and type_.name in _FLOATS:
        with suppress(OverflowError):
            return float(value) if float(value) == value else value
    return value


def with_arrays(value: Any, type_: Type) -> Any:
    """A value of this type from a message of the bus, with arrays of numpy in the place of
    binaries; all that is not of the type as it is.
    """
    if isinstance(type_, MessageType) and isinstance(value, dict):
        types = {field.key: field.type for field in type_.fields}
        return {
            key: with_arrays(each, types[key]) if key in types else each
            for key, each in value.items()
        }
    if not isinstance(type_, Sequence):
        return value
    if type_.is_octets:
        return bytes(value) if isinstance(value, memoryview) else value
    if isinstance(value, list):
        is_plain = isinstance(type_.item, Scalar | Text)
        return value if is_plain else [with_arrays(each, type_.item) for each in value]
    rows = rows_of(type_) if isinstance(value, bytes | memoryview) else None
    array = None if rows is None else array_of(value, rows)
    return value if array is None else array


def on_bus(value: Any, type_: Type) -> Any:
    """A value of this type, with arrays of numpy, as a message of the bus has it: the memory of
    sequences, and lists in the place of arrays of a fixed size.
    """
    if isinstance(type_, MessageType) and isinstance(value, Mapping):
        return {field.key: on_bus(value[field.key], field.type) for field in type_.fields}
    if isinstance(value, list) and isinstance(type_, Sequence):
        item = type_.item
        return value if isinstance(item, Scalar | Text) else [on_bus(each, item) for each in value]
    if not hasattr(value, "dtype"):
        return value
    if rows_of(type_) is None:
        return value.tolist()
    return np.ascontiguousarray(value).data.cast("B") if value.size else b""


def field_at(type_: Type, path: str) -> Type | None:
    """The type of the field at a path, such as "header.stamp"; None if there is none."""
    for name in path.split("."):
        if not isinstance(type_, MessageType):
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
    elif (array := _fitted_array(value, type_, path)) is not None:
        found = array
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


def _fitted_array(value: Any, type_: Sequence, path: str) -> Any:
    """An array of numbers, of numpy for example, as the sequence has them: itself if it may stay,
    floats rounded to 32 bits. None for a list, which is looked at number by number.
    """
    if isinstance(value, list | tuple):
        return None
    if (rows := rows_of(type_)) is not None and rows.columns:
        return array_of(value, rows)
    if not isinstance(type_.item, Scalar):
        return None
    if buffer_of(value, type_) is not None:
        return value
    if isinstance(value, bytes | memoryview):
        return _of_memory(value, type_, path)
    dtype = getattr(value, "dtype", None)
    if dtype is None or value.ndim != 1 or dtype.kind != "f" or type_.item.name not in _FLOATS:
        return None
    with np.errstate(over="ignore"):
        rounded = value.astype(SCALARS[type_.item.name])
    if (np.isinf(rounded) & ~np.isinf(value)).any():
        raise UnfitError(f"{path or 'the value'} has a number that is no {type_.item.name}")
    return rounded


def _of_memory(value: bytes | memoryview, type_: Sequence, path: str) -> Any:
    """The array in a binary, as a message on the bus has it; None for a sequence that has none."""
    rows = rows_of(type_)
    array = None if rows is None else array_of(value, rows)
    if rows is not None and array is None:
        size = memoryview(value).nbytes
        raise UnfitError(f"{path} must be a multiple of {rows.size} bytes, not {size}")
    return array


def _below(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _refuse(value: Any, wanted: str, path: str) -> Any:
    raise UnfitError(f"{path or 'the value'} must be {wanted}, not {_kind(value)}")


def _kind(value: Any) -> str:
    return "nothing" if value is None else f"a value of type {type(value).__name__}"


_HEADER_TYPE = "std_msgs/msg/Header"

_ToRos = Callable[[Mapping[str, Any]], dict[str, Any]]
_OfRos = Callable[[dict[str, Any]], dict[str, Any]]


@dataclass(frozen=True)
class Counterpart:
    """A type of ours, by its name, and ROS's with the same content.

    `to_ros` makes the values of a message of ROS of ours, and raises UnfitError if they would
    not come back by `of_ros`, which raises DecodeError for a message with other fields.
    """

    type_name: str
    definition: Definition
    to_ros: _ToRos
    of_ros: _OfRos

    @property
    def is_on_bus(self) -> bool:
        """Whether the type has its fields of ROS on the bus, too."""
        return self.to_ros is dict


def counterpart_of_ros(ros_type: str, said: str, topic: str) -> Counterpart | None:
    """Our counterpart of a topic of this type in ROS; `said` is the name of the type that the file
    says as well.
    """
    if ros_type in _STAMPED:
        return _STAMPED[ros_type]
    is_description = said == "RobotDescription" or topic.rpartition("/")[2] == "robot_description"
    return COUNTERPARTS["RobotDescription"] if ros_type == STRING.name and is_description else None


# The rule


def _in_ros(value: Any, type_: Type) -> Any:
    """A value of ours as one of this type, in the order of its fields."""
    if isinstance(type_, Sequence) and isinstance(type_.item, MessageType):
        if not isinstance(value, list | tuple):
            raise UnfitError("it must be a list of messages")
        return [_in_ros(each, type_.item) for each in value]
    if not isinstance(type_, MessageType):
        return value
    try:
        if _has_header(type_):
            value = with_header(value)
        names = [field.key for field in type_.fields]
        if value.keys() != {*names}:
            raise UnfitError(f"the fields of a {type_.name} must be {', '.join(names)}")
    except (AttributeError, KeyError, TypeError) as error:
        raise UnfitError(f"it is no {type_.name}: {error}") from error
    return {field.key: _in_ros(value[field.key], field.type) for field in type_.fields}


def _of_ros(value: Any, type_: Type) -> Any:
    """A value of this type as ours. Raises KeyError or TypeError for one of another type."""
    if isinstance(type_, Sequence) and isinstance(type_.item, MessageType):
        return [_of_ros(each, type_.item) for each in value]
    if not isinstance(type_, MessageType):
        return value
    values = {field.key: _of_ros(value[field.key], field.type) for field in type_.fields}
    return without_header(values) if _has_header(type_) else values


def _has_header(message: MessageType) -> bool:
    return any(
        field.key == HEADER
        and isinstance(field.type, MessageType)
        and field.type.name == _HEADER_TYPE
        for field in message.fields
    )


def _by_rule(message_type: type) -> tuple[_ToRos, _OfRos]:
    """The way to ROS and back."""
    message = message_named(message_type.__ros__)  # type: ignore[attr-defined]
    added = _ADDED.get(message_type.__name__, {})
    later = _LATER.get(message_type.__name__, {})

    def to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
        try:
            values = renewed_map(message_type, values)
        except DecodeError as error:
            raise UnfitError(str(error)) from error
        if not added.keys() <= values.keys():
            raise UnfitError(f"it must have {', '.join(added)}")
        values = {**later, **{name: values[name] for name in values if name not in added}}
        made: dict[str, Any] = _in_ros(values, message)
        return made

    def of_ros(values: dict[str, Any]) -> dict[str, Any]:
        return {**added, **_of_ros(values, message)}

    return to_ros, of_ros


# The simulated time: its rate, and whether it is paused, stay here.


def _clock_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    if not isinstance(values.get("stamp_ns"), int):
        raise UnfitError("stamp_ns must be an integer")
    seconds, nanoseconds = divmod(values["stamp_ns"], _SECOND_NS)
    return {"clock": {"sec": seconds, "nanosec": nanoseconds}}


def _clock_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    time = values["clock"]
    return {"stamp_ns": time["sec"] * _SECOND_NS + time["nanosec"]}


# Descriptions: the prefix and source stand behind the description, in a comment of XML.

_BEFORE, _AFTER = "\n<!-- tfbus: ", " -->"


def _description_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    if values.keys() != {"urdf", "prefix", "source"}:
        raise UnfitError
    urdf, *others = values["urdf"], values["prefix"], values["source"]
    if any(type(text) is not str for text in (urdf, *others)):
        raise UnfitError
    # Hyphens are escaped: two of them would end the comment.
    about = json.dumps(others).replace("-", "\\u002d")
    data = f"{urdf}{_BEFORE}{about}{_AFTER}" if any(others) or _BEFORE in urdf else urdf
    return {"data": data}


def _description_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    data = values.get("data")
    if not isinstance(data, str):
        raise DecodeError(f"a {STRING.name} has other fields than ROS's own")
    urdf, found, about = data.rpartition(_BEFORE)
    if found and about.endswith(_AFTER):
        try:
            others = json.loads(about.removesuffix(_AFTER))
        except (ValueError, RecursionError):
            others = None
        if isinstance(others, list) and [type(each) for each in others] == [str, str]:
            return {"urdf": urdf, "prefix": others[0], "source": others[1]}
    return {"urdf": data, "prefix": "", "source": ""}


def _refusing(definition: Definition, of_ros: _OfRos) -> _OfRos:
    """The same, which raises DecodeError for a message with other fields."""

    def refuse(values: dict[str, Any]) -> dict[str, Any]:
        try:
            return of_ros(values)
        except (KeyError, TypeError) as error:
            raise DecodeError(f"a {definition.name} has other fields than ROS's own") from error

    return refuse


# The exceptions: fields that ROS lacks, with their values for a message of ROS, and types whose
# content ROS has in other fields.
_ADDED: Mapping[str, Mapping[str, Any]] = {"Pose": {"stamp_ns": 0}}
# Fields that ours got later than others, with their values in messages of an old publisher.
_LATER: Mapping[str, Mapping[str, Any]] = {"JointState": {"frame_id": ""}}
_OTHERWISE: Mapping[str, tuple[_ToRos, _OfRos]] = {
    "Clock": (_clock_to_ros, _clock_of_ros),
    "RobotDescription": (_description_to_ros, _description_of_ros),
}
# In a recording each of these keeps its own type: a turtlesim/msg/Pose has no stamp, and its
# numbers are less exact.
_NOT_RECORDED = ("Clock", "Pose", "Twist")


def as_in_ros(definition: Definition) -> Counterpart:
    """A type that has its name and fields of ROS on the bus, too."""
    return Counterpart(definition.name, definition, dict, dict)


def _counterpart(message_type: type) -> Counterpart:
    name = message_type.__name__
    definition = known_definition(message_type.__ros__)  # type: ignore[attr-defined]
    to_ros, of_ros = _OTHERWISE.get(name) or _by_rule(message_type)
    return Counterpart(name, definition, to_ros, _refusing(definition, of_ros))


# All by which a bridge passes messages on.
LIVE_COUNTERPARTS: Mapping[str, Counterpart] = {
    name: _counterpart(each) for name, each in vars(messages).items() if hasattr(each, "__ros__")
}

# The types that are the same in ROS, bit by bit: a recording has them so.
COUNTERPARTS: Mapping[str, Counterpart] = {
    name: each for name, each in LIVE_COUNTERPARTS.items() if name not in _NOT_RECORDED
}

_STAMPED = {
    each.definition.name: each for name, each in COUNTERPARTS.items() if each.definition != STRING
}

# The same by the names of the types in ROS: the types of which each topic has one meaning.
BY_ROS_TYPE: Mapping[str, Counterpart] = {
    each.definition.name: each
    for each in LIVE_COUNTERPARTS.values()
    if each.definition.name != STRING.name
}

# Types of tfbus.messages that are on the bus as in ROS, by their name there, which is ROS's.
OURS_IN_ROS: Mapping[str, type] = {
    each.__msgtype__: each for each in vars(messages).values() if hasattr(each, "__msgtype__")
}

AS_IN_ROS: Mapping[str, Counterpart] = {
    name: as_in_ros(known_definition(name)) for name in OURS_IN_ROS
}
