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


def names_of_type(known: Mapping[str, _Typed], type_name: str, kind: str) -> list[str]:
    """The names of those of this type.

    Raises BusError, with a near type, if there is none; `kind` is "topic" or "service".
    """
    wanted = bare(type_name)
    found = sorted(name for name, info in known.items() if wanted in info.types)
    if not found:
        types = {each for info in known.values() for each in info.types}
        hint = did_you_mean(wanted, types, none=f", nor any other {kind}: is a node running?")
        raise BusError(f"there is no {kind} of type {wanted!r}{hint}")
    return found
