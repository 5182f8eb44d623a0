"""ROS's rosidl_runtime_py.utilities: types of messages, services and actions by their names."""

from typing import Any

from tfbus.base.errors import DecodeError
from tfbus.ros.message_classes import interface_class

__all__ = ["get_action", "get_interface", "get_message", "get_service"]

_KINDS = ("msg", "srv", "action")


def get_interface(identifier: str) -> Any:
    """The class of `nav_msgs/msg/Odometry`, `std_srvs/srv/Trigger`, `nav2_msgs/action/Spin`.

    Raises ValueError if it is no such name, ModuleNotFoundError if the type is not known.
    """
    parts = identifier.split("/")
    if len(parts) != 3 or parts[1] not in _KINDS or not all(parts):
        raise ValueError(
            f"expected the full name of a type, such as std_msgs/msg/String, not {identifier!r}"
        )
    try:
        return interface_class(identifier)
    except DecodeError as error:
        raise ModuleNotFoundError(str(error)) from error


def get_message(identifier: str) -> Any:
    """The class of a message; `std_msgs/String` is `std_msgs/msg/String`. Raises as
    `get_interface`.
    """
    return _of_kind("msg", identifier)


def get_service(identifier: str) -> Any:
    """The class of a service. Raises as `get_interface`."""
    return _of_kind("srv", identifier)


def get_action(identifier: str) -> Any:
    """The class of an action. Raises as `get_interface`."""
    return _of_kind("action", identifier)


def _of_kind(kind: str, identifier: str) -> Any:
    package, _, leaf = identifier.partition("/")
    if leaf and "/" not in leaf:
        identifier = f"{package}/{kind}/{leaf}"
    elif leaf.partition("/")[0] != kind:
        raise ValueError(f"expected a name such as {package}/{kind}/Name, not {identifier!r}")
    return get_interface(identifier)
