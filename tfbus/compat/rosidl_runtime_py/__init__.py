"""ROS's package rosidl_runtime_py: messages as maps and texts, and types by their names."""

from tfbus.compat.modules import missing_names
from tfbus.compat.rosidl_runtime_py.convert import (
    get_message_slot_types,
    message_to_csv,
    message_to_ordereddict,
    message_to_yaml,
)
from tfbus.compat.rosidl_runtime_py.set_message import set_message_fields

__all__ = [
    "get_message_slot_types",
    "message_to_csv",
    "message_to_ordereddict",
    "message_to_yaml",
    "set_message_fields",
]

_FILES = "interfaces have no files here; `tfbus topic show NAME` prints one"

__getattr__ = missing_names(
    __name__,
    dict.fromkeys(
        (
            "get_interface_path",
            "get_interface_packages",
            "get_interfaces",
            "get_message_interfaces",
            "get_service_interfaces",
            "get_action_interfaces",
        ),
        _FILES,
    ),
    "it has set_message_fields and the conversions of messages; utilities has get_message",
)
