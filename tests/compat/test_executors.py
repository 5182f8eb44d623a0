"""Executors and callback groups of ported programs: which callbacks run at once."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import Any

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.compat.spinning import spin_until
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus.base.errors import TfbusError
from tfbus.bus.remote_parameters import set_parameter
from tfbus.compat import tf2_ros
from tfbus.compat.geometry_msgs.msg import TransformStamped
from tfbus.compat.rclpy.callback_groups import (
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from tfbus.compat.rclpy.node import SetParametersResult
from tfbus.compat.rclpy.task import Future
from tfbus.compat.rclpy.time import Time
from tfbus.compat.std_msgs.msg import String
from tfbus.compat.std_srvs.srv import Empty


@contextmanager
def spinning(executor: Executor, *nodes: Any) -> Iterator[None]:
    """Spin the nodes in another thread."""

    def spin() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    for node in nodes:
        executor.add_node(node)
    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join(DEADLINE_S)


def sender(node: Any) -> Any:
    """A callback that sends odom -> base, stamped with the time now."""
    broadcaster = tf2_ros.TransformBroadcaster(node)

    def send() -> None:
        t = TransformStamped()
        t.header.stamp = node.get_clock().now().to_msg()
        t.header.frame_id, t.child_frame_id = "odom", "base"
        broadcaster.sendTransform(t)

    return send


def test_a_callback_waits_for_a_transform_that_its_own_node_sends(rclpy: ModuleType) -> None:
    """With several threads and a group, as in ROS: each message gets its transform."""
    node, buffer, found, failed = rclpy.create_node("robot"), tf2_ros.Buffer(), [], []
    tf2_ros.TransformListener(buffer, node)

    def on_scan(message: String) -> None:
        stamp = Time(nanoseconds=int(message.data))
        try:
            timeout = Duration(seconds=DEADLINE_S)
            found.append(buffer.lookup_transform("odom", "base", stamp, timeout))
        except tf2_ros.TransformException as error:
            failed.append(error)

    node.create_timer(0.01, sender(node))
    node.create_subscription(String, "scan", on_scan, 10, callback_group=ReentrantCallbackGroup())
    publisher = node.create_publisher(String, "scan", 10)
    with spinning(MultiThreadedExecutor(num_threads=2), node):
        eventually(lambda: buffer.can_transform("odom", "base", Time()))
        for number in range(1, 6):
            publisher.publish(String(data=str(node.get_clock().now().nanoseconds + 30_000_000)))
            eventually(lambda number=number: len(found) + len(failed) == number)
    assert (len(found), failed) == (5, [])


def test_a_coroutine_awaits_a_transform_that_its_own_node_sends(rclpy: ModuleType) -> None:
    """In one thread, with the callback in a group of its own."""
    node, buffer, found = rclpy.create_node("robot"), tf2_ros.Buffer(), []
    tf2_ros.TransformListener(buffer, node)

    async def on_scan(message: String) -> None:
        stamp = Time(nanoseconds=int(message.data))
        found.append(await buffer.lookup_transform_async("odom", "base", stamp))

    group = MutuallyExclusiveCallbackGroup()
    node.create_timer(0.01, sender(node))
    node.create_subscription(String, "scan", on_scan, 10, callback_group=group)
    publisher = node.create_publisher(String, "scan", 10)
    with spinning(SingleThreadedExecutor(), node):
        eventually(lambda: buffer.can_transform("odom", "base", Time()))
        for number in range(1, 6):
            publisher.publish(String(data=str(node.get_clock().now().nanoseconds + 30_000_000)))
            eventually(lambda number=number: len(found) == number)


def test_the_naive_way_is_told(rclpy: ModuleType) -> None:
    """A callback that holds up a timer in the same thread is named in the log."""
    node = rclpy.create_node("robot")
    warnings = Lines(node.tfbus_node.log)
    go_on, entered = threading.Event(), threading.Event()

    def on_scan(message: String) -> None:
        entered.set()
        go_on.wait(DEADLINE_S)

    ticks: list[int] = []
    node.create_timer(0.01, lambda: ticks.append(1))
    node.create_subscription(String, "scan", on_scan, 2)
    publisher = node.create_publisher(String, "scan", 10)
    with spinning(SingleThreadedExecutor(), node):
        publisher.publish(String(data="x"))
        assert entered.wait(DEADLINE_S)
        before = len(ticks)
        elsewhere: list[int] = []
        node.tfbus_node.create_timer(0.01, lambda: elsewhere.append(1))
        eventually(lambda: len(elsewhere) >= 5)
        for _ in range(5):
            publisher.publish(String(data="y"))
        eventually(lambda: node.tfbus_node.describe().get("delays"))
        go_on.set()
        eventually(lambda: len(ticks) > before)
        eventually(lambda: len(warnings.lines) == 3)  # the first is "ready"
    dropped, late = warnings.lines[1:]
    assert dropped.startswith("Topic scan dropped ") and "own callback" in dropped
    assert late.startswith("Timer of 10 ms (")
    assert "topic scan took" in late


def test_callbacks_of_a_reentrant_group_meet(rclpy: ModuleType) -> None:
    """Several calls of one timer run at once, in several threads."""
    node = rclpy.create_node("meets")
    meeting, met = threading.Barrier(3), []

    def tick() -> None:
        meeting.wait(DEADLINE_S)
        met.append(1)
        timer.cancel()

    timer = node.create_timer(0.001, tick, callback_group=ReentrantCallbackGroup())
    with spinning(MultiThreadedExecutor(num_threads=3), node):
        eventually(lambda: len(met) == 3)


def test_a_node_without_groups_runs_one_callback_at_a_time(rclpy: ModuleType) -> None:
    """In its default group; two nodes run beside each other."""
    executor = MultiThreadedExecutor(num_threads=4)
    meeting = threading.Barrier(2)
    inside: dict[str, list[int]] = {"a": [], "b": []}
    most: list[int] = []

    def callback(name: str) -> None:
        inside[name].append(1)
        with suppress(threading.BrokenBarrierError):
            meeting.wait(DEADLINE_S)
        most.append(len(inside[name]))
        inside[name].pop()

    nodes = [rclpy.create_node(name) for name in inside]
    for name, node in zip(inside, nodes, strict=True):
        for _ in range(2):
            node.create_timer(0.001, lambda name=name: callback(name))
    with spinning(executor, *nodes):
        eventually(lambda: len(most) >= 20)
        meeting.abort()
    assert set(most) == {1}


def test_what_a_callback_raises_in_a_thread_ends_the_spin(rclpy: ModuleType) -> None:
    """As in one thread."""
    node, executor = rclpy.create_node("fails"), MultiThreadedExecutor(num_threads=2)
    executor.add_node(node)
    node.create_timer(0.001, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        executor.spin()
    assert executor.shutdown() and not executor.get_nodes()


def test_a_coroutine_holds_its_exclusive_group(rclpy: ModuleType) -> None:
    """As in ROS: what awaits is not over; callbacks of other groups run."""
    node, awaited, ticks, others = rclpy.create_node("holds"), Future(), [], []

    async def wait() -> None:
        timer.cancel()
        await awaited

    timer = node.create_timer(0.001, wait)
    spin_until(node, timer.is_canceled)
    node.create_timer(0.001, lambda: ticks.append(1))
    node.create_timer(0.001, lambda: others.append(1), ReentrantCallbackGroup())
    spin_until(node, lambda: len(others) > 5)
    assert not ticks
    awaited.set_result(None)
    spin_until(node, lambda: ticks)


def test_a_coroutine_that_awaits_what_it_cannot_leaves_its_group(rclpy: ModuleType) -> None:
    """The error ends the spin; in the next one the node's other callbacks run."""
    node = rclpy.create_node("node")
    called = threading.Event()

    async def wrong() -> None:
        timer.cancel()
        await asyncio.sleep(0)

    timer = node.create_timer(0.01, wrong)
    with pytest.raises(TypeError, match="futures of rclpy only"):
        rclpy.spin(node)
    node.create_timer(0.01, called.set)
    spin_until(node, called.is_set)


def test_a_service_of_the_same_node_is_called_in_a_callback(rclpy: ModuleType) -> None:
    """With several threads and a group it answers; its caller blocks meanwhile."""
    node, answers = rclpy.create_node("both"), []
    client = node.create_client(Empty, "reset", callback_group=ReentrantCallbackGroup())
    node.create_service(Empty, "reset", lambda request, response: response)

    def call() -> None:
        timer.cancel()
        answers.append(client.call(Empty.Request(), timeout_sec=DEADLINE_S))

    timer = node.create_timer(0.001, call, callback_group=MutuallyExclusiveCallbackGroup())
    with spinning(MultiThreadedExecutor(num_threads=2), node):
        eventually(lambda: answers)


def test_a_client_is_awaited_in_a_callback(rclpy: ModuleType) -> None:
    """Of a service of the same node in another group, in one thread."""
    node, answers = rclpy.create_node("both"), []
    client = node.create_client(Empty, "reset")
    node.create_service(
        Empty, "reset", lambda request, response: response, callback_group=ReentrantCallbackGroup()
    )

    async def call() -> None:
        timer.cancel()
        answers.append(await client.call_async(Empty.Request()))

    timer = node.create_timer(0.001, call)
    spin_until(node, lambda: answers)


def test_the_timers_of_tfbus_go_on_while_a_ported_node_is_not_spun(rclpy: ModuleType) -> None:
    """A request that waits for the spin holds up nothing of the node underneath."""
    node, ticks, answers = rclpy.create_node("idle"), [], []
    node.create_service(Empty, "reset", lambda request, response: response)
    client = rclpy.create_node("other").create_client(Empty, "reset")
    future = client.call_async(Empty.Request())
    future.when_ended(lambda: answers.append(1))
    node.tfbus_node.create_timer(0.001, lambda: ticks.append(1))
    eventually(lambda: len(ticks) > 20)
    assert not answers
    spin_until(node, lambda: answers)


def test_a_parameter_that_is_set_while_a_node_is_not_spun_holds_up_nothing(
    rclpy: ModuleType, bus: Bus
) -> None:
    """Its callback runs once the node is spun; messages are taken meanwhile."""
    node, ticks, values = rclpy.create_node("ported"), [], []

    def take(parameters: list[Any]) -> Any:
        values.append(parameters[0].value)
        return SetParametersResult(successful=True)

    node.declare_parameter("speed", 1.0)
    node.add_on_set_parameters_callback(take)
    with suppress(TfbusError):  # it is not answered in time
        set_parameter(bus.node("setter").session, "ported", "speed", 2.0, print)
    node.tfbus_node.create_timer(0.01, lambda: ticks.append(1))
    eventually(lambda: ticks)
    spin_until(node, lambda: values == [2.0])


def test_an_executor_runs_tasks(rclpy: ModuleType) -> None:
    """Functions and coroutines; a future has the result, or what was raised."""
    executor = SingleThreadedExecutor()

    async def doubled(number: int) -> int:
        return 2 * number

    futures = [
        executor.create_task(doubled, 4),
        executor.create_task(doubled(5)),
        executor.create_task(lambda: 6),
        executor.create_task(lambda: [][0]),
    ]
    for future in futures:
        executor.spin_until_future_complete(future, timeout_sec=DEADLINE_S)
    assert [future.result() for future in futures[:3]] == [8, 10, 6]
    with pytest.raises(IndexError):
        futures[3].result()


def test_a_group_is_of_one_node(rclpy: ModuleType) -> None:
    """Another one cannot use it."""
    group = MutuallyExclusiveCallbackGroup()
    rclpy.create_node("a").create_timer(1.0, print, group)
    with pytest.raises(ValueError, match=r"of node /a.* for /b"):
        rclpy.create_node("b").create_timer(1.0, print, group)
