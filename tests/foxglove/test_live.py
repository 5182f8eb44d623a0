"""The bus as a client of Foxglove's protocol gets it."""

import json
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install websockets")

from tests.builders import S, at, moved
from tests.buses import eventually, send_until
from tests.foxglove.client import Client
from tests.simulated_bus import Bus
from tfbus import (
    Fleet,
    Node,
    ServiceError,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.foxglove.front import Serving
from tfbus.foxglove.live import LiveBridge
from tfbus.messages import Clock, PointCloud, Pose, Spawn, Twist, Vector3
from tfbus.ros.definitions import Definition
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader

POSE = Pose(1670400305709085026, 1.5, -2.0, 0.25, 0.5, -0.125)


@pytest.fixture
def bridge_node(bus: Bus) -> Node:
    """The node of the bridge."""
    return bus.node("foxglove")


@pytest.fixture
def bridge(bridge_node: Node) -> Iterator[LiveBridge]:
    """A bridge that lets clients drive on turtle1/cmd_vel."""
    bridge = LiveBridge(bridge_node, Serving(port=0), teleop=("turtle1/cmd_vel",))
    yield bridge
    bridge.close()


@pytest.fixture
def client(bridge: LiveBridge) -> Iterator[Client]:
    with Client(bridge.front.port) as client:
        yield client


def transforms_of(client: Client, topic: str) -> list[TransformStamped]:
    """All transforms that came on a topic."""
    return [each for data in client.of(topic) for each in TFMessageReader().read(data)]


# Frames


def test_frames_come_as_they_were_sent(sender: Node, client: Client) -> None:
    """With names, stamps and numbers bit by bit."""
    channel = client.subscribe("/tf")
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "tf2_msgs/msg/TFMessage")
    broadcaster = TransformBroadcaster(sender)
    sent = moved(1670400305709085026, "wörld", "turtle1", 0.1 + 0.2)
    send_until(
        lambda: broadcaster.send_transform(sent), lambda: sent in transforms_of(client, "/tf")
    )


def test_compact_frames_come_as_others_do(sender: Node, client: Client) -> None:
    """With names and stamps, within their precision."""
    client.subscribe("/tf")
    broadcaster = TransformBroadcaster(sender, poses="compact")
    sent = [moved(S, "map", "base", 0.1 + 0.2), moved(S, "base", "arm", 7.0)]
    send_until(
        lambda: broadcaster.send_transform(sent), lambda: len(transforms_of(client, "/tf")) > 1
    )
    for each in sent:
        came = [
            one for one in transforms_of(client, "/tf") if one.child_frame_id == each.child_frame_id
        ]
        assert (came[0].frame_id, came[0].stamp_ns) == (each.frame_id, S)
        assert came[0].transform.distance(each.transform) < 1e-4


def test_a_late_client_gets_statics_and_where_each_frame_is(
    sender: Node, bridge: LiveBridge
) -> None:
    """Though nothing is sent any more."""
    static, dynamic = moved(S, "base_link", "laser", 0.5), moved(2 * S, "world", "base_link", 3.0)
    StaticTransformBroadcaster(sender).send_transform(static)
    TransformBroadcaster(sender, history_s=10.0).send_transform(dynamic)
    for _ in range(2):
        with Client(bridge.front.port) as client:
            client.subscribe("/tf_static")
            client.subscribe("/tf")
            eventually(lambda: static in transforms_of(client, "/tf_static"))
            eventually(lambda: dynamic in transforms_of(client, "/tf"))


def test_the_frames_of_a_fleet_have_their_namespace_in_front(bus: Bus) -> None:
    """As a listener with a fleet names them, but for those that all share."""
    robot = bus.node("robot", namespace="robot7")
    StaticTransformBroadcaster(robot).send_transform(moved(S, "map", "base_link", 1.0))
    bridge = LiveBridge(bus.node("foxglove"), Serving(port=0), fleet=Fleet(("map",)))
    try:
        with Client(bridge.front.port) as client:
            client.subscribe("/tf_static")
            seen = moved(S, "map", "robot7/base_link", 1.0)
            eventually(lambda: seen in transforms_of(client, "/tf_static"))
    finally:
        bridge.close()


def test_a_transform_that_ros_cannot_express_is_left_out(sender: Node, client: Client) -> None:
    """A stamp after 2038; those of other frames still come."""
    client.subscribe("/tf")
    broadcaster = TransformBroadcaster(sender)
    late, good = at(1.0, "late", 2**40 * S // 256), at(2.0, "good", 5 * S)

    def send() -> None:
        broadcaster.send_transform(late)
        broadcaster.send_transform(good)

    send_until(send, lambda: good in transforms_of(client, "/tf"))
    assert {each.child_frame_id for each in transforms_of(client, "/tf")} == {"good"}


# Topics


def test_a_topic_of_a_known_type_has_its_schema_at_once(sender: Node, client: Client) -> None:
    """And its messages are equal to what was published."""
    publisher = sender.create_publisher(Pose, "turtle1/pose")
    channel = client.subscribe("/turtle1/pose")
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "tfbus_msgs/msg/Pose")
    codec = MessageCodec.of_definition(Definition(channel["schemaName"], channel["schema"]))
    send_until(lambda: publisher.publish(POSE), lambda: bool(client.of("/turtle1/pose")))
    values = codec.decode(client.of("/turtle1/pose")[0])
    assert values == asdict(POSE)


@dataclass
class Battery:
    """A message that only its publisher knows."""

    volts: float
    name: str


def test_a_topic_of_another_type_shows_its_fields(sender: Node, client: Client) -> None:
    """From its first message on."""
    publisher = sender.create_publisher(Battery, "battery")
    send_until(
        lambda: publisher.publish(Battery(12.5, "main")), lambda: "/battery" in client.channels
    )
    channel = client.subscribe("/battery")
    codec = MessageCodec.of_definition(Definition(channel["schemaName"], channel["schema"]))
    send_until(
        lambda: publisher.publish(Battery(12.5, "main")), lambda: bool(client.of("/battery"))
    )
    assert codec.decode(client.of("/battery")[0]) == {"volts": 12.5, "name": "main"}


def test_what_ros_cannot_express_comes_as_json(sender: Node, client: Client) -> None:
    """A list of different things, say."""
    import msgpack

    publisher = sender.create_raw_publisher("odd", type_name="Odd")
    payload = msgpack.packb({"things": [1, "two", None, b"\x03"], "7": {"x": float("nan")}})
    send_until(lambda: publisher.publish(payload), lambda: "/odd" in client.channels)
    assert client.subscribe("/odd")["encoding"] == "json"
    send_until(lambda: publisher.publish(payload), lambda: bool(client.of("/odd")))
    assert json.loads(client.of("/odd")[0]) == {
        "things": [1, "two", None, "Aw=="],
        "7": {"x": None},
    }


def test_the_bus_sends_only_what_a_client_watches(
    bridge_node: Node, sender: Node, client: Client
) -> None:
    """The bridge subscribes to a topic when a client does, and no longer when that is gone."""
    sender.create_publisher(Pose, "turtle1/pose")

    def subscribed() -> set[str]:
        return set(bridge_node.describe()["subscribes"])

    client.subscribe("/turtle1/pose")
    eventually(lambda: "turtle1/pose" in subscribed())
    client.unsubscribe("/turtle1/pose")
    eventually(lambda: "turtle1/pose" not in subscribed())


# Parameters


def test_parameters_are_read_set_and_followed(sender: Node, client: Client) -> None:
    """By the full name of the node and theirs; a change from elsewhere comes too."""
    parameter = sender.declare_parameter("speed", 1.5, maximum=10.0)
    client.send("subscribeParameterUpdates", parameterNames=["/sender.speed"])
    eventually(lambda: client.parameters.get("/sender.speed") == 1.5)
    client.send("setParameters", parameters=[{"name": "/sender.speed", "value": 3}], id="s")
    eventually(lambda: parameter.value == 3.0)
    eventually(lambda: client.parameters["/sender.speed"] == 3.0)
    parameter.set(4.5)
    eventually(lambda: client.parameters["/sender.speed"] == 4.5)


def test_a_value_that_a_node_refuses_is_said(sender: Node, client: Client) -> None:
    """And the client gets the value that the parameter still has."""
    sender.declare_parameter("speed", 1.5, maximum=10.0)
    client.send("subscribeParameterUpdates", parameterNames=["/sender.speed"])
    eventually(lambda: client.parameters.get("/sender.speed") == 1.5)
    client.parameters.clear()
    client.send("setParameters", parameters=[{"name": "/sender.speed", "value": 30}], id="s")
    eventually(lambda: client.said())
    [said] = client.said()
    assert said.startswith("/sender.speed ") and said.endswith("at most 10, not 30")
    eventually(lambda: client.parameters == {"/sender.speed": 1.5})


def test_an_unknown_parameter_is_said(client: Client) -> None:
    """Its name comes from a stranger: it is printable."""
    client.send("setParameters", parameters=[{"name": "/sim.\u202enonsense", "value": 1}])
    eventually(lambda: client.said())
    [said] = client.said()
    assert said.endswith(r"no parameter /sim.\u202enonsense")


# Services


def spawn(request: Spawn.Request) -> Spawn.Response:
    if request.name == "taken":
        raise ServiceError("there is a turtle of this name")
    return Spawn.Response(f"{request.name} at {request.x}")


def test_services_are_called(sender: Node, client: Client) -> None:
    """With their fields in JSON; missing ones get their defaults."""
    sender.create_service(Spawn, "spawn", spawn)
    assert client.call("/spawn", {"x": 1.5, "y": 2, "name": "a"}) == {"name": "a at 1.5"}
    schema = json.loads(client.services["/spawn"]["request"]["schema"])
    assert schema["properties"]["theta"] == {"type": "number", "default": 0.0}


def test_a_refusal_has_its_reason(sender: Node, client: Client) -> None:
    """That of the service, and of a request that it cannot have."""
    sender.create_service(Spawn, "spawn", spawn)
    assert "turtle of this name" in client.call("/spawn", {"x": 1, "y": 2, "name": "taken"})
    assert "no field 'z'" in client.call("/spawn", {"z": 1})
    assert "a JSON object" in client.call("/spawn", [1])


# The graph


def test_the_graph_has_nodes_topics_and_services(bus: Bus, sender: Node, client: Client) -> None:
    """Transforms of all streams are on /tf and /tf_static."""
    client.send("subscribeConnectionGraph")
    sender.create_publisher(Pose, "pose")
    bus.node("reader").create_subscription(Pose, "pose", lambda message: None)
    TransformBroadcaster(sender).send_transform(at())
    eventually(lambda: client.published.get("/pose") == ["/sender"])
    eventually(lambda: client.subscribed.get("/pose") == ["/reader"])
    eventually(lambda: client.published.get("/tf") == ["/sender"])


# Driving


def test_the_teleop_panel_drives(bus: Bus, client: Client) -> None:
    """In JSON and in CDR, whatever name the panel gives its topic."""
    came: list[Twist] = []
    bus.node("turtle").create_subscription(Twist, "turtle1/cmd_vel", came.append)
    client.advertise("/cmd_vel", "geometry_msgs/Twist")
    left = {"linear": {"x": 1.0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0.5}}
    twist = Twist(Vector3(1.0), Vector3(z=0.5))
    send_until(lambda: client.publish(json.dumps(left).encode()), lambda: twist in came)
    client.send("unadvertise", channelIds=[1])
    client.advertise("/turtle1/cmd_vel", "geometry_msgs/msg/Twist", "cdr")
    back = Twist(Vector3(-2.0))
    data = b"\x00\x01\x00\x00" + struct.pack("<6d", -2.0, 0, 0, 0, 0, 0)
    send_until(lambda: client.publish(data), lambda: back in came)


def test_a_client_that_is_gone_leaves_no_turtle_moving(bus: Bus, bridge: LiveBridge) -> None:
    """The last message says to stand still."""
    came: list[Twist] = []
    bus.node("turtle").create_subscription(Twist, "turtle1/cmd_vel", came.append)
    with Client(bridge.front.port) as client:
        client.advertise("/turtle1/cmd_vel", "geometry_msgs/Twist")
        send_until(lambda: client.publish(b'{"linear": {"x": 1.0}}'), lambda: bool(came))
    eventually(lambda: came[-1] == Twist())


def test_other_messages_do_not_reach_the_bus(bus: Bus, client: Client) -> None:
    """Garbage, numbers that are none, and other types are dropped, or refused with a reason."""
    came: list[Twist] = []
    bus.node("turtle").create_subscription(Twist, "turtle1/cmd_vel", came.append)
    client.advertise("/chatter", "std_msgs/String")
    eventually(lambda: client.said())
    said = client.said()[0]
    assert "/chatter takes geometry_msgs" in said and "not std_msgs/String" in said
    client.publish(b'{"data": "x"}')
    client.send("unadvertise", channelIds=[1])
    client.advertise("/cmd_vel", "geometry_msgs/Twist")
    for data in (b"\xff\x00", b"[]", b'{"linear": {"x": NaN}}', b'{"linear": 3}', b"{" * 5000):
        client.publish(data)
    good = Twist(Vector3(1.0))
    send_until(lambda: client.publish(b'{"linear": {"x": 1.0}}'), lambda: bool(came))
    assert set(came) == {good}


# Who is careless


def test_garbage_harms_neither_the_bridge_nor_other_clients(
    sender: Node, bridge: LiveBridge, client: Client
) -> None:
    """A client that sends nonsense gets an answer that says so."""
    sender.declare_parameter("speed", 1.5)
    with Client(bridge.front.port) as careless:
        for message in ("{", "[]", '{"op": "nonsense"}', b"\xff", b"\x01", b"", b"\x02" * 40):
            careless.send_raw(message)
        careless.send("subscribe", subscriptions=[{"id": 1, "channelId": 999}])
        for _ in range(300):
            careless.send("setParameters", parameters=[{"name": "/none.x", "value": 1}])
        eventually(lambda: careless.said())
        client.send("subscribeParameterUpdates", parameterNames=["/sender.speed"])
        eventually(lambda: client.parameters.get("/sender.speed") == 1.5)


def test_a_read_only_bridge_changes_nothing(bus: Bus, sender: Node) -> None:
    """Its clients see parameters, and no services."""
    parameter = sender.declare_parameter("speed", 1.5)
    sender.create_service(Spawn, "spawn", spawn)
    bridge = LiveBridge(bus.node("foxglove"), Serving(port=0), read_only=True)
    try:
        with Client(bridge.front.port) as client:
            info = eventually(lambda: client.texts_of("serverInfo"))[0]
            assert not {"services", "clientPublish"} & set(info["capabilities"])
            client.send("subscribeParameterUpdates", parameterNames=["/sender.speed"])
            eventually(lambda: client.parameters.get("/sender.speed") == 1.5)
            client.send("setParameters", parameters=[{"name": "/sender.speed", "value": 3.0}])
            eventually(lambda: client.said())
            assert "--read-only" in client.said()[0]
            assert parameter.value == 1.5 and not client.services
    finally:
        bridge.close()


# Time


def test_simulated_time_is_told(bus: Bus, sender: Node) -> None:
    """And when it is set back, clients forget what they have."""
    clock = sender.create_clock_publisher()
    bridge = LiveBridge(bus.node("foxglove", sim_time=True), Serving(port=0))
    try:
        with Client(bridge.front.port) as client:
            send_until(lambda: clock.publish(Clock(50 * S)), lambda: bool(client.times_ns))
            assert 50 * S <= client.times_ns[0] < 100 * S
            former = client.texts_of("serverInfo")
            send_until(
                lambda: clock.publish(Clock(10 * S)), lambda: len(client.texts_of("serverInfo")) > 1
            )
            assert client.texts_of("serverInfo")[1]["sessionId"] != former[0]["sessionId"]
            eventually(lambda: client.times_ns[-1] < 50 * S)
    finally:
        bridge.close()


def test_a_type_of_ros_comes_as_itself(sender: Node, client: Client) -> None:
    """By its name and definition in ROS, from the start: a standard one, and one of a package that
    only its publisher knows. Empty lists and numbers that are not finite are no obstacle.
    """
    pytest.importorskip("rosbags", reason="needs rosbags: the extra bags")
    sender.create_raw_publisher("scan", type_name="sensor_msgs/msg/LaserScan")
    sender.create_raw_publisher(
        "hand", type_name="hand_msgs/msg/Hand", definition="float32[] gaps\n"
    )
    eventually(lambda: {"/scan", "/hand"} <= set(client.channels))
    scan, hand = client.channels["/scan"], client.channels["/hand"]
    assert (scan["encoding"], scan["schemaName"]) == ("cdr", "sensor_msgs/msg/LaserScan")
    assert (hand["schemaName"], hand["schema"]) == ("hand_msgs/msg/Hand", "float32[] gaps\n")


def test_a_cloud_comes_as_others_read_it(sender: Node, client: Client) -> None:
    """By ROS's definition, with all its bytes: rosbags reads it."""
    typesys = pytest.importorskip("rosbags.typesys", reason="needs rosbags: the extra bags")
    clouds = sender.create_publisher(PointCloud, "points")
    sent = PointCloud.from_xyz(5 * S, "lidar", np.arange(30_000.0).reshape(-1, 3))
    eventually(lambda: "/points" in client.channels)
    channel = client.subscribe("/points")
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "sensor_msgs/msg/PointCloud2")
    send_until(lambda: clouds.publish(sent), lambda: client.of("/points"))
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    read = store.deserialize_cdr(client.of("/points")[0], "sensor_msgs/msg/PointCloud2")
    assert (read.header.frame_id, read.header.stamp.sec) == ("lidar", 5)
    assert [(each.name, each.offset) for each in read.fields] == [("x", 0), ("y", 4), ("z", 8)]
    assert read.data.tobytes() == sent.data.tobytes()
