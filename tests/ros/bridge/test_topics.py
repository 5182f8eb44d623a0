"""Topics between the bus and a ROS in memory."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.buses import eventually, send_until
from tests.ros.bridge.conftest import Bridged
from tests.ros.bridge.fake_leg import FakeLeg, FakeRos
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import (
    JointState,
    Odometry,
    Pose,
    PoseStamped,
    RobotDescription,
    Twist,
    Vector3,
)
from tfbus.ros.bridge.common import BridgeOptions, RosFrameNames
from tfbus.ros.bridge.from_ros import with_odometry_frames
from tfbus.ros.bridge.legs import RosTopic
from tfbus.ros.bridge.topic_table import TopicTable
from tfbus.ros.bridge.topics import TopicBridge
from tfbus.ros.definitions import (
    ODOMETRY,
    POSE_STAMPED,
    STRING,
    TF_MESSAGE,
    TURTLE_POSE,
    TWIST,
    Definition,
)
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader

FORWARD = {
    "linear": {"x": 2.0, "y": 0.0, "z": 0.0},
    "angular": {"x": 0.0, "y": 0.0, "z": 0.5},
}
TWIST_CODEC = MessageCodec.of_definition(TWIST)
STATE = JointState(1_795_354_648_223_567_966, ("a", "b"), (0.5, -1.0))


class RosNode:
    """A node in ROS that reads and writes topics as maps."""

    def __init__(self, leg: FakeLeg) -> None:
        self.leg = leg
        self.got: list[Any] = []

    def listen(self, name: str, definition: Definition, *, retained: bool = False) -> None:
        """Keep what comes on a topic in `got`."""
        codec = MessageCodec.of_definition(definition)
        self.leg.subscribe(
            RosTopic(name, definition, retained),
            lambda payload, gid: self.got.append(codec.decode(payload)),
        )

    def publisher(
        self, name: str, definition: Definition, *, retained: bool = False
    ) -> Callable[[dict[str, Any]], None]:
        """A function that publishes values on a topic."""
        codec = MessageCodec.of_definition(definition)
        sender = self.leg.publisher(RosTopic(name, definition, retained, 1 if retained else 100))

        def publish(values: dict[str, Any]) -> None:
            message = codec.encode(values)
            assert message is not None
            sender.send(message)

        return publish


@pytest.fixture
def ros() -> Iterator[FakeRos]:
    ros = FakeRos()
    yield ros
    ros.close()


@pytest.fixture
def node(ros: FakeRos) -> RosNode:
    """A node of ROS's own."""
    return RosNode(ros.leg("turtlesim"))


class Bridges:
    """Makes bridges between the bus and ROS."""

    def __init__(self, bus: Bus, ros: FakeRos) -> None:
        self._bus = bus
        self._ros = ros
        self._made: list[TopicBridge] = []

    def __call__(
        self,
        name: str = "ros2",
        *,
        to_ros: bool = True,
        from_ros: bool = True,
        table: TopicTable | None = None,
        tells: bool = True,
        namespace: str = "",
        ros_namespace: str = "",
        **options: Any,
    ) -> TopicBridge:
        node = self._bus.node(name, namespace=namespace)
        node.create_raw_publisher("ros_bridges", type_name="RosBridge", retained=True)
        bridge = TopicBridge(
            node,
            self._ros.leg(f"tfbus_{name}", tells_publishers=tells),
            table or TopicTable(),
            to_ros=to_ros,
            from_ros=from_ros,
            ros_namespace=ros_namespace,
            log=node.log,
            **options,
        )
        self._made.append(bridge)
        return bridge

    def close(self) -> None:
        """End them."""
        for bridge in self._made:
            bridge.close()


@pytest.fixture
def bridges(bus: Bus, ros: FakeRos) -> Iterator[Bridges]:
    bridges = Bridges(bus, ros)
    yield bridges
    bridges.close()


class Log:
    """What is logged, up to now."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys
        self._text = ""

    @property
    def text(self) -> str:
        self._text += self._capsys.readouterr().err
        return self._text


@pytest.fixture
def log(capsys: pytest.CaptureFixture[str]) -> Log:
    """What is logged."""
    return Log(capsys)


def heard(receiver: Node, message_type: type, topic: str, *, retained: bool = False) -> list[Any]:
    """What comes on a topic of the bus from now on."""
    got: list[Any] = []
    receiver.create_subscription(message_type, topic, got.append, retained=retained)
    return got


# To ROS


def test_a_pose_of_a_turtle_goes_to_turtlesim(
    bridges: Bridges, sender: Node, node: RosNode
) -> None:
    """Found by its type, under its own name, as turtlesim writes it."""
    bridges()
    node.listen("/turtle1/pose", TURTLE_POSE)
    poses = sender.create_publisher(Pose, "turtle1/pose")
    send_until(lambda: poses.publish(Pose(5, 1.5, -2.0, 0.25, 0.5, 0.1)), lambda: bool(node.got))
    assert node.got[0] == {
        "x": 1.5,
        "y": -2.0,
        "theta": 0.25,
        "linear_velocity": 0.5,
        "angular_velocity": 0.10000000149011612,
    }


def test_namespaces_are_those_of_each_side(bridges: Bridges, bus: Bus, node: RosNode) -> None:
    """What robot7 has on the bus is below its namespace in ROS."""
    bridges(namespace="robot7", ros_namespace="r7")
    node.listen("/r7/cmd_vel", TWIST)
    twists = bus.node("nav", namespace="robot7").create_publisher(Twist, "cmd_vel")
    send_until(
        lambda: twists.publish(Twist(Vector3(x=2.0), Vector3(z=0.5))), lambda: bool(node.got)
    )
    assert node.got[0] == FORWARD


def test_a_description_reaches_late_ones_of_ros(
    bridges: Bridges, sender: Node, node: RosNode, ros: FakeRos
) -> None:
    """It is retained there as well."""
    bridge = bridges()
    sender.create_publisher(RobotDescription, "robot_description", retained=True).publish(
        RobotDescription("<robot name='r'/>")
    )
    eventually(lambda: bridge.crossing()[0] == ["robot_description"])
    node.listen("/robot_description", STRING, retained=True)
    eventually(lambda: node.got == [{"data": "<robot name='r'/>"}])


def test_a_name_that_ros_cannot_have_is_said(bridges: Bridges, sender: Node, log: Log) -> None:
    """Once, with the topic."""
    bridges()
    poses = sender.create_publisher(Pose, "turtle-1/pose")
    send_until(
        lambda: poses.publish(Pose(5, 1.5, -2.0, 0.25, 0.5, 0.1)),
        lambda: "'turtle-1/pose' does not cross: ROS cannot have that name" in log.text,
    )


def test_a_message_that_does_not_fit_is_dropped(
    bridges: Bridges,
    sender: Node,
    node: RosNode,
    log: Log,
) -> None:
    """And said once; the next goes on."""
    bridges()
    node.listen("/cmd_vel", TWIST)
    raw = sender.create_raw_publisher("cmd_vel", type_name="Twist")
    send_until(
        lambda: raw.publish(b"\x81\xa6linear\x01"),
        lambda: "Dropped a message on topic 'cmd_vel' on its way to ROS" in log.text,
    )
    twists = sender.create_publisher(Twist, "cmd_vel")
    send_until(lambda: twists.publish(Twist()), lambda: bool(node.got))


def test_another_type_under_a_name_of_the_table_is_said(
    bridges: Bridges, sender: Node, log: Log
) -> None:
    """With what would fit."""
    bridges()
    sender.create_raw_publisher("cmd_vel", type_name="Speed")
    eventually(lambda: "on the bus it carries Speed; Twist is what becomes a" in log.text)


# From ROS


def test_ros_drives_a_turtle(bridges: Bridges, receiver: Node, node: RosNode) -> None:
    """What the bus subscribes to is looked for in ROS, whatever its name."""
    bridges()
    got = heard(receiver, Twist, "turtle7/cmd_vel")
    publish = node.publisher("/turtle7/cmd_vel", TWIST)
    send_until(lambda: publish(FORWARD), lambda: bool(got))
    assert got[0] == Twist(Vector3(x=2.0), Vector3(z=0.5))


def test_a_message_without_a_stamp_gets_that_of_its_arrival(
    bridges: Bridges, receiver: Node, node: RosNode
) -> None:
    """A turtlesim/msg/Pose has none."""
    bridges()
    got = heard(receiver, Pose, "turtle1/pose")
    before_ns = receiver.now_ns()
    publish = node.publisher("/turtle1/pose", TURTLE_POSE)
    pose = {"x": 1.0, "y": 2.0, "theta": 0.5, "linear_velocity": 0.0, "angular_velocity": 0.0}
    send_until(lambda: publish(pose), lambda: bool(got))
    assert before_ns <= got[0].stamp_ns <= receiver.now_ns()
    assert (got[0].x, got[0].y, got[0].theta) == (1.0, 2.0, 0.5)


def test_a_description_of_ros_reaches_late_ones_of_the_bus(
    bridges: Bridges, bus: Bus, node: RosNode
) -> None:
    """Its retained message comes, though the bridge was not there yet."""
    node.publisher("/robot_description", STRING, retained=True)({"data": "<robot name='r'/>"})
    bridge = bridges()
    eventually(lambda: bridge.crossing()[1] == ["robot_description"])
    got = heard(bus.node("late"), RobotDescription, "robot_description", retained=True)
    eventually(lambda: got == [RobotDescription("<robot name='r'/>")])


def odometry(*, x: float, z: float = 0.0, w: float = 1.0) -> dict[str, Any]:
    """A nav_msgs/msg/Odometry."""
    return {
        "header": {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "odom"},
        "child_frame_id": "base_link",
        "pose": {
            "pose": {
                "position": {"x": x, "y": 0.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": z, "w": w},
            },
            "covariance": [0.25] + [0.0] * 35,
        },
        "twist": {"twist": FORWARD, "covariance": [0.0] * 36},
    }


def test_odometry_comes(bridges: Bridges, receiver: Node, node: RosNode, log: Log) -> None:
    """With its covariances; one without a rotation is dropped and said."""
    bridges()
    got = heard(receiver, Odometry, "odom")
    publish = node.publisher("/odom", ODOMETRY)
    send_until(lambda: publish(odometry(x=1.5)), lambda: bool(got))
    assert got[0].stamp_ns == 7_000_000_005
    assert got[0].pose.covariance[:2] == (0.25, 0.0)
    assert got[0].twist.twist == Twist(Vector3(x=2.0), Vector3(z=0.5))
    publish(odometry(x=1.5, w=0.0))
    eventually(lambda: "orientation must be a unit quaternion" in log.text)


def test_frames_in_messages_have_the_prefix_on_the_bus(
    bridges: Bridges, receiver: Node, sender: Node, node: RosNode, log: Log
) -> None:
    """As frames on /tf have; on the way to ROS it is taken off, and another frame stays here."""
    names = RosFrameNames(BridgeOptions(frame_prefix="r1/"))
    bridges(names=names)
    got = heard(receiver, Odometry, "odom")
    publish = node.publisher("/odom", ODOMETRY)
    send_until(lambda: publish(odometry(x=1.5)), lambda: bool(got))
    assert (got[0].frame_id, got[0].child_frame_id) == ("r1/odom", "r1/base_link")
    node.listen("/goal_pose", POSE_STAMPED)
    goals = sender.create_publisher(PoseStamped, "goal_pose")
    send_until(lambda: goals.publish(PoseStamped(5, "r1/map")), lambda: bool(node.got))
    assert node.got[0]["header"]["frame_id"] == "map"
    names.met("map")
    goals.publish(PoseStamped(5, "map"))
    eventually(lambda: "ROS has another frame 'map'" in log.text)


def test_poses_of_odometry_are_frames_where_asked(ros: FakeRos, node: RosNode) -> None:
    """As if their publisher sent them on /tf, beside what others send there."""
    leg = with_odometry_frames(ros.leg("tfbus_ros2"), TopicTable(), "r7")
    got: list[tuple[Any, str]] = []
    read = TFMessageReader().read
    subscription = leg.subscribe(
        RosTopic("/r7/tf", TF_MESSAGE), lambda payload, gid: got.append((*read(payload), gid))
    )
    node.publisher("/r7/odom", ODOMETRY)(odometry(x=1.5))
    eventually(lambda: got)
    transform, gid = got[0]
    assert (transform.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert (transform.stamp_ns, list(transform.transform.xyz)) == (7_000_000_005, [1.5, 0.0, 0.0])
    assert [(each.gid, each.node) for each in leg.publishers("/r7/tf")] == [(gid, "/turtlesim")]
    subscription.close()


# Both ways


@pytest.mark.parametrize("tells", [True, False])
def test_nothing_comes_back(
    bridges: Bridges, sender: Node, receiver: Node, node: RosNode, ros: FakeRos, tells: bool
) -> None:
    """Both sides publish a topic and both read it: each gets the other's messages, once."""
    bridge = bridges(tells=tells)
    got = heard(receiver, Twist, "cmd_vel")

    def xs_of_bus() -> list[float]:
        return [each.linear.x for each in got]

    def xs_of_ros() -> list[float]:
        return [each["linear"]["x"] for each in node.got]

    node.listen("/cmd_vel", TWIST)
    here = sender.create_publisher(Twist, "cmd_vel")
    there = node.publisher("/cmd_vel", TWIST)
    eventually(lambda: bridge.crossing() == (["cmd_vel"], ["cmd_vel"]))
    send_until(
        lambda: (here.publish(Twist(Vector3(x=1.0))), there(FORWARD)),
        lambda: {each.linear.x for each in got} == {1.0, 2.0} and bool(node.got),
    )
    ros.settle()
    for number in range(5):
        here.publish(Twist(Vector3(x=100.0 + number)))
        eventually(lambda x=100.0 + number: x in xs_of_ros())
        there({**FORWARD, "linear": {"x": 200.0 + number, "y": 0.0, "z": 0.0}})
        eventually(lambda x=200.0 + number: x in xs_of_bus())
    ros.settle()
    assert sorted(x for x in xs_of_bus() if x >= 100.0) == [
        *(100.0 + number for number in range(5)),
        *(200.0 + number for number in range(5)),
    ]
    assert [x for x in xs_of_ros() if x >= 100.0] == [100.0 + number for number in range(5)]


def test_a_message_equal_to_one_that_went_comes(
    bridges: Bridges, sender: Node, receiver: Node, node: RosNode
) -> None:
    """As a stop that both sides send, where ROS does not tell whose a message is."""
    bridge = bridges(tells=False)
    got = heard(receiver, Twist, "cmd_vel")
    node.listen("/cmd_vel", TWIST)
    here = sender.create_publisher(Twist, "cmd_vel")
    there = node.publisher("/cmd_vel", TWIST)
    eventually(lambda: bridge.crossing() == (["cmd_vel"], ["cmd_vel"]))
    send_until(lambda: there(FORWARD), lambda: bool(got))
    sent: list[Twist] = []

    def stop() -> None:
        sent.append(Twist())
        here.publish(sent[-1])

    send_until(stop, lambda: len(node.got) > 0)
    eventually(lambda: len(node.got) == len(sent) == got.count(Twist()))
    there({"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}})
    eventually(lambda: got.count(Twist()) == len(sent) + 1)


def is_once(send: Callable[[float], object], got: Callable[[], list[float]]) -> bool:
    """Whether each of some messages arrives once."""
    first = max([*got(), 99.0]) + 1.0
    wanted = [first + number for number in range(5)]
    for x in wanted:
        send(x)
        eventually(lambda x=x: x in got())
    return [x for x in got() if x >= first] == wanted


def test_a_topic_crosses_by_one_of_two_bridges(
    bus: Bus, bridged: Bridged, sender: Node, node: RosNode
) -> None:
    """By the one that was started first; by the other once that is gone. Nothing comes back."""
    first, _ = bridged("ros2", table=TopicTable()), bridged("ros2_too", table=TopicTable())
    got = heard(bus.node("receiver"), Twist, "cmd_vel")
    node.listen("/cmd_vel", TWIST)
    here = sender.create_publisher(Twist, "cmd_vel")

    def publishers() -> list[str]:
        return [each.node for each in node.leg.publishers("/cmd_vel")]

    def send(x: float) -> None:
        here.publish(Twist(Vector3(x=x)))

    send_until(lambda: send(1.0), lambda: bool(node.got))
    eventually(lambda: is_once(send, lambda: [each["linear"]["x"] for each in node.got]))
    assert publishers() == ["/tfbus_ros2"]
    eventually(lambda: is_once(send, lambda: [each.linear.x for each in got]))
    first.close()
    eventually(lambda: publishers() == ["/tfbus_ros2_too"])


def test_a_topic_of_ros_comes_by_one_of_two_bridges(
    bus: Bus, bridged: Bridged, node: RosNode
) -> None:
    """By the one that was started first; by the other once that is gone."""
    first, _ = bridged("ros2", table=TopicTable()), bridged("ros2_too", table=TopicTable())
    got = heard(bus.node("receiver"), Twist, "cmd_vel")
    publish = node.publisher("/cmd_vel", TWIST)

    def send(x: float) -> None:
        publish({**FORWARD, "linear": {"x": x, "y": 0.0, "z": 0.0}})

    send_until(lambda: send(1.0), lambda: bool(got))
    eventually(lambda: is_once(send, lambda: [each.linear.x for each in got]))
    first.close()
    got.clear()
    send_until(lambda: send(1.0), lambda: bool(got))


def test_a_topic_of_ros_is_not_sent_there_by_another_bridge(
    bridges: Bridges, node: RosNode, ros: FakeRos, receiver: Node
) -> None:
    """The other knows it on the bus as a bridge's, and its source in ROS."""
    first, second = bridges("ros2"), bridges("ros2_too")
    got = heard(receiver, Twist, "cmd_vel")
    publish = node.publisher("/cmd_vel", TWIST)
    send_until(lambda: publish(FORWARD), lambda: len(got) >= 2)
    eventually(lambda: "cmd_vel" in first.crossing()[1] and "cmd_vel" in second.crossing()[1])
    assert first.crossing()[0] == second.crossing()[0] == []


def test_one_direction_only(bridges: Bridges, sender: Node, node: RosNode, receiver: Node) -> None:
    """Where the other is turned off nothing crosses in it."""
    bridge = bridges(from_ros=False)
    heard(receiver, Twist, "cmd_vel")
    node.publisher("/cmd_vel", TWIST)
    sender.create_publisher(Pose, "turtle1/pose")
    eventually(lambda: bridge.crossing() == (["turtle1/pose"], []))


def test_an_own_type_crosses_by_its_line(
    bridges: Bridges, sender: Node, node: RosNode, tmp_path: Path
) -> None:
    """With the fields that the line names."""
    file = tmp_path / "topics.yaml"
    file.write_text(
        "battery: {type: Battery, ros: sensor_msgs/msg/BatteryState,"
        " fields: {charge: percentage, at_ns: header.stamp}}\n"
    )
    table = TopicTable.of_file(file)
    bridges(table=table)
    node.listen("/battery", table.names["battery"].counterpart.definition)
    raw = sender.create_raw_publisher("battery", type_name="Battery")
    payload = b"\x82\xa6charge\xcb\x3f\xe0" + bytes(6) + b"\xa5at_ns\x07"
    send_until(lambda: raw.publish(payload), lambda: bool(node.got))
    assert node.got[0]["percentage"] == 0.5
    assert node.got[0]["header"]["stamp"] == {"sec": 0, "nanosec": 7}
    assert node.got[0]["voltage"] == 0.0
