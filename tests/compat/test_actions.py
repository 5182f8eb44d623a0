"""ROS's rclpy.action and rclpy.lifecycle over tfbus."""

import threading
from types import ModuleType
from typing import Any

import pytest

from tests.compat.spinning import spin_until
from tests.simulated_bus import Bus
from tfbus import messages
from tfbus.compat.action_msgs.msg import GoalStatus
from tfbus.compat.example_interfaces.action import Fibonacci
from tfbus.compat.lifecycle_msgs.msg import State, Transition
from tfbus.compat.lifecycle_msgs.srv import ChangeState, GetState
from tfbus.compat.rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from tfbus.compat.rclpy.action.client import Feedbacks
from tfbus.compat.rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from tfbus.compat.rclpy.executors import MultiThreadedExecutor
from tfbus.compat.rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from tfbus.compat.rclpy.task import Future
from tfbus.compat.std_msgs.msg import String
from tfbus.compat.turtlesim.action import RotateAbsolute


def count(goal_handle: Any) -> Any:
    """Fibonacci's numbers, with feedback."""
    sequence = [0, 1]
    for _ in range(goal_handle.request.order - 1):
        sequence.append(sequence[-1] + sequence[-2])
        goal_handle.publish_feedback(Fibonacci.Feedback(sequence=sequence))
    goal_handle.succeed()
    return Fibonacci.Result(sequence=sequence)


async def count_later(goal_handle: Any) -> Any:
    """The same as a coroutine."""
    return count(goal_handle)


@pytest.mark.parametrize("execute", [count, count_later])
def test_a_goal_is_sent_and_reached(rclpy: ModuleType, execute: Any) -> None:
    """With feedback on the way, in the order in which it was sent."""
    server, client, heard = rclpy.create_node("server"), rclpy.create_node("client"), []
    ActionServer(server, Fibonacci, "fibonacci", execute)
    calls = ActionClient(client, Fibonacci, "fibonacci")
    sent = calls.send_goal_async(Fibonacci.Goal(order=4), feedback_callback=heard.append)
    spin_until(server, sent.done)
    goal = sent.result()
    assert goal.accepted and bytes(goal.goal_id.uuid) != bytes(16)
    ended = goal.get_result_async()
    spin_until(server, ended.done)
    assert ended.result().status == GoalStatus.STATUS_SUCCEEDED
    assert [*ended.result().result.sequence] == [0, 1, 1, 2, 3]
    spin_until(client, lambda: len(heard) == 3)
    assert [*heard[0].feedback.sequence] == [0, 1, 1]
    assert {bytes(each.goal_id.uuid) for each in heard} == {bytes(goal.goal_id.uuid)}


def test_a_goal_may_be_rejected(rclpy: ModuleType) -> None:
    """By the callback, before it is executed; the client is told so."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")

    def decide(request: Any) -> GoalResponse:
        return GoalResponse.ACCEPT if request.order < 10 else GoalResponse.REJECT

    ActionServer(server, Fibonacci, "fibonacci", count, goal_callback=decide)
    sent = ActionClient(client, Fibonacci, "fibonacci").send_goal_async(Fibonacci.Goal(order=50))
    spin_until(server, sent.done)
    assert not sent.result().accepted


def test_a_coroutine_may_decide_about_a_goal(rclpy: ModuleType) -> None:
    """As in ROS: its answer counts."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")

    async def decide(request: Any) -> GoalResponse:
        return GoalResponse.ACCEPT

    ActionServer(server, Fibonacci, "fibonacci", count, goal_callback=decide)
    sent = ActionClient(client, Fibonacci, "fibonacci").send_goal_async(Fibonacci.Goal(order=2))
    spin_until(server, sent.done)
    assert sent.result().accepted


def test_a_goal_that_cannot_be_sent_ends_its_future(rclpy: ModuleType) -> None:
    """With an error that names the field."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")
    ActionServer(server, Fibonacci, "fibonacci", count)
    goal = Fibonacci.Goal(order="many")
    sent = ActionClient(client, Fibonacci, "fibonacci").send_goal_async(goal)
    spin_until(server, sent.done)
    with pytest.raises(TypeError, match="order"):
        sent.result()


@pytest.mark.parametrize("is_taken", [True, False])
def test_a_goal_is_cancelled_where_its_server_takes_that(rclpy: ModuleType, is_taken: bool) -> None:
    """While it is executed in the only thread that spins."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")
    asked, returned = threading.Event(), threading.Event()

    def decide(request: Any) -> CancelResponse:
        asked.set()
        return CancelResponse.ACCEPT if is_taken else CancelResponse.REJECT

    def wait(goal_handle: Any) -> Any:
        assert asked.wait(40)
        if is_taken:
            while not goal_handle.is_cancel_requested:
                pass
            goal_handle.canceled()
        else:
            goal_handle.succeed()
        returned.set()
        return Fibonacci.Result(sequence=[7])

    ActionServer(server, Fibonacci, "fibonacci", wait, cancel_callback=decide)
    sent = ActionClient(client, Fibonacci, "fibonacci").send_goal_async(Fibonacci.Goal(order=1))
    spinning = threading.Thread(target=spin_until, args=(server, returned.is_set))
    spinning.start()
    spin_until(client, sent.done)
    cancelled = sent.result().cancel_goal_async()
    ended = sent.result().get_result_async()
    spinning.join(60)
    spin_until(client, lambda: cancelled.done() and ended.done())
    assert bool(cancelled.result().goals_canceling) == is_taken
    wanted = GoalStatus.STATUS_CANCELED if is_taken else GoalStatus.STATUS_SUCCEEDED
    assert (ended.result().status, [*ended.result().result.sequence]) == (wanted, [7])


def test_the_first_feedback_may_come_before_the_id_of_its_goal() -> None:
    """It waits for that, and the order stays."""
    heard: list[Any] = []
    feedbacks = Feedbacks(heard.append, lambda call: call())
    feedbacks.came(1)
    assert heard == []
    feedbacks.begin("id")
    feedbacks.came(2)
    assert [(each.goal_id, each.feedback) for each in heard] == [("id", 1), ("id", 2)]


def test_feedback_is_heard_in_the_group_of_the_client(rclpy: ModuleType) -> None:
    """One after the other in an exclusive one, also with several threads, as in ROS."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")
    ActionServer(server, Fibonacci, "fibonacci", count)
    group = MutuallyExclusiveCallbackGroup()
    alone: list[bool] = []
    running = threading.Lock()

    def hear(feedback: Any) -> None:
        is_alone = running.acquire(blocking=False)
        alone.append(is_alone)
        if is_alone:
            running.release()

    calls = ActionClient(client, Fibonacci, "fibonacci", callback_group=group)
    executor = MultiThreadedExecutor(4)
    for node in (server, client):
        executor.add_node(node)
    calls.send_goal_async(Fibonacci.Goal(order=30), feedback_callback=hear)
    while len(alone) < 29:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    assert set(alone) == {True} and group.owner == "/client"


@pytest.mark.parametrize("is_taken", [True, False])
def test_a_coroutine_may_decide_about_the_cancelling(rclpy: ModuleType, is_taken: bool) -> None:
    """Its answer counts, also where it comes later."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")
    decided = Future()

    async def decide(goal_handle: Any) -> CancelResponse:
        return await decided

    async def wait(goal_handle: Any) -> Any:
        await decided
        while is_taken and not goal_handle.is_cancel_requested:
            await passed()
        goal_handle.canceled() if is_taken else goal_handle.succeed()
        return Fibonacci.Result(sequence=[7])

    def passed() -> Future:
        future = Future()
        server.create_timer(0.01, lambda: future.set_result(None))
        return future

    ActionServer(server, Fibonacci, "fibonacci", wait, cancel_callback=decide)
    sent = ActionClient(client, Fibonacci, "fibonacci").send_goal_async(Fibonacci.Goal(order=1))
    spin_until(server, sent.done)
    cancelled = sent.result().cancel_goal_async()
    decided.set_result(CancelResponse.ACCEPT if is_taken else CancelResponse.REJECT)
    ended = sent.result().get_result_async()
    spin_until(server, lambda: cancelled.done() and ended.done())
    assert bool(cancelled.result().goals_canceling) == is_taken
    wanted = GoalStatus.STATUS_CANCELED if is_taken else GoalStatus.STATUS_SUCCEEDED
    assert ended.result().status == wanted


def test_a_callback_that_fails_aborts_its_goal(rclpy: ModuleType) -> None:
    """And raises where the node is spun; one that sets no state aborts it too, with a line."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")

    def fail(goal_handle: Any) -> Any:
        raise ValueError("no")

    serving = ActionServer(server, Fibonacci, "fibonacci", fail)
    calls = ActionClient(client, Fibonacci, "fibonacci")
    sent = calls.send_goal_async(Fibonacci.Goal(order=1))
    with pytest.raises(ValueError, match="no"):
        spin_until(server, sent.done and (lambda: False))
    spin_until(client, lambda: sent.done() and sent.result().get_result_async().done())
    assert sent.result().get_result().status == GoalStatus.STATUS_ABORTED
    serving.register_execute_callback(lambda goal_handle: Fibonacci.Result())
    sent = calls.send_goal_async(Fibonacci.Goal(order=1))
    spin_until(server, lambda: sent.done() and sent.result().get_result_async().done())
    assert sent.result().get_result().status == GoalStatus.STATUS_ABORTED


def test_actions_of_tfbus_are_the_same_on_the_bus(rclpy: ModuleType, bus: Bus) -> None:
    """turtlesim's, in both directions; a wrong goal is refused before it is sent."""
    own, node = bus.node("own"), rclpy.create_node("ported")
    own.create_goal_server(
        messages.RotateAbsolute,
        "turtle1/rotate_absolute",
        lambda handle: handle.succeed(messages.RotateAbsolute.Result(handle.request.theta)),
    )
    client = ActionClient(node, RotateAbsolute, "/turtle1/rotate_absolute")
    assert client.wait_for_server(20)
    outcome = client.send_goal(RotateAbsolute.Goal(theta=1.5))
    assert outcome.result.delta == 1.5
    with pytest.raises(TypeError, match="not a Fibonacci_Goal"):
        client.send_goal_async(Fibonacci.Goal())

    def turn(goal_handle: Any) -> Any:
        goal_handle.succeed()
        return RotateAbsolute.Result(delta=goal_handle.request.theta)

    ActionServer(node, RotateAbsolute, "turn", turn)
    got: list[Any] = []
    own.create_goal_client(messages.RotateAbsolute, "turn").send(
        messages.RotateAbsolute.Goal(0.5), on_result=got.append, timeout_s=20.0
    )
    spin_until(node, lambda: got)
    assert (got[0].status, got[0].result.delta) == ("succeeded", 0.5)


class Managed(LifecycleNode):
    """Publishes while it is active."""

    def __init__(self) -> None:
        super().__init__("managed")
        self.heard = self.create_lifecycle_publisher(String, "text", 10)
        self.fails = False

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        if self.fails:
            raise ValueError("no")
        return TransitionCallbackReturn.SUCCESS


def test_a_managed_node_goes_through_its_states(rclpy: ModuleType) -> None:
    """By its services, as those who manage it do; it publishes only while it is active."""
    node, manager, got = Managed(), rclpy.create_node("manager"), []
    manager.create_subscription(String, "text", got.append, 10)
    change = manager.create_client(ChangeState, "managed/change_state")
    look = manager.create_client(GetState, "managed/get_state")
    assert change.wait_for_service(20) and look.wait_for_service(20)

    def go(transition: int) -> bool:
        future = change.call_async(ChangeState.Request(transition=Transition(id=transition)))
        spin_until(node, future.done)
        return bool(future.result().success)

    def state() -> int:
        future = look.call_async(GetState.Request())
        spin_until(node, future.done)
        return int(future.result().current_state.id)

    node.heard.publish(String(data="lost"))
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not go(Transition.TRANSITION_ACTIVATE)
    assert go(Transition.TRANSITION_CONFIGURE) and go(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_ACTIVE

    def heard() -> bool:
        node.heard.publish(String(data="heard"))
        rclpy.spin_once(manager, timeout_sec=0.01)
        return bool(got)

    spin_until(node, heard)
    assert got[0].data == "heard"
    assert go(Transition.TRANSITION_ACTIVE_SHUTDOWN) and state() == State.PRIMARY_STATE_FINALIZED


def test_a_transition_that_fails_ends_a_managed_node(rclpy: ModuleType) -> None:
    """Unless it mends the error; one that is not possible raises."""
    node = Managed()
    node.fails = True
    assert node.trigger_configure() == TransitionCallbackReturn.ERROR
    with pytest.raises(RuntimeError, match="finalized: configure"):
        node.trigger_configure()
