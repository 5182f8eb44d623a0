"""ROS's rclpy.type_support: names for the types of annotations."""

from types import GenericAlias
from typing import Any, TypeVar

__all__ = [
    "Action",
    "ActionT",
    "FeedbackMessage",
    "FeedbackT",
    "GetResultServiceResponse",
    "GoalT",
    "Msg",
    "MsgT",
    "ResultT",
    "SendGoalServiceResponse",
    "Srv",
    "SrvRequestT",
    "SrvResponseT",
    "SrvT",
]


class TakesTypes:
    """The base of classes that annotations give types in brackets, as `Publisher[Imu]`."""

    def __class_getitem__(cls, types: Any) -> GenericAlias:
        return GenericAlias(cls, types)


# Any class of messages, services and actions.
Msg = Srv = Action = Any

MsgT = TypeVar("MsgT")
SrvT = TypeVar("SrvT")
SrvRequestT = TypeVar("SrvRequestT")
SrvResponseT = TypeVar("SrvResponseT")
ActionT = TypeVar("ActionT")
GoalT = TypeVar("GoalT")
ResultT = TypeVar("ResultT")
FeedbackT = TypeVar("FeedbackT")


class SendGoalServiceResponse:
    """Whether a goal is accepted; in annotations only."""


class GetResultServiceResponse(TakesTypes):
    """How a goal ended, with its `status` and `result`; in annotations only."""


class FeedbackMessage(TakesTypes):
    """A feedback and its `goal_id`; in annotations only."""
