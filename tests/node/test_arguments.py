"""The arguments of a node's methods are checked at once, and the right call named."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from tests.builders import at
from tests.buses import DEADLINE_S
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    BusError,
    InvalidArgumentException,
    InvalidNameError,
    Node,
    NodeSettings,
    ServiceError,
    SettingsError,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.messages import Pose, RotateAbsolute, Spawn


@pytest.fixture
def node(bus: Bus) -> Node:
    return bus.node("node")


def test_settings_of_another_type_are_refused() -> None:
    """Before it joins the bus."""
    wrong: Any = 5
    with pytest.raises(SettingsError, match=r"settings: .*NodeSettings, got int"):
        Node("node", settings=wrong)


def test_settings_in_the_place_of_the_name_are_refused() -> None:
    """With the call as it should be."""
    settings: Any = NodeSettings("node")
    with pytest.raises(SettingsError, match=r"Node\(settings=NodeSettings\(\.\.\.\)\)"):
        Node(settings)


def test_arguments_as_in_tf2_are_answered_with_the_right_call(node: Node) -> None:
    """In the order, and by the names, of tfbus; a subclass of Buffer may have such an argument."""
    buffer: Any = Buffer
    with pytest.raises(TypeError, match=r"call it as in Buffer\(cache_time_s=10.0\)"):
        buffer(cache_time=10.0)
    static: Any = StaticTransformBroadcaster(node)
    with pytest.raises(TypeError, match=r"as in send_transform\(TransformStamped\(stamp_ns, "):
        static.send_transform("map", "base", at().transform)

    class Mine(Buffer):
        def __init__(self, cache_time: float) -> None:
            super().__init__(cache_time)

    assert Mine(cache_time=3.0).cache_time_s == 3.0


def test_a_closed_node_says_so_by_its_name(node: Node) -> None:
    """Whatever it is used for."""
    static, dynamic = StaticTransformBroadcaster(node), TransformBroadcaster(node)
    dynamic.send_transform(at())
    node.close()
    for call in (
        lambda: static.send_transform(at()),
        lambda: dynamic.send_transform(at()),
        lambda: node.create_publisher(Pose, "pose"),
    ):
        with pytest.raises(BusError, match=r"publish .*'node' is closed"):
            call()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda node: node.create_timer(print, 0.1),
            "create_timer(period_s, callback): the first argument must be a number, not print",
        ),
        (
            lambda node: node.create_timer(0.1, None),
            "create_timer(period_s, callback): the last argument must be a function, not None",
        ),
        (
            lambda node: node.create_publisher("pose", Pose),
            "create_publisher(message_type, topic): message_type must be a class of messages, a "
            "dataclass such as tfbus.messages.Pose, not 'pose'",
        ),
        (
            lambda node: node.create_publisher(int, "pose"),
            "create_publisher(message_type, topic): message_type must be a class of messages, a "
            "dataclass such as tfbus.messages.Pose, not int",
        ),
        (
            lambda node: node.create_subscription(Pose(0, 0, 0, 0, 0, 0), "pose", print),
            "create_subscription(message_type, topic, callback): message_type must be a class of "
            "messages, a dataclass such as tfbus.messages.Pose, not a value of type Pose",
        ),
        (
            lambda node: node.create_subscription(Pose, "pose", 10),
            "create_subscription(message_type, topic, callback): the last argument must be a "
            "function, not 10",
        ),
        (
            lambda node: node.create_raw_subscription("pose", "x"),
            "create_raw_subscription(topic, callback): the last argument must be a function, "
            "not 'x'",
        ),
        (
            lambda node: node.create_service(Pose, "spawn", print),
            "create_service(service_type, name, handler): the type must be a class that holds the "
            "dataclasses Request and Response, not Pose",
        ),
        (
            lambda node: node.create_service(Spawn, "spawn", None),
            "create_service(service_type, name, handler): the last argument must be a function, "
            "not None",
        ),
        (
            lambda node: node.create_client("spawn", Spawn),
            "create_client(service_type, name): the type must be a class that holds the "
            "dataclasses Request and Response, not 'spawn'",
        ),
        (
            lambda node: node.create_goal_server(Spawn, "x", print),
            "create_goal_server(goal_type, name, handler): the type must be a class that holds "
            "the dataclasses Goal and Feedback and Result, not Spawn",
        ),
        (
            lambda node: node.create_goal_client(None, "x"),
            "create_goal_client(goal_type, name): the type must be a class that holds the "
            "dataclasses Goal and Feedback and Result, not None",
        ),
        (
            lambda node: node.create_client(Spawn, "spawn").call({"x": 1}),
            "service 'spawn' takes Spawn.Request, not a value of type dict",
        ),
        (
            lambda node: node.create_goal_client(RotateAbsolute, "turn").send(Spawn.Request(1, 2)),
            "action 'turn' takes RotateAbsolute.Goal, not a value of type Request",
        ),
    ],
)
def test_a_wrong_type_is_named_with_the_right_call(
    node: Node, call: Callable[[Node], object], sentence: str
) -> None:
    """The error comes where the mistake is, not with the first message."""
    with pytest.raises(TypeError) as caught:
        call(node)
    assert str(caught.value) == sentence
    assert all(not node.describe()[kind] for kind in ("publishes", "subscribes", "serves"))


def test_a_listener_says_the_order_of_its_arguments(node: Node) -> None:
    """A Buffer and a Node are easily swapped."""
    swapped: Any = (node, Buffer())
    with pytest.raises(InvalidArgumentException, match=r"\(buffer, node\), not \(Node, "):
        TransformListener(*swapped)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"history_s": "5"}, "history_s must be a number"),
        ({"fleet": True}, "must be a tfbus.Fleet"),
    ],
)
def test_a_wrong_argument_of_a_listener_is_named(
    node: Node, given: dict[str, Any], says: str
) -> None:
    """Before it listens."""
    with pytest.raises(InvalidArgumentException, match=says):
        TransformListener(Buffer(), node, **given)


@pytest.mark.parametrize("broadcaster", [TransformBroadcaster, StaticTransformBroadcaster])
@pytest.mark.parametrize("wrong", [None, Transform(), ["base"]])
def test_a_broadcaster_takes_stamped_transforms(node: Node, broadcaster: Any, wrong: Any) -> None:
    """One or several, dynamic or static."""
    with pytest.raises(InvalidArgumentException, match=r"expected tfbus\.TransformStamped"):
        broadcaster(node).send_transform(wrong)


def test_a_client_that_is_closed_asks_nothing(node: Node) -> None:
    """Though a server is there."""
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response("turtle"))
    client = node.create_client(Spawn, "spawn")
    assert client.wait_for_service(timeout_s=DEADLINE_S)
    client.close()
    with pytest.raises(BusError, match="the client of service 'spawn' is closed"):
        client.call(Spawn.Request(0.0, 0.0))


@pytest.mark.parametrize("broadcaster", [TransformBroadcaster, StaticTransformBroadcaster])
def test_a_broadcaster_takes_a_node(broadcaster: Any) -> None:
    """A name is no node."""
    with pytest.raises(InvalidArgumentException, match=r"TransformBroadcaster\(node\), not str"):
        broadcaster("node")


@pytest.mark.parametrize("name", [7, None, b"sim"])
def test_a_name_is_a_text(name: Any) -> None:
    """Names of other types are refused in one sentence."""
    with pytest.raises(InvalidNameError, match=r"node's name .* str, not"):
        NodeSettings(name)
    with pytest.raises(InvalidNameError, match=r"namespace .* str, not"):
        NodeSettings("sim", namespace=7)  # that is the test


@pytest.mark.parametrize("period_s", [math.nan, math.inf, -1, 0])
def test_a_period_is_a_positive_number(node: Node, period_s: float) -> None:
    """A timer of any other period would run without pause, or never."""
    with pytest.raises(ValueError, match="timer's period"):
        node.create_timer(period_s, print)


def test_nan_is_no_timeout(node: Node) -> None:
    """Every wait of a node refuses it at once."""
    client = node.create_client(Spawn, "spawn")
    goals = node.create_goal_client(RotateAbsolute, "turn")
    waits: list[Callable[[], object]] = [
        lambda: node.wait(math.nan),
        lambda: node.wait_for_clock(math.nan),
        lambda: client.wait_for_service(math.nan),
        lambda: client.call(Spawn.Request(1, 2), timeout_s=math.nan),
        lambda: goals.wait_for_server(math.nan),
        lambda: goals.send(RotateAbsolute.Goal(1.0), timeout_s=math.nan),
        lambda: node.session.ask("spawn", timeout_s=math.nan),
    ]
    for wait in waits:
        with pytest.raises(ValueError, match=r"timeout_s .*number"):
            wait()


def test_a_deadline_that_has_passed_waits_no_time(node: Node) -> None:
    """A negative timeout is a short one, as for Python's own locks."""
    client = node.create_client(Spawn, "spawn")
    assert node.wait(-1)
    assert not client.wait_for_service(-1)
    with pytest.raises(ServiceError, match="no service 'spawn' after 0 s"):
        client.call(Spawn.Request(1, 2), timeout_s=-1)


@pytest.mark.parametrize("timeout_s", [math.inf, None])
def test_a_call_may_wait_for_ever(bus: Bus, node: Node, timeout_s: float | None) -> None:
    """Infinity and None are timeouts without an end."""
    bus.node("server").create_service(Spawn, "spawn", lambda request: Spawn.Response("t"))
    client = node.create_client(Spawn, "spawn")
    assert client.wait_for_service(timeout_s)
    assert client.call(Spawn.Request(1, 2), timeout_s=timeout_s) == Spawn.Response("t")
