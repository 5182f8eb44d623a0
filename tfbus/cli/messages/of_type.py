"""Topics or services by the name of their type."""

from collections.abc import Mapping
from typing import Protocol

from tfbus.errors import BusError
from tfbus.wording import did_you_mean


class _Typed(Protocol):
    @property
    def types(self) -> tuple[str, ...]: ...


def bare(type_name: str) -> str:
    """The name of a type without ROS's package: `geometry_msgs/msg/Twist` is `Twist`."""
    return type_name.rpartition("/")[2]


def is_of_type(announced: str, type_name: str) -> bool:
    """Whether a type announced on the bus is the one typed in: by its name there, or with ROS's
    package before it, or without.
    """
    return announced in (type_name, bare(type_name)) or bare(announced) == type_name


def names_of_type(known: Mapping[str, _Typed], type_name: str, kind: str) -> list[str]:
    """The names of those of this type.

    Raises BusError, with a near type, if there is none; `kind` is "topic" or "service".
    """
    found = sorted(
        name
        for name, info in known.items()
        if any(is_of_type(each, type_name) for each in info.types)
    )
    if not found:
        types = {each for info in known.values() for each in info.types}
        hint = did_you_mean(type_name, types, none=f", nor any other {kind}: is a node running?")
        raise BusError(f"there is no {kind} of type {type_name!r}{hint}")
    return found
