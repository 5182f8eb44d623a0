"""How goals are called and how they end, in ROS's messages."""

from typing import Any

from tfbus.compat.message_classes import interface_class, message_class
from tfbus.errors import DecodeError

GoalStatus: Any = message_class("action_msgs/msg/GoalStatus")
GoalInfo: Any = message_class("action_msgs/msg/GoalInfo")
UUID: Any = message_class("unique_identifier_msgs/msg/UUID")
CancelGoal: Any = interface_class("action_msgs/srv/CancelGoal")

ENDINGS = {
    "succeeded": GoalStatus.STATUS_SUCCEEDED,
    "canceled": GoalStatus.STATUS_CANCELED,
    "aborted": GoalStatus.STATUS_ABORTED,
}


def uuid_of(goal_id: str) -> Any:
    """The id of a goal of tfbus as ROS has it."""
    try:
        return UUID(uuid=bytes.fromhex(goal_id))
    except (ValueError, DecodeError):  # another server's
        return UUID()
