"""The adapter's nodes: callbacks, topics, services, parameters and time, as rclpy has them."""

import logging
import threading
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import pytest

from tests.buses import eventually, keep_sending, send_static
from tests.compat.spinning import publish_until, spin_until
from tests.simulated_bus import Bus
from tfbus import ServiceError, messages
from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.compat import rclpy as ported
from tfbus.compat import tf2_ros
from tfbus.compat.bus_types import BusType, bus_type_of
from tfbus.compat.example_interfaces.action import Fibonacci
from tfbus.compat.geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from tfbus.compat.rclpy.action import ActionServer
from tfbus.compat.rclpy.context import split_arguments
from tfbus.compat.rclpy.endpoints import Client, Publisher, Service, Subscription
from tfbus.compat.rclpy.exceptions import (
    NotInitializedException,
    ParameterAlreadyDeclaredException,
    ParameterNotDeclaredException,
)
from tfbus.compat.rclpy.executors import SingleThreadedExecutor
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.parameter import Parameter
from tfbus.compat.rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    qos_profile_sensor_data,
)
from tfbus.compat.rclpy.task import Future, Work
from tfbus.compat.rclpy.time import ClockType
from tfbus.compat.rclpy.type_support import GetResultServiceResponse
from tfbus.compat.rclpy.utilities import remove_ros_args
from tfbus.compat.sensor_msgs.msg import Imu, JointState
from tfbus.compat.std_msgs.msg import String
from tfbus.compat.std_srvs.srv import Trigger
from tfbus.compat.turtlesim.msg import Pose
from tfbus.compat.turtlesim.srv import Spawn
from tfbus.wire.codec import type_name


def test_a_node_before_init_is_an_error() -> None:
    """That names the call."""
    assert not ported.ok()
    with pytest.raises(NotInitializedException, match=r"rclpy\.init\(\)"):
        Node("early")


def test_init_is_once_and_shutdown_often(rclpy: ModuleType) -> None:
    """Until shutdown all is well; then it may begin again."""
    assert rclpy.ok()
    with pytest.raises(RuntimeError, match="called twice"):
        rclpy.init(args=[])
    node = rclpy.create_node("ends")
    rclpy.shutdown()
    rclpy.shutdown()
    assert not rclpy.ok() and not node.tfbus_node.ok
    with rclpy.init(args=[]) as context:
        assert context.ok() and rclpy.ok()
    assert not rclpy.ok()


def test_callbacks_run_in_the_thread_that_spins(rclpy: ModuleType) -> None:
    """And not before it spins: until then they wait."""
    node, threads = rclpy.create_node("timed"), []
    node.create_timer(0.001, lambda: threads.append(threading.current_thread()))
    other = threading.Event()
    node.tfbus_node.create_timer(0.01, other.set)
    assert other.wait(20) and not threads
    spin_until(node, lambda: len(threads) > 2)
    assert set(threads) == {threading.current_thread()}


def test_a_timer_is_cancelled_and_reset(rclpy: ModuleType) -> None:
    """Its period is known in nanoseconds."""
    node, calls = rclpy.create_node("timed"), []
    timer = node.create_timer(0.001, lambda: calls.append(1))
    assert timer.timer_period_ns == 1_000_000
    timer.cancel()
    assert timer.is_canceled()
    calls.clear()
    rclpy.spin_once(node, timeout_sec=0.05)
    assert not calls
    timer.reset()
    spin_until(node, lambda: calls)


def test_a_timer_without_autostart_begins_with_its_reset(rclpy: ModuleType) -> None:
    """Until then it calls nothing."""
    node, calls = rclpy.create_node("timed"), []
    timer = node.create_timer(0.001, lambda: calls.append(1), autostart=False)
    assert timer.is_canceled()
    rclpy.spin_once(node, timeout_sec=0.05)
    assert not calls
    timer.reset()
    spin_until(node, lambda: calls)


def test_a_timer_may_have_a_clock_of_its_own(rclpy: ModuleType) -> None:
    """As beside a simulated time that has not begun."""
    simulated = ["--ros-args", "-p", "use_sim_time:=true"]
    node, calls = rclpy.create_node("timed", cli_args=simulated), []
    steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)
    node.create_timer(0.001, lambda: calls.append("simulated"))
    node.create_timer(0.001, lambda: calls.append("steady"), clock=steady)
    spin_until(node, lambda: len(calls) > 2)
    node.create_rate(1000.0, steady).sleep()
    assert set(calls) == {"steady"}


def test_what_a_callback_raises_ends_the_spin(rclpy: ModuleType) -> None:
    """As in rclpy, and is not only logged."""
    node = rclpy.create_node("fails")
    node.create_timer(0.001, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        rclpy.spin(node)


def test_shutdown_in_a_callback_ends_the_spin(rclpy: ModuleType) -> None:
    """It returns."""
    node = rclpy.create_node("ends")
    node.create_timer(0.001, rclpy.shutdown)
    rclpy.spin(node)
    assert not rclpy.ok()


def test_a_coroutine_awaits_a_transform_and_others_run_meanwhile(rclpy: ModuleType) -> None:
    """A callback may be a coroutine; what it raises ends the spin."""
    node, buffer, found, ticks = rclpy.create_node("waits"), tf2_ros.Buffer(), [], []
    tf2_ros.TransformListener(buffer, node)

    async def look() -> None:
        timer.cancel()
        found.append(await buffer.lookup_transform_async("world", "base", rclpy.time.Time()))

    timer = node.create_timer(0.001, look)
    group = rclpy.callback_groups.ReentrantCallbackGroup()
    node.create_timer(0.001, lambda: ticks.append(1), callback_group=group)
    spin_until(node, lambda: timer.is_canceled() and len(ticks) > 2)
    assert not found
    keep_sending(node.tfbus_node, "world", "base")
    spin_until(node, lambda: found)
    assert found[0].child_frame_id == "base"


def test_done_callbacks_of_a_node_run_while_it_spins(rclpy: ModuleType) -> None:
    """In the thread that spins: a lock of the program is never taken twice in one call."""
    node, buffer, threads = rclpy.create_node("waits"), tf2_ros.Buffer(), []
    tf2_ros.TransformListener(buffer, node)
    keep_sending(node.tfbus_node, "world", "base")
    future = buffer.wait_for_transform_async("world", "base", rclpy.time.Time())
    eventually(future.done)
    future.add_done_callback(lambda _: threads.append(threading.current_thread()))
    assert not threads
    spin_until(node, lambda: threads)
    assert threads == [threading.current_thread()]


def test_a_foreign_awaitable_in_a_callback_is_an_error(rclpy: ModuleType) -> None:
    """rclpy's executor has no loop of asyncio either."""

    class Foreign:
        def __await__(self) -> Any:
            yield "foreign"

    async def waits() -> None:
        await Foreign()

    node = rclpy.create_node("waits")
    node.create_timer(0.001, waits)
    with pytest.raises(TypeError, match="futures of rclpy only"):
        rclpy.spin(node)


def test_spin_once_of_a_listener_returns_for_transforms(rclpy: ModuleType) -> None:
    """A loop of `spin_once` and lookups without any callback goes on."""
    node, buffer = rclpy.create_node("loops"), tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer, node)
    keep_sending(node.tfbus_node, "world", "base")

    def found() -> bool:
        rclpy.spin_once(node)
        return bool(buffer.can_transform("world", "base", rclpy.time.Time()))

    eventually(found)


def test_spin_once_returns_for_transforms_that_came_before(rclpy: ModuleType) -> None:
    """As messages in ROS wait for the spin: without it no `spin_once` would end."""
    node, buffer = rclpy.create_node("loops"), tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer, node)
    send_static(node.tfbus_node, "world", "base")
    eventually(lambda: buffer.can_transform("world", "base", rclpy.time.Time()))
    rclpy.spin_once(node)


def test_spin_once_of_a_listener_waits_while_no_transforms_come(rclpy: ModuleType) -> None:
    """Until a callback has run."""
    node, calls = rclpy.create_node("loops"), []
    tf2_ros.TransformListener(tf2_ros.Buffer(), node)
    node.create_timer(0.1, lambda: calls.append(1))
    rclpy.spin_once(node, timeout_sec=20.0)
    assert calls


def test_spin_thread_runs_the_callbacks_of_the_node(rclpy: ModuleType) -> None:
    """As in ROS: the main thread is free."""
    node, called = rclpy.create_node("threaded"), threading.Event()
    listener = tf2_ros.TransformListener(tf2_ros.Buffer(), node, spin_thread=True)
    node.create_timer(0.001, called.set)
    assert called.wait(20)
    listener.unregister()


def test_messages_arrive_in_ros_layout(rclpy: ModuleType, bus: Bus) -> None:
    """So do messages that tfbus has in another layout; a node of tfbus reads and writes its own."""
    node, own, got, read = rclpy.create_node("ported"), bus.node("own"), [], []
    node.create_subscription(Pose, "pose", got.append, 10)
    node.create_subscription(JointState, "joints", got.append, 10)
    own.create_subscription(messages.Twist, "cmd_vel", read.append)
    own.create_subscription(messages.JointState, "joints2", read.append)
    twist = Twist()
    twist.linear.x = 2.0
    publish_until(node, node.create_publisher(Twist, "cmd_vel", 1), twist, lambda: read)
    assert read[0] == messages.Twist(messages.Vector3(2.0))
    pose = messages.Pose(5, 1.0, 2.0, 3.0, 0.0, 0.0)
    publish_until(node, own.create_publisher(messages.Pose, "pose"), pose, lambda: got)
    assert got[0] == Pose(x=1.0, y=2.0, theta=3.0)
    got.clear()
    state = messages.JointState(1_500_000_000, ("a",), (0.5,))
    joints = own.create_publisher(messages.JointState, "joints")
    publish_until(node, joints, state, lambda: any(isinstance(it, JointState) for it in got))
    [joint, *_] = [it for it in got if isinstance(it, JointState)]
    assert (joint.name, [*joint.position], joint.header.stamp.nanosec) == (
        ["a"],
        [0.5],
        500_000_000,
    )
    read.clear()
    publisher = node.create_publisher(JointState, "joints2", 1)
    publish_until(node, publisher, joint, lambda: state in read)


def test_every_message_of_ros_goes_over_the_bus(rclpy: ModuleType) -> None:
    """Also with a header, a covariance, and a type of one's own."""

    @dataclass
    class Own:
        text: str = ""

    node, got = rclpy.create_node("ported"), []
    pose = PoseWithCovarianceStamped()
    pose.header.stamp.sec, pose.pose.covariance[35] = 7, 0.25
    for at, message in enumerate((pose, String(data="a"), Own("b"))):
        topic = f"topic{at}"
        node.create_subscription(type(message), topic, got.append, 10)
        publisher = node.create_publisher(type(message), topic, 10)
        publish_until(node, publisher, message, lambda message=message: message in got)
    with pytest.raises(TypeError, match=f"carries {type_name(Own).rpartition('.')[2]}, not"):
        publisher.publish(String())


def test_a_subscription_keeps_as_many_messages_as_its_depth() -> None:
    """The newest; each is delivered once."""
    work, got = Work(), []
    subscription = Subscription(
        work, bus_type_of(String, "text", SYSTEM_CLOCK), got.append, depth=2
    )
    for word in "abcd":
        subscription.receive(String(data=word))
    while job := work.take():
        work.run(job)
    assert got == [String(data="c"), String(data="d")]


def test_a_message_that_comes_while_another_is_delivered_is_delivered_too() -> None:
    """Also where the subscription was full a moment before."""
    work, got, string = Work(), [], bus_type_of(String, "text", SYSTEM_CLOCK)

    def from_bus(message: String) -> String:
        # The thread that spins takes the message before, just now.
        if job := work.take():
            work.run(job)
        return message

    on_bus = BusType(String, string.to_bus, from_bus)
    subscription = Subscription(work, on_bus, got.append, depth=1)
    for word in "abc":
        subscription.receive(String(data=word))
    while job := work.take():
        work.run(job)
    assert got == [String(data=word) for word in "abc"]


def test_transient_local_is_retained(rclpy: ModuleType) -> None:
    """A subscription that comes later gets the last message."""
    node, got = rclpy.create_node("late"), []
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_publisher(String, "latched", qos).publish(String(data="kept"))
    node.create_subscription(String, "latched", got.append, qos)
    spin_until(node, lambda: got == [String(data="kept")])


def test_qos_that_is_not_applied_is_said_once(
    rclpy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """For each topic; what is no QoS is an error."""
    node = rclpy.create_node("qos")
    for _ in range(2):
        node.create_subscription(String, "scan", print, qos_profile_sensor_data)
    [line] = [each for each in capsys.readouterr().err.splitlines() if "'scan'" in each]
    assert " BEST_EFFORT" in line
    with pytest.raises(TypeError, match="QoSProfile or a depth"):
        node.create_publisher(String, "scan", "reliable")


def test_a_service_is_called_from_a_callback_of_another_node(rclpy: ModuleType) -> None:
    """`call_async` with a future, and its done callback."""
    node, names = rclpy.create_node("serves"), []

    def spawn(request: Any, response: Any) -> Any:
        response.name = f"{request.name} at {request.x:g}"
        return response

    node.create_service(Spawn, "spawn", spawn)
    caller = rclpy.create_node("calls")
    client = caller.create_client(Spawn, "spawn")
    assert client.wait_for_service(20.0) and client.service_is_ready()
    future = client.call_async(Spawn.Request(name="turtle2", x=4.0))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(future)
    future.add_done_callback(lambda done: names.append(done.result().name))
    spin_until(caller, lambda: names)
    assert names == ["turtle2 at 4"]


def test_calls_wait_for_the_service_in_one_thread(rclpy: ModuleType) -> None:
    """However many there are; those that are cancelled meanwhile are left out."""
    node, names = rclpy.create_node("serves"), []
    client = rclpy.create_node("calls").create_client(Spawn, "spawn")
    before = set(threading.enumerate())
    futures = [client.call_async(Spawn.Request(name=str(at))) for at in range(20)]
    calling = [each for each in set(threading.enumerate()) - before if "spawn" in each.name]
    assert len(calling) == 1
    futures[10].cancel()

    def spawn(request: Any, response: Any) -> Any:
        names.append(request.name)
        return response

    node.create_service(Spawn, "spawn", spawn)
    spin_until(node, lambda: all(each.done() for each in futures))
    assert names == [str(at) for at in range(20) if at != 10]
    eventually(lambda: not calling[0].is_alive())


def test_calls_of_a_destroyed_client_end(rclpy: ModuleType) -> None:
    """Also where there never was a service."""
    client = rclpy.create_node("calls").create_client(Spawn, "spawn")
    futures = [client.call_async(Spawn.Request()) for _ in range(3)]
    client.destroy()
    eventually(lambda: all(each.done() for each in futures))
    with pytest.raises(ServiceError, match="'spawn' is closed"):
        futures[-1].result()


def test_a_service_that_fails_tells_the_caller(rclpy: ModuleType) -> None:
    """And ends the spin of its own node with what it raised."""
    node = rclpy.create_node("serves")
    node.create_service(Spawn, "spawn", lambda request, response: 1 / 0)
    future = rclpy.create_node("calls").create_client(Spawn, "spawn").call_async(Spawn.Request())
    with pytest.raises(ZeroDivisionError):
        rclpy.spin_until_future_complete(node, future)
    eventually(future.done)
    with pytest.raises(ServiceError, match="ZeroDivisionError: division by zero"):
        future.result()


def test_a_coroutine_serves(rclpy: ModuleType) -> None:
    """It answers when it ends."""
    node, opens = rclpy.create_node("serves"), Future()

    async def spawn(request: Any, response: Any) -> Any:
        response.name = await opens
        return response

    node.create_service(Spawn, "spawn", spawn)
    node.create_timer(0.001, lambda: opens.set_result("later"))
    future = rclpy.create_node("calls").create_client(Spawn, "spawn").call_async(Spawn.Request())
    rclpy.spin_until_future_complete(node, future)
    assert future.result().name == "later"


def test_spin_until_future_complete_ends_in_time(rclpy: ModuleType) -> None:
    """With a future that never ends."""
    future = Future()
    rclpy.spin_until_future_complete(rclpy.create_node("waits"), future, timeout_sec=0.01)
    assert not future.done()


def test_parameters_have_values_of_their_type(rclpy: ModuleType) -> None:
    """Read by `.value` and by the field of the type."""
    node = rclpy.create_node("has_parameters")
    declared = node.declare_parameter("name", "turtle1")
    assert declared.value == declared.get_parameter_value().string_value == "turtle1"
    node.declare_parameters("drive", [("speed", 2.0), ("gears", [1, 2])])
    assert node.get_parameter("drive.speed").get_parameter_value().double_value == 2.0
    value = node.get_parameter("drive.gears").get_parameter_value()
    assert value.integer_array_value == [1, 2]
    assert value.type == Parameter.Type.INTEGER_ARRAY
    node.set_parameters([Parameter("name", Parameter.Type.STRING, "turtle2")])
    assert node.get_parameter("name").value == "turtle2"
    assert node.get_parameter_or("none", 5) == 5 and not node.has_parameter("none")
    assert node.get_parameter("use_sim_time").value is False
    node.set_parameters([Parameter("use_sim_time", Parameter.Type.BOOL, False)])  # as it is
    [refused] = node.set_parameters([Parameter("use_sim_time", Parameter.Type.BOOL, True)])
    assert not refused.successful and "TFBUS_SIM_TIME=1" in refused.reason


def test_mistakes_with_parameters_are_errors(rclpy: ModuleType) -> None:
    """Undeclared, declared twice, without a default, of no type."""
    node = rclpy.create_node("has_parameters")
    node.declare_parameter("a", 1)
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter("b")
    with pytest.raises(ParameterAlreadyDeclaredException):
        node.declare_parameter("a", 1)
    with pytest.raises(TypeError, match="ignore_override"):
        rclpy.create_node("given", cli_args=["--ros-args", "-p", "a:=2"]).declare_parameter(
            "a", 1, ignore_override=True
        )
    with pytest.raises(TypeError, match="must be a bool"):
        Parameter("b", None, object())
    with pytest.raises(ValueError, match="INTEGER and not STRING"):
        Parameter("b", Parameter.Type.STRING, 1)


@pytest.mark.parametrize(
    ("args", "own", "of_nodes"),
    [
        ([], [], []),
        (["prog", "a", "--ros-args", "-p", "b:=1"], ["prog", "a"], ["--ros-args", "-p", "b:=1"]),
        (["--ros-args", "-r", "a:=b", "--", "c"], ["c"], ["--ros-args", "-r", "a:=b", "--"]),
        (
            ["prog", "--name", "n", "--sim-time", "--param", "a=1", "rest", "--name", "x"],
            ["prog", "rest", "--name", "x"],
            ["--name", "n", "--sim-time", "--param", "a=1"],
        ),
        (["--param", "a=1"], ["--param", "a=1"], []),
    ],
)
def test_arguments_of_nodes_are_known(args: list[str], own: list[str], of_nodes: list[str]) -> None:
    """Nodes know the arguments of ROS, and those that `tfbus launch` puts first; the program has
    all others.
    """
    assert split_arguments(args) == (own, of_nodes)
    assert remove_ros_args(args) == own


def test_arguments_name_and_set_up_a_node(bus: Bus) -> None:
    """Its parameters, name and namespace, also over what the program says."""
    with ported.init(args=["--ros-args", "-p", "a:=2", "-r", "__node:=b", "-r", "__ns:=/c"]):
        node = Node("given", namespace="other")
        assert node.get_fully_qualified_name() == "/c/b"
        assert (node.get_name(), node.get_namespace()) == ("b", "/c")
        assert node.declare_parameter("a", 1).value == 2


def test_simulated_time_is_the_time_of_the_node(rclpy: ModuleType, bus: Bus) -> None:
    """Its times are ROS_TIME, and `use_sim_time` says so."""
    node = Node("simulated", cli_args=["--ros-args", "-p", "use_sim_time:=true"])
    assert node.get_parameter("use_sim_time").value and node.get_clock().ros_time_is_active
    clock = bus.node("time").create_clock_publisher()

    def is_set() -> bool:
        clock.publish(messages.Clock(5_000_000_000))
        return bool(node.get_clock().now().nanoseconds)

    eventually(is_set)


def test_a_pose_has_the_stamp_of_the_clock_of_the_node(rclpy: ModuleType, bus: Bus) -> None:
    """Simulated where the node's is: in ROS it has none."""
    node = Node("simulated", cli_args=["--ros-args", "-p", "use_sim_time:=true"])
    own, read = bus.node("own"), []
    own.create_subscription(messages.Pose, "pose", read.append)
    clock = own.create_clock_publisher()
    pose = node.create_publisher(Pose, "pose", 1)

    def is_stamped() -> bool:
        clock.publish(messages.Clock(5_000_000_000))
        pose.publish(Pose(x=1.0))
        return bool(read) and read[-1].stamp_ns != 0

    eventually(is_stamped)
    assert read[-1].stamp_ns == 5_000_000_000
    now = node.get_clock().now()
    assert now.seconds_nanoseconds() == (5, 0) and now.clock_type == ClockType.ROS_TIME


def test_lines_of_a_log_can_be_left_out(
    rclpy: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once, from the second on, or again only after some time, for each place in the program."""
    log = rclpy.create_node("talks").get_logger()
    for _ in range(3):
        log.info("100% once", once=True)
        log.warn("throttled", throttle_duration_sec=60.0)
        log.error("not the first\nof lines", skip_first=True)
        log.debug("not shown")
    said = capsys.readouterr().err
    assert [said.count(word) for word in ("100% once", "throttled", "first", "shown")] == [
        1,
        1,
        2,
        0,
    ]
    assert "[WARN]" in said and "[ERROR]" in said
    with pytest.raises(TypeError, match="a log takes once"):
        log.info("text", every=5)
    log.set_level(logging.ERROR)
    assert not log.info("less") and log.error("more")
    assert "less" not in capsys.readouterr().err


def test_what_a_node_lacks_says_what_to_use(rclpy: ModuleType) -> None:
    """Names of rclpy's, and any other."""
    node = rclpy.create_node("lacks")
    with pytest.raises(AttributeError, match=r"work\.submit"):
        node.create_guard_condition(print)
    with pytest.raises(AttributeError, match=r"node\.tfbus_node"):
        node.nonsense  # noqa: B018  # the access is the test
    with pytest.raises(TypeError, match="take parameters_by_magic"):
        Node("lacks2", parameters_by_magic=True)
    with pytest.raises(TypeError, match="does not take domain"):
        rclpy.init(domain=5)
    with pytest.raises(NotImplementedError, match="jump"):
        node.get_clock().create_jump_callback(None)


def test_what_was_destroyed_calls_back_no_longer(rclpy: ModuleType) -> None:
    """Topics, services and timers end, also for what waits already; then the node."""
    node, got = rclpy.create_node("ends"), []
    subscription = node.create_subscription(String, "words", got.append, 10)
    publisher = node.create_publisher(String, "words", 1)
    publish_until(node, publisher, String(), lambda: got)
    node.destroy_subscription(subscription)
    got.clear()
    publisher.publish(String())
    rclpy.spin_once(node, timeout_sec=0.05)
    assert not got
    timer = node.create_timer(0.001, lambda: got.append(1))
    service = node.create_service(Spawn, "spawn", print)
    client = node.create_client(Spawn, "spawn")
    assert node.destroy_timer(timer) and node.destroy_service(service)
    assert node.destroy_client(client) and node.destroy_publisher(publisher)
    with node:
        pass
    assert not node.tfbus_node.ok


def test_a_rate_sleeps_until_the_next_period(rclpy: ModuleType) -> None:
    """By the clock of the node."""
    node = rclpy.create_node("rated")
    begun_ns = node.tfbus_node.clock.elapsed_ns()
    rate = node.create_rate(100)
    for _ in range(3):
        rate.sleep()
    assert node.tfbus_node.clock.elapsed_ns() - begun_ns >= 29_000_000


def test_what_there_is_is_listed(rclpy: ModuleType, bus: Bus) -> None:
    """With ROS's names: nodes, topics and services, and how many are at a topic."""
    node, other = rclpy.create_node("asks"), rclpy.create_node("arm", namespace="robot7")
    other.create_publisher(Imu, "imu", 10)
    other.create_service(Trigger, "home", lambda request, response: response)
    other.create_subscription(PoseStamped, "/goal_pose", lambda message: None, 10)
    own = bus.node("sim")
    own.create_service(messages.Empty, "reset", lambda request: messages.Empty.Response())
    keep_sending(own, "map", "base")
    ActionServer(other, Fibonacci, "count", lambda handle: Fibonacci.Result())
    topics = {
        "/goal_pose": ["geometry_msgs/msg/PoseStamped"],
        "/robot7/imu": ["sensor_msgs/msg/Imu"],
        "/tf": ["tf2_msgs/msg/TFMessage"],
    }
    eventually(lambda: dict(node.get_topic_names_and_types()) == topics)
    services = {"/reset": ["std_srvs/srv/Empty"], "/robot7/home": ["std_srvs/srv/Trigger"]}
    eventually(lambda: dict(node.get_service_names_and_types()) == services)
    nodes = {("asks", "/"), ("arm", "/robot7"), ("sim", "/")}
    eventually(lambda: {*node.get_node_names_and_namespaces()} == nodes)
    assert sorted(node.get_node_names()) == ["arm", "asks", "sim"]
    assert node.count_publishers("/robot7/imu") == other.count_publishers("imu") == 1
    assert node.count_subscribers("goal_pose") == 1 and node.count_publishers("goal_pose") == 0


def test_classes_take_types_in_brackets() -> None:
    """As annotations of programs for ROS 2 since Jazzy have them."""
    for each in (Future, Publisher, Subscription, Client, Service, ActionServer, Parameter):
        assert each[int].__origin__ is each  # type: ignore[index]
    assert Future[GetResultServiceResponse[int]].__args__
