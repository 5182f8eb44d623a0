"""ROS's rosidl_runtime_py.set_message: the fields of a message from a map."""

from collections.abc import Callable, Mapping
from typing import Any

from tfbus.base.errors import DecodeError
from tfbus.ros.message_classes import RosMessage

__all__ = ["set_message_fields"]

# Sets a time later, as `ros2 topic pub` does for each message.
SetStamp = Callable[[Any], None]


def set_message_fields(
    msg: Any,
    values: Mapping[str, Any],
    expand_header_auto: bool = False,
    expand_time_now: bool = False,
) -> list[SetStamp]:
    """Set the fields of a message that the map, or a map in it, names.

    With `expand_header_auto` a header may be "auto", with `expand_time_now` a time "now": of each
    comes a function that sets the stamp, as `set_stamp(clock.now().to_msg())`.

    Raises AttributeError for a field that is not there, TypeError if a map is wanted, and
    ValueError for a value that is none of the field's.
    """
    if not isinstance(values, Mapping):
        raise TypeError(f"expected a map of fields of {msg.__ros_name__}, not {values!r:.60}")
    later: list[SetStamp] = []
    for name, value in values.items():
        codec = msg.__codecs__.get(name)
        if codec is None:
            raise AttributeError(f"{msg.__ros_name__} has no field {name!r}")
        field = getattr(msg, name)
        kind = getattr(field, "__ros_name__", "")
        if expand_header_auto and kind == "std_msgs/msg/Header" and value == "auto":
            later.append(_sets(field, "stamp"))
        elif expand_time_now and kind == "builtin_interfaces/msg/Time" and value == "now":
            later.append(_sets(msg, name))
        elif isinstance(field, RosMessage) and isinstance(value, Mapping):
            later += set_message_fields(field, value, expand_header_auto, expand_time_now)
        elif isinstance(value, RosMessage):
            setattr(msg, name, value)
        else:
            setattr(msg, name, _read(codec, value, name))
    return later


def _read(codec: Any, value: Any, name: str) -> Any:
    try:
        if codec.check_names is not None:
            codec.check_names(value, name)
        return codec.read(list(value) if isinstance(value, tuple) else value, name)
    except DecodeError as error:
        raise ValueError(str(error)) from error


def _sets(message: Any, name: str) -> SetStamp:
    return lambda stamp: setattr(message, name, stamp)
