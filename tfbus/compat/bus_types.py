"""ROS's messages on the bus: types that tfbus has in another layout are converted.

All others go by the names of their fields, under their names in ROS, and every dataclass of a
program as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from tfbus.compat.message_classes import RosMessage
from tfbus.errors import DecodeError
from tfbus.ros.counterparts import BY_ROS_TYPE, LIVE_COUNTERPARTS, Counterpart
from tfbus.ros.definitions import STRING, TURTLE_POSE
from tfbus.ros.value_codec import UnfitError
from tfbus.runtime.clock import Clock


@dataclass(frozen=True)
class BusType:
    """The type of a topic's messages on the bus, and the way there and back."""

    type: type[Any]
    to_bus: Callable[[Any], Any]
    from_bus: Callable[[Any], Any]


def bus_type_of(message_type: type, topic: str, clock: Clock) -> BusType:
    """How messages of this type go over the bus; `clock` stamps those that have no stamp in ROS."""
    ros_type = getattr(message_type, "__ros_name__", "")
    counterpart = BY_ROS_TYPE.get(ros_type)
    if ros_type == STRING.name and topic.rpartition("/")[2] == "robot_description":
        counterpart = LIVE_COUNTERPARTS["RobotDescription"]
    if counterpart is None:
        return BusType(message_type, _as_it_is, _as_it_is)
    carried = _carried_type(message_type, counterpart)
    if ros_type != TURTLE_POSE.name:
        return BusType(carried, carried, _message_in)

    def stamped(message: Any) -> _Carried:
        made = carried(message)
        made.stamp_ns = clock.now_ns()
        return made

    return BusType(carried, stamped, _message_in)


class _Carried:
    """A message of ROS that is one of tfbus's on the bus; a subclass says which."""

    __slots__ = ("message", "stamp_ns")
    __msgtype__ = ""
    __message_type__: type[RosMessage]
    __counterpart__: Counterpart

    def __init__(self, message: Any) -> None:
        self.message = message
        self.stamp_ns: int | None = None

    def __bus_map__(self) -> dict[str, Any]:
        values = self.__counterpart__.of_ros(self.message.__bus_map__())
        return values if self.stamp_ns is None else {**values, "stamp_ns": self.stamp_ns}

    @classmethod
    def __of_bus_map__(cls, values: dict[str, Any], path: str, unknown_fields: bool) -> Any:
        try:
            of_ros = cls.__counterpart__.to_ros(values)
        except UnfitError as error:
            raise DecodeError(str(error) or "it has other fields") from error
        return cls(cls.__message_type__.__of_bus_map__(of_ros))


@cache
def _carried_type(message_type: type, counterpart: Counterpart) -> type[_Carried]:
    contents = {
        "__slots__": (),
        "__msgtype__": counterpart.type_name,
        "__message_type__": message_type,
        "__counterpart__": counterpart,
    }
    return type(counterpart.type_name, (_Carried,), contents)


def _message_in(carried: _Carried) -> Any:
    return carried.message


def _as_it_is(message: Any) -> Any:
    return message
