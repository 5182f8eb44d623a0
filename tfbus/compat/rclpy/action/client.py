"""ROS's rclpy.action.client."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from tfbus.base.callbacks import CallbackGroup
from tfbus.base.errors import TfbusError
from tfbus.compat.rclpy.action.server import ENDINGS, CancelGoal, GoalInfo, GoalStatus, uuid_of
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.task import Future
from tfbus.compat.rclpy.type_support import TakesTypes
from tfbus.node.action import GOAL_TIMEOUT_S, SentGoal

__all__ = ["ActionClient", "ClientGoalHandle"]


@dataclass(frozen=True)
class GoalOutcome:
    """How a goal ended: a number of action_msgs.msg.GoalStatus, and the Result."""

    status: int
    result: Any


@dataclass(frozen=True)
class GoalFeedback:
    """A Feedback, and the id of its goal."""

    goal_id: Any
    feedback: Any


class ClientGoalHandle(TakesTypes):
    """A goal at its client."""

    def __init__(self, node: "Node", sent: "SentGoal", *, accepted: bool) -> None:
        self.accepted = accepted
        self.status = GoalStatus.STATUS_EXECUTING if accepted else GoalStatus.STATUS_UNKNOWN
        self.goal_id = uuid_of(sent.id)
        self._node = node
        self._sent = sent
        self._result = Future(run=node.work.submit)

    def get_result_async(self) -> Future:
        """A future with its `status` and `result`; the exception of one whose server is gone."""
        return self._result

    def get_result(self) -> GoalOutcome:
        """Wait for the end of the goal, also in a callback."""
        outcome: GoalOutcome = _waited(self._result)
        return outcome

    def cancel_goal_async(self) -> Future:
        """Ask the server to cancel it: a future of a CancelGoal.Response, in whose
        `goals_canceling` it is if the server does.
        """
        future = Future(run=self._node.work.submit)

        def cancel() -> None:
            try:
                is_taken = self._sent.cancel(timeout_s=GOAL_TIMEOUT_S)
                infos = [GoalInfo(goal_id=self.goal_id)] if is_taken else []
                future.set_result(CancelGoal.Response(goals_canceling=infos))
            except TfbusError as error:
                future.set_exception(error)

        threading.Thread(target=cancel, name="cancel of a goal", daemon=True).start()
        return future

    def cancel_goal(self) -> Any:
        """The same, and wait for the answer, also in a callback."""
        return _waited(self.cancel_goal_async())

    def wait(self) -> None:
        """Wait for the end on a thread of the client, and set the result's future."""
        try:
            ended = self._sent.result()
        except TfbusError as error:
            self.status = GoalStatus.STATUS_UNKNOWN
            self._result.set_exception(error)
            return
        self.status = ENDINGS[ended.status]
        self._result.set_result(GoalOutcome(self.status, ended.result))


class ActionClient(TakesTypes):
    """Sends goals to the server of an action."""

    def __init__(
        self,
        node: "Node",
        action_type: Any,
        action_name: str,
        *,
        callback_group: CallbackGroup | None = None,
        **_: Any,
    ) -> None:
        self._node = node
        self._type = action_type
        # Of the callbacks for feedback.
        self._group = node.group_of(callback_group)
        self._client = node.tfbus_node.create_goal_client(action_type, action_name)

    def server_is_ready(self) -> bool:
        """Whether there is a server."""
        return self._client.served

    def wait_for_server(self, timeout_sec: float | None = None) -> bool:
        """Wait for a server; whether there is one."""
        return self._client.wait_for_server(timeout_sec)

    def send_goal_async(
        self,
        goal: Any,
        feedback_callback: Callable[[Any], object] | None = None,
        goal_uuid: Any = None,
    ) -> Future:
        """Send a Goal once there is a server: a future of its ClientGoalHandle.

        Raises TypeError if the goal is of another type.
        """
        if not isinstance(goal, self._type.Goal):
            raise TypeError(
                f"action {self._client.name!r} takes a {self._type.Goal.__name__}, not a "
                f"{type(goal).__name__}"
            )
        future = Future(run=self._node.work.submit)
        name = f"goal of {self._client.name}"
        threading.Thread(
            target=self._send, args=(goal, feedback_callback, future), name=name, daemon=True
        ).start()
        return future

    def send_goal(self, goal: Any, **options: Any) -> GoalOutcome | None:
        """Send a Goal and wait for its end, also in a callback; None if it was rejected."""
        handle: ClientGoalHandle = _waited(self.send_goal_async(goal, **options))
        return handle.get_result() if handle.accepted else None

    def destroy(self) -> None:
        """End it."""
        self._client.close()

    def _send(self, goal: Any, callback: Callable[[Any], object] | None, future: Future) -> None:
        what = f"feedback of {self._client.name}"
        feedbacks = Feedbacks(
            callback, lambda call: self._node.work.submit(call, self._group, what)
        )
        try:
            sent = self._client.send(goal, on_feedback=feedbacks.came, timeout_s=None)
            handle = ClientGoalHandle(self._node, sent, accepted=sent.accepted())
        # Also the error of a field of a wrong type: the future would never end.
        except Exception as error:
            future.set_exception(error)
            return
        feedbacks.begin(handle.goal_id)
        future.set_result(handle)
        if handle.accepted:
            handle.wait()


class Feedbacks:
    """Hands on feedback, once the id of its goal is known: the first may come before."""

    def __init__(
        self,
        callback: Callable[[Any], object] | None,
        submit: Callable[[Callable[[], object]], object],
    ) -> None:
        self._callback = callback
        self._submit = submit
        self._lock = threading.Lock()
        self._goal_id: Any = None
        self._waiting: list[Any] = []

    def came(self, feedback: Any) -> None:
        """A Feedback has come."""
        with self._lock:
            if self._goal_id is None:
                self._waiting.append(feedback)
            else:
                self._hand_on(feedback)

    def begin(self, goal_id: Any) -> None:
        """The goal has this id."""
        with self._lock:
            self._goal_id = goal_id
            for feedback in self._waiting:
                self._hand_on(feedback)
            self._waiting.clear()

    def _hand_on(self, feedback: Any) -> None:
        if self._callback is not None:
            self._submit(partial(self._callback, GoalFeedback(self._goal_id, feedback)))


def _waited(future: Future) -> Any:
    """The result of a future that ends on a thread of its own."""
    ended = threading.Event()
    future.when_ended(ended.set)
    ended.wait()
    return future.result()
