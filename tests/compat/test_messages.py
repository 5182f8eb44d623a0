"""Classes of ROS's interfaces, made from their definitions."""

import copy
import json
import math
import pickle
import struct
import subprocess
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests import needs
from tests.compat.facts_of_interfaces import facts
from tests.compat.spinning import publish_until, spin_until
from tests.simulated_bus import Bus
from tfbus import messages
from tfbus.base.errors import DecodeError
from tfbus.bus.presence import describe_nodes
from tfbus.compat.diagnostic_msgs.msg import DiagnosticStatus
from tfbus.compat.geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovariance
from tfbus.compat.nav_msgs.msg import Odometry
from tfbus.compat.rcl_interfaces.msg import ParameterValue
from tfbus.compat.rclpy.serialization import deserialize_message, serialize_message
from tfbus.compat.rosgraph_msgs.msg import Clock
from tfbus.compat.sensor_msgs.msg import Image, Imu, JointState, LaserScan
from tfbus.compat.std_msgs.msg import Bool, ColorRGBA, Float32, Header, Int8, String
from tfbus.compat.std_srvs.srv import SetBool, Trigger
from tfbus.compat.visualization_msgs.msg import Marker, MarkerArray
from tfbus.ros.definitions import interfaces_of, packages
from tfbus.ros.message_classes import interface_class
from tfbus.wire.codec import as_map, decode_map, decode_message, encode_message, type_name

# Of ROS 2 Kilted, as far as its small environment has them.
_IN_KILTED = [
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "lifecycle_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
    "unique_identifier_msgs",
]

EVERY_MESSAGE = [
    f"{package}/{kind}/{name}"
    for package in packages()
    for kind, names in interfaces_of(package).items()
    for name in names
]


def parts_of(name: str) -> list[Any]:
    """The classes of messages in an interface."""
    made = interface_class(name)
    parts = ("Request", "Response", "Goal", "Result", "Feedback")
    return [getattr(made, part) for part in parts if hasattr(made, part)] or [made]


@pytest.mark.parametrize("package", packages())
def test_every_interface_is_there(package: str) -> None:
    """Each of its messages is made without arguments, equals another one, takes no other field,
    and is the same when it was copied, pickled or sent.
    """
    names = [name for name in EVERY_MESSAGE if name.startswith(f"{package}/")]
    for message_type in (part for name in names for part in parts_of(name)):
        message = message_type()
        assert message == message_type()
        with pytest.raises(AttributeError):
            message.no_such_field = 1
        with pytest.raises(TypeError, match="no_such_field"):
            message_type(no_such_field=1)
        assert copy.deepcopy(message) == message
        assert pickle.loads(pickle.dumps(message)) == message
        assert decode_message(message_type, encode_message(message)) == message


@pytest.mark.real
def test_messages_are_as_in_rclpy() -> None:
    """The same fields and types, defaults, constants, and the same text."""
    python = needs.python_of_ros2("kilted")
    script = Path(__file__).with_name("facts_of_interfaces.py")
    ran = subprocess.run(
        [python, script, "", *_IN_KILTED], capture_output=True, text=True, timeout=300, check=True
    )
    theirs = json.loads(ran.stdout)
    ours = json.loads(json.dumps(facts("tfbus.compat.", _IN_KILTED)))
    different = [name for name, fact in theirs.items() if ours.get(name) != fact]
    assert len(theirs) > 130 and not different


def test_sequences_of_numbers_are_arrays() -> None:
    """As in rclpy: array.array, and numpy's where the size is fixed; lists, bytes and arrays of
    numpy may be assigned.
    """
    scan = LaserScan(ranges=[1, 2.5])
    assert scan.ranges == array("f", [1.0, 2.5])
    scan.ranges = np.array([3.0, 4.0])
    assert scan.ranges == array("f", [3.0, 4.0])
    assert Image(data=b"ab").data == Image(data=np.array([97, 98], np.uint8)).data
    odometry = Odometry()
    odometry.pose.covariance[7] = 0.5
    assert odometry.pose.covariance.reshape(6, 6)[1, 1] == 0.5
    assert isinstance(PoseWithCovariance(covariance=[0.0] * 36).covariance, np.ndarray)


@pytest.mark.parametrize(
    ("make", "error", "says"),
    [
        (lambda: LaserScan(ranges=np.zeros((2, 2))), TypeError, "'ranges' must be a list or array"),
        (lambda: LaserScan(ranges="far"), TypeError, "'ranges' must be a list or array of numbers"),
        (lambda: Image(data=[300]), ValueError, "'data' has a number that is no uint8"),
        (lambda: Image(data=[0.5]), TypeError, "'data' must be a list or array of integers"),
        (lambda: PoseWithCovariance(covariance=[1.0]), ValueError, "must have 36 items, not 1"),
        (lambda: JointState(name="elbow"), TypeError, "'name' must be a list"),
    ],
)
def test_a_wrong_array_is_refused_when_it_is_set(
    make: Callable[[], Any], error: type[Exception], says: str
) -> None:
    """With the name of the field."""
    with pytest.raises(error, match=says):
        make()


@pytest.mark.parametrize(
    ("message", "error", "says"),
    [
        (Pose(position=Point(x="far")), TypeError, "field 'position.x' must be a number"),
        (Pose(position=Header()), TypeError, "'position' must be a geometry_msgs/msg/Point, not"),
        (Pose(position=None), TypeError, "'position' must be a geometry_msgs/msg/Point, not"),
        (Int8(data=200), ValueError, "'data' is 200: it must be from -128 to 127"),
        (Int8(data=0.5), TypeError, "'data' must be an integer"),
        (Bool(data="yes"), TypeError, "'data' must be a boolean"),
        (String(data=b"text"), TypeError, "'data' must be a text"),
        (Float32(data=1e300), ValueError, "does not fit a float32"),
        (MarkerArray(markers=[Marker(), Pose()]), TypeError, r"'markers\[1\]' must be a visual"),
    ],
)
def test_a_wrong_value_is_refused_when_it_is_sent(
    message: Any, error: type[Exception], says: str
) -> None:
    """With the path of the field."""
    with pytest.raises(error, match=says):
        as_map(message)


def test_numbers_of_numpy_and_integers_are_sent_as_what_they_must_be() -> None:
    """Integers as floats, floats of 32 bits rounded, and truths of numpy."""
    assert as_map(Point(x=1, y=np.float32(0.5))) == {"x": 1.0, "y": 0.5, "z": 0.0}
    assert as_map(Float32(data=0.1))["data"] == np.float32(0.1)
    assert as_map(Int8(data=np.int64(5))) == {"data": 5}
    assert as_map(Bool(data=np.bool_(True))) == {"data": True}
    assert math.isnan(as_map(Point(x=math.nan))["x"])


def test_a_message_that_does_not_fit_is_refused_where_it_comes_in() -> None:
    """With the path of the field."""
    for payload, says in (
        ({"pose": {"position": {"x": "far"}}}, "field 'pose.position.x' must be a number"),
        ({"pose": 5}, "field 'pose' must be a map"),
    ):
        with pytest.raises(DecodeError, match=says):
            PoseStamped.__of_bus_map__(payload)


def test_a_byte_is_bytes_in_a_program_and_a_number_on_the_bus() -> None:
    """As in rclpy, and in ROS's other languages."""
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR)
    assert status.level == b"\x02" and as_map(status)["level"] == 2


def test_types_have_their_names_in_ros_on_the_bus() -> None:
    """But for those that tfbus's own nodes have."""
    assert type_name(Imu) == "sensor_msgs/msg/Imu"
    assert type_name(Trigger) == "std_srvs/srv/Trigger"
    assert type_name(interface_class("turtlesim/srv/Spawn")) == "Spawn"


@pytest.mark.real
def test_packages_of_ones_own_are_read_from_their_files(tmp_path: Path) -> None:
    """As people write them, from the folders in TFBUS_INTERFACES and folders below them."""
    package = tmp_path / "my_msgs"
    for path, text in {
        "msg/Weight.msg": (
            "# How heavy: größer.\nuint8 KG=1  # unit\nHeader header\nfloat64 value 2.5\n"
        ),
        "msg/Weights.msg": "Weight[] weights\n",
        "srv/scales/Weigh.srv": "string what\n---\nWeight weight\n",
    }.items():
        (package / path).parent.mkdir(parents=True, exist_ok=True)
        (package / path).write_text(text, encoding="latin-1")  # of an old editor
    program = (
        "from tfbus.compat.my_msgs.msg import *\n"
        "from tfbus.compat.my_msgs.srv import Weigh\n"
        "print(Weights(weights=[Weight()]), Weight.KG, Weigh.Response().weight.value)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env={"TFBUS_INTERFACES": str(tmp_path), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert ran.stdout.endswith("value=2.5)]) 1 2.5\n")


@pytest.mark.parametrize(
    ("statement", "says"),
    [
        ("import tfbus.compat.my_msgs", "no package my_msgs.*TFBUS_INTERFACES"),
        ("from tfbus.compat.nav_mgs.msg import Odometry", "did you mean 'nav_msgs'"),
        (
            "from tfbus.compat.nav_msgs.msg import Odometri",
            "has no Odometri: did you mean Odometry",
        ),
        ("from tfbus.compat.cv_bridge import CvBridge", "numpy.frombuffer"),
    ],
)
def test_what_is_not_there_says_what_there_is(statement: str, says: str) -> None:
    """In the sentence that the import shows."""
    with pytest.raises(ImportError, match=says):
        exec(statement)


@pytest.mark.parametrize(
    "message",
    [
        Imu(header=Header(frame_id="imu"), orientation_covariance=[-1.0] + [0.0] * 8),
        LaserScan(ranges=[1.0, 2.0], angle_min=-0.5),
        Image(height=1, width=2, encoding="mono8", data=b"ab"),
        MarkerArray(markers=[Marker(ns="a", color=ColorRGBA(r=1.0, a=1.0), points=[Point(x=1.0)])]),
        DiagnosticStatus(level=DiagnosticStatus.WARN, name="motor"),
    ],
    ids=lambda message: type(message).__name__,
)
def test_messages_reach_other_ported_programs(rclpy: ModuleType, message: Any) -> None:
    """With every field as it was."""
    node, got = rclpy.create_node("ported"), []
    node.create_subscription(type(message), "/a/topic", got.append, 10)
    publisher = node.create_publisher(type(message), "/a/topic", 10)
    publish_until(node, publisher, message, lambda: got)
    assert got[0] == message and type(got[0]) is type(message)


def test_what_tfbus_has_too_is_the_same_on_the_bus(rclpy: ModuleType, bus: Bus) -> None:
    """Odometry, poses and the simulated time, in both directions."""
    node, own, got, read = rclpy.create_node("ported"), bus.node("own"), [], []
    own.create_subscription(messages.Odometry, "odom", read.append)
    odometry = Odometry(header=Header(frame_id="odom"), child_frame_id="base")
    odometry.header.stamp.sec, odometry.pose.pose.position.x = 2, 3.0
    odometry.twist.twist.angular.z = 0.5
    odometry.pose.covariance[0] = 0.1
    publish_until(node, node.create_publisher(Odometry, "odom", 10), odometry, lambda: read)
    native: messages.Odometry = read[0]
    assert (native.stamp_ns, native.frame_id) == (2_000_000_000, "odom")
    assert (native.child_frame_id, native.pose.pose.position.x) == ("base", 3.0)
    assert (native.twist.twist.angular.z, native.pose.covariance[0]) == (0.5, 0.1)
    node.create_subscription(Odometry, "odom2", got.append, 10)
    publish_until(node, own.create_publisher(messages.Odometry, "odom2"), native, lambda: got)
    assert got[0] == odometry
    got.clear()
    node.create_subscription(Clock, "ticks", got.append, 10)
    tick = messages.Clock(5_000_000_001)
    publish_until(node, own.create_publisher(messages.Clock, "ticks"), tick, lambda: got)
    assert (got[0].clock.sec, got[0].clock.nanosec) == (5, 1)


def test_a_description_of_a_robot_is_a_string_in_ros(rclpy: ModuleType, bus: Bus) -> None:
    """On the topic robot_description, where it is retained."""
    own, node, got = bus.node("own"), rclpy.create_node("ported"), []
    robots = own.create_publisher(messages.RobotDescription, "robot_description", retained=True)
    robots.publish(messages.RobotDescription("<robot/>"))
    from tfbus.compat.rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, "/robot_description", got.append, latched)
    spin_until(node, lambda: got)
    assert got[0] == String(data="<robot/>")


def test_services_of_ros_are_served_and_called(rclpy: ModuleType) -> None:
    """With requests and responses of ROS."""
    server, client = rclpy.create_node("server"), rclpy.create_node("client")

    def set_it(request: Any, response: Any) -> Any:
        response.success, response.message = request.data, "set"
        return response

    server.create_service(SetBool, "set", set_it)
    calls = client.create_client(SetBool, "set")
    future = calls.call_async(SetBool.Request(data=True))
    spin_until(server, future.done)
    assert future.result() == SetBool.Response(success=True, message="set")


def test_ported_types_are_listed_by_their_names_in_ros(rclpy: ModuleType, bus: Bus) -> None:
    """Types that tfbus has too are listed by its own names."""
    node, own = rclpy.create_node("ported"), bus.node("own")
    node.create_publisher(Imu, "imu", 10)
    node.create_publisher(Odometry, "odom", 10)

    def types() -> dict[str, str]:
        return describe_nodes(own.session, "ported")[0].publishes

    assert (types()["imu"], types()["odom"]) == ("sensor_msgs/msg/Imu", "Odometry")


def test_serialized_arrays_come_back_as_they_are() -> None:
    """Of numbers, booleans and bytes, and of a fixed size; on the bus they are binary."""
    scan = LaserScan(ranges=np.arange(3, dtype=np.float32), intensities=[0.5])
    assert deserialize_message(serialize_message(scan), LaserScan) == scan
    assert decode_map(encode_message(scan))["ranges"] == struct.pack("<3f", 0.0, 1.0, 2.0)
    imu = Imu(orientation_covariance=np.arange(9.0))
    assert deserialize_message(serialize_message(imu), Imu) == imu
    value = ParameterValue(bool_array_value=[True, False], integer_array_value=[-1, 2])
    assert deserialize_message(serialize_message(value), ParameterValue) == value
