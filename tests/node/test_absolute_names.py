"""Names with a leading slash, and private ones, as a user of ROS writes them."""

from dataclasses import dataclass

import pytest

from tests.buses import eventually, send_until
from tests.simulated_bus import Bus
from tfbus import GoalHandle, InvalidNameError, Node
from tfbus.bus.graph import graph_of
from tfbus.bus.presence import ask_nodes
from tfbus.messages import Clock, RotateAbsolute, Spawn


@dataclass(frozen=True)
class Number:
    value: int


def heard(publisher: Node, topic: str, subscriber: Node, other_topic: str) -> bool:
    """Whether what the one node publishes reaches the other."""
    received: list[Number] = []
    subscriber.create_subscription(Number, other_topic, received.append)
    sending = publisher.create_publisher(Number, topic)
    send_until(lambda: sending.publish(Number(7)), lambda: bool(received))
    return received[0] == Number(7)


@pytest.mark.parametrize(
    ("namespace", "topic", "other_namespace", "other_topic"),
    [
        ("", "/count", "", "count"),
        ("", "/robot7/count", "robot7", "count"),
        ("robot7", "/robot7/count", "robot7", "count"),
        ("robot7", "/count", "", "count"),
        ("robot7", "/robot8/count", "robot8", "count"),
        ("robot7", "count", "robot8", "/robot7/count"),
        ("", "~/count", "", "one/count"),
        ("robot7", "~/count", "", "/robot7/one/count"),
    ],
)
def test_an_absolute_topic_ignores_the_namespace(
    bus: Bus, namespace: str, topic: str, other_namespace: str, other_topic: str
) -> None:
    """A slash begins a name outside of the node's namespace, as in ROS."""
    one = bus.node("one", namespace=namespace)
    other = bus.node("other", namespace=other_namespace)
    assert heard(one, topic, other, other_topic)


def test_services_and_actions_are_reached_across_namespaces(bus: Bus) -> None:
    """A client finds a server of another namespace by its absolute name."""
    server = bus.node("server", namespace="robot7")
    client = bus.node("client", namespace="robot8")

    def rotate(handle: GoalHandle) -> None:
        handle.succeed(RotateAbsolute.Result(handle.request.theta))

    server.create_service(Spawn, "/spawn", lambda request: Spawn.Response(request.name))
    server.create_goal_server(RotateAbsolute, "rotate", rotate)
    spawn = client.create_client(Spawn, "/spawn")
    turn = client.create_goal_client(RotateAbsolute, "/robot7/rotate")
    response = spawn.call(Spawn.Request(1.0, 2.0, name="t"), timeout_s=20.0)
    assert response == Spawn.Response("t")
    result = turn.send(RotateAbsolute.Goal(0.5), timeout_s=20.0).result(timeout_s=20.0)
    assert (result.status, result.result) == ("succeeded", RotateAbsolute.Result(0.5))


def test_an_absolute_name_can_be_remapped_and_remapped_to(bus: Bus) -> None:
    """Remappings compare full names, whatever way they are written."""
    one = bus.node("one", namespace="robot7", remappings={"/robot7/count": "/numbers"})
    other = bus.node("other", remappings={"~/count": "/numbers"})
    assert heard(one, "count", other, "other/count")


def test_absolute_names_are_listed_where_they_are(bus: Bus) -> None:
    """A node in a namespace lists its absolute topics, and the graph shows them without it."""
    one = bus.node("one", namespace="robot7")
    one.create_publisher(Number, "/count")
    one.create_publisher(Number, "/robot7/pose")
    assert one.describe()["publishes"] == {"/count": "Number", "pose": "Number"}
    viewer = bus.node("viewer")
    nodes = eventually(
        lambda: [n for n in ask_nodes(viewer.session).nodes if n.name == "/robot7/one"]
    )
    assert sorted(graph_of(nodes, {}).topics) == ["count", "robot7/pose"]
    assert sorted(graph_of(nodes, {}, "robot7").topics) == ["/count", "pose"]


def test_what_a_second_session_has_declared_ends_with_the_node(bus: Bus) -> None:
    """The session that reaches other namespaces closes with its node's."""
    node = bus.node("one", namespace="robot7")
    node.create_publisher(Number, "/count")
    session, _ = node.session.placed("/count")
    assert session is not node.session
    node.close()
    assert session.zenoh.is_closed()


def test_a_node_without_absolute_names_has_one_session(bus: Bus) -> None:
    """A second session opens with the first name that needs it."""
    node = bus.node("one", namespace="robot7")
    node.create_publisher(Number, "/robot7/count")
    assert node.session.placed("/robot7/count") == (node.session, "count")


@pytest.mark.parametrize("topic", ["/", "//count", "/a//b", "~", "a/~/b\x1b", "~other\x00"])
def test_absolute_names_are_checked(bus: Bus, topic: str) -> None:
    """What no topic can be called is refused after a slash too."""
    with pytest.raises(InvalidNameError):
        bus.node("one").create_publisher(Number, topic)


def test_the_clock_can_be_one_topic_for_all(bus: Bus) -> None:
    """Remapped to an absolute name, as `/clock` in ROS, it reaches nodes of any namespace."""
    publisher = bus.node("clock", namespace="robot7", remappings={"clock": "/clock"})
    follower = bus.node(
        "follower", namespace="robot8", remappings={"clock": "/clock"}, sim_time=True
    )
    clock = publisher.create_clock_publisher()
    clock.publish(Clock(5_000_000_000, 1.0, False))
    assert follower.wait_for_clock(20.0)
    assert follower.now_ns() == 5_000_000_000
