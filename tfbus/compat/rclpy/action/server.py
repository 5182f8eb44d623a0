"""ROS's rclpy.action.server."""

import asyncio
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any

from tfbus.base.arguments import is_async
from tfbus.base.errors import DecodeError, ServiceError
from tfbus.compat.rclpy.endpoints import ask_while_spun
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.type_support import TakesTypes
from tfbus.node.action import GoalHandle
from tfbus.ros.message_classes import interface_class, message_class

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


__all__ = [
    "ActionServer",
    "CancelResponse",
    "GoalResponse",
    "ServerGoalHandle",
    "default_cancel_callback",
    "default_goal_callback",
    "default_handle_accepted_callback",
]


class GoalResponse(Enum):
    """Whether a goal is taken."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse(Enum):
    """Whether a goal will be cancelled."""

    REJECT = 1
    ACCEPT = 2


class ServerGoalHandle(TakesTypes):
    """A goal at its server: its request, its state, and the calls that change that."""

    def __init__(self, server: "ActionServer", handle: "GoalHandle") -> None:
        self._server = server
        self._handle = handle
        self.status = GoalStatus.STATUS_ACCEPTED

    @property
    def request(self) -> Any:
        """The Goal."""
        return self._handle.request

    @property
    def goal_id(self) -> Any:
        """Its id, a unique_identifier_msgs.msg.UUID."""
        return uuid_of(self._handle.id)

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self._handle.active

    @property
    def is_cancel_requested(self) -> bool:
        """Whether it is to be cancelled: then call `canceled()`, and return how far it came."""
        return bool(self.status == GoalStatus.STATUS_CANCELING)

    def execute(self, execute_callback: Callable[[Any], Any] | None = None) -> None:
        """Call the callback while the node is spun; its return value is the result."""
        if self.status == GoalStatus.STATUS_ACCEPTED:  # and not to be cancelled already
            self.status = GoalStatus.STATUS_EXECUTING
        self._server.execute(self, execute_callback)

    def publish_feedback(self, feedback: Any) -> None:
        """Send a Feedback. Raises TypeError for another message."""
        self._server.check("Feedback", feedback)
        self._handle.feedback(feedback)

    def succeed(self, response: Any = None) -> None:
        """It is done; sends the Result if one is given, else the callback's return value."""
        self._end(GoalStatus.STATUS_SUCCEEDED, response)

    def abort(self, response: Any = None) -> None:
        """It cannot be done."""
        self._end(GoalStatus.STATUS_ABORTED, response)

    def canceled(self, response: Any = None) -> None:
        """It was cancelled."""
        self._end(GoalStatus.STATUS_CANCELED, response)

    def send_result(self, result: Any, reason: str = "the goal was aborted") -> None:
        """Send the Result, with the status that was set. Once; later ones are left out."""
        if self.status == GoalStatus.STATUS_SUCCEEDED:
            self._handle.succeed(result)
        elif self.status == GoalStatus.STATUS_CANCELED:
            self._handle.cancel(result)
        else:
            self.status = GoalStatus.STATUS_ABORTED
            self._handle.abort(result, reason)

    def destroy(self) -> None:
        """Nothing: it ends with its result."""

    def _end(self, status: int, response: Any) -> None:
        self.status = status
        if response is not None:
            self._server.check("Result", response)
            self.send_result(response)


def default_goal_callback(goal_request: Any) -> GoalResponse:
    """Take every goal."""
    return GoalResponse.ACCEPT


def default_cancel_callback(cancel_request: Any) -> CancelResponse:
    """Cancel none."""
    return CancelResponse.REJECT


def default_handle_accepted_callback(goal_handle: ServerGoalHandle) -> None:
    """Begin at once."""
    goal_handle.execute()


class ActionServer(TakesTypes):
    """Serves an action: `execute_callback(goal_handle)` returns the Result, or is a coroutine.

    `cancel_callback` is called on a thread of the node, so that a goal that is executed can be
    cancelled; one that is a coroutine, and all other callbacks, run while the node is spun.
    """

    def __init__(
        self,
        node: "Node",
        action_type: Any,
        action_name: str,
        execute_callback: Callable[[Any], Any],
        *,
        callback_group: Any = None,
        goal_callback: Callable[[Any], Any] = default_goal_callback,
        handle_accepted_callback: Callable[[Any], None] = default_handle_accepted_callback,
        cancel_callback: Callable[[Any], Any] = default_cancel_callback,
        **_: Any,
    ) -> None:
        self._node = node
        self._type = action_type
        self._execute = execute_callback
        self._goal = goal_callback
        self._accepted = handle_accepted_callback
        self._cancel = cancel_callback
        self._what = f"action {action_name}"
        self._group = node.group_of(callback_group)
        self._server = node.tfbus_node.create_goal_server(
            action_type, action_name, self._take, decides=True
        )

    def register_execute_callback(self, execute_callback: Callable[[Any], Any]) -> None:
        """Call another one from now on."""
        self._execute = execute_callback

    def register_goal_callback(self, goal_callback: Callable[[Any], GoalResponse] | None) -> None:
        """Call another one from now on; None takes every goal."""
        self._goal = goal_callback or default_goal_callback

    def register_cancel_callback(
        self, cancel_callback: Callable[[Any], CancelResponse] | None
    ) -> None:
        """Call another one from now on; None cancels no goal."""
        self._cancel = cancel_callback or default_cancel_callback

    def register_handle_accepted_callback(
        self, handle_accepted_callback: Callable[[Any], None] | None
    ) -> None:
        """Call another one from now on; None begins every goal at once."""
        self._accepted = handle_accepted_callback or default_handle_accepted_callback

    def destroy(self) -> None:
        """End it."""
        self._server.close()

    def check(self, part: str, message: Any) -> None:
        """Raise TypeError if a message is not this part of the action."""
        expected = getattr(self._type, part)
        if not isinstance(message, expected):
            raise TypeError(
                f"action {self._server.name!r} has a {expected.__name__} as its {part}, not a "
                f"{type(message).__name__}"
            )

    def execute(self, goal: ServerGoalHandle, callback: Callable[[Any], Any] | None) -> None:
        """Call the callback while the node is spun, and send its return value."""
        run = partial(self._run, goal, callback or self._execute)
        # In no group, as in ROS: it may be cancelled, and others begin, while it awaits.
        self._node.work.submit(run, what=self._what)

    async def _take(self, handle: "GoalHandle") -> None:
        goal = ServerGoalHandle(self, handle)

        async def decide() -> bool:
            answer: Any = self._goal(handle.request)
            return (await answer if hasattr(answer, "send") else answer) is GoalResponse.ACCEPT

        answer = ask_while_spun(self._node.work, decide, self._group, self._what)
        if not await asyncio.wrap_future(answer):
            raise ServiceError("the goal was rejected")
        handle.on_cancel(lambda: self._on_cancel(goal))
        handle.accept()
        self._node.work.submit(partial(self._accepted, goal), self._group, self._what)

    def _on_cancel(self, goal: ServerGoalHandle) -> Any:
        if is_async(self._cancel):
            return self._decide_later(goal)
        return self._decided(goal, self._cancel(goal))

    async def _decide_later(self, goal: ServerGoalHandle) -> bool:
        decide = partial(self._cancel, goal)
        answer = ask_while_spun(self._node.work, decide, self._group, self._what)
        return self._decided(goal, await asyncio.wrap_future(answer))

    def _decided(self, goal: ServerGoalHandle, answer: Any) -> bool:
        is_taken = answer is CancelResponse.ACCEPT
        if is_taken and goal.is_active:
            goal.status = GoalStatus.STATUS_CANCELING
        return is_taken

    async def _run(self, goal: ServerGoalHandle, callback: Callable[[Any], Any]) -> None:
        try:
            result = callback(goal)
            self._end(goal, await result if hasattr(result, "send") else result)
        except BaseException as error:
            goal.status = GoalStatus.STATUS_ABORTED
            goal.send_result(self._type.Result(), f"{type(error).__name__}: {error}")
            raise

    def _end(self, goal: ServerGoalHandle, result: Any) -> None:
        if goal.status in (GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING):
            self._node.get_logger().warning(
                f"The callback of action {self._server.name!r} set no state of its goal: call "
                "goal_handle.succeed(), canceled() or abort(); it counts as aborted"
            )
        if result is None:
            result = self._type.Result()
        self.check("Result", result)
        goal.send_result(result)
