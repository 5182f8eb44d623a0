"""The fields of our messages and of ROS's: a `header` there is `stamp_ns` and `frame_id` here, and
all else has the same name. Names that fields had before are read as well.
"""

from collections.abc import Iterable, Mapping
from typing import Any

_SECOND_NS = 1_000_000_000

HEADER = "header"
OF_HEADER = ("stamp_ns", "frame_id")


def has_header(fields: Mapping[str, object]) -> bool:
    """Whether a type with these fields of ours has a header in ROS."""
    return HEADER not in fields and all(name in fields for name in OF_HEADER)


def is_in_ros_layout(values: Mapping[Any, object]) -> bool:
    """Whether the values of a type that has a header in ROS have that; beside a stamp of ours
    a `header` is an unknown field.
    """
    return HEADER in values and "stamp_ns" not in values


def with_header(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a message with the header of ROS. Raises KeyError where one of ours is missing,
    TypeError for a stamp that is no integer, and where there is a header.
    """
    if HEADER in values:
        raise TypeError("it has a header beside stamp_ns")
    stamp_ns = values["stamp_ns"]
    if type(stamp_ns) is not int:
        raise TypeError("stamp_ns must be an integer")
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    others = {name: value for name, value in values.items() if name not in OF_HEADER}
    return {HEADER: {"stamp": stamp, "frame_id": values["frame_id"]}, **others}


def without_header(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a message of ROS as ours. Raises KeyError and TypeError where its header has
    other fields than ROS's own.
    """
    header = values[HEADER]
    stamp = header["stamp"]
    seconds, nanoseconds = stamp["sec"], stamp["nanosec"]
    # Before they are multiplied: a billion times a list would take all memory.
    if type(seconds) is not int or type(nanoseconds) is not int:
        raise TypeError("the stamp must be of integers")
    stamp_ns = seconds * _SECOND_NS + nanoseconds
    of_header = {"stamp_ns": stamp_ns, "frame_id": header["frame_id"]}
    others = {
        name: value for name, value in values.items() if name != HEADER and name not in OF_HEADER
    }
    return {**of_header, **others}


def as_time(values: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """The fields of a message with these times, `lifetime_ns`, as ROS has them: a `lifetime` of
    seconds and nanoseconds.
    """
    made = {}
    for name, value in values.items():
        if name in names:
            sec, nanosec = divmod(value, _SECOND_NS)
            made[name.removesuffix("_ns")] = {"sec": sec, "nanosec": nanosec}
        else:
            made[name] = value
    return made


def of_time(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The fields of a message of ROS with a time as ours, `lifetime_ns`; if it has that already, as
    it is. Raises KeyError and TypeError for a time with other fields than ROS's own.
    """
    in_ros = name.removesuffix("_ns")
    if name in values or in_ros not in values:
        return values
    sec, nanosec = values[in_ros]["sec"], values[in_ros]["nanosec"]
    if type(sec) is not int or type(nanosec) is not int:
        raise TypeError("the time must be of integers")
    others = {key: value for key, value in values.items() if key != in_ros}
    return {**others, name: sec * _SECOND_NS + nanosec}


def renewed(
    values: Mapping[str, Any],
    former: Mapping[str, str | tuple[str, ...]],
    fields: Mapping[str, object],
) -> Mapping[str, Any]:
    """The values of a message under today's names of its `fields`, where it has `former` ones;
    otherwise the same. Of a former name there is the path of today; of a list, that of each item.
    """
    if not any(name in former and name not in fields for name in values):
        return values
    made: dict[str, Any] = {}
    for name, value in values.items():
        path = former.get(name, name)
        if isinstance(path, str):
            _put(made, path, value)
        elif isinstance(value, list | tuple) and len(value) == len(path):
            for each, item in zip(path, value, strict=True):
                _put(made, each, item)
        else:
            made[name] = value  # it has this name only
    return made


def _put(values: dict[str, Any], path: str, value: Any) -> None:
    """Set the value at a path, `pose.position`."""
    *above, name = path.split(".")
    for each in above:
        below = values.get(each)
        values[each] = dict(below) if isinstance(below, dict) else {}
        values = values[each]
    values[name] = value
