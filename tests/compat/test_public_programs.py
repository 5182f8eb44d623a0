"""Programs that others wrote: the names that they use are there, and programs of their shapes run
with the documented change of imports.
"""

import re
import subprocess
import sys
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests import needs
from tests.builders import x_of
from tests.buses import eventually, keep_sending
from tests.compat.public_programs import PROGRAMS
from tests.compat.spinning import publish_until, spin_until
from tests.live_bus import Bus as LiveBus
from tests.simulated_bus import Bus
from tfbus import Buffer
from tfbus.compat.geometry_msgs.msg import PoseStamped, Twist
from tfbus.compat.nav_msgs.msg import Odometry
from tfbus.compat.nav_msgs.msg import Path as PathMessage
from tfbus.compat.sensor_msgs.msg import Imu, LaserScan, PointCloud2
from tfbus.compat.sensor_msgs_py.point_cloud2 import create_cloud_xyz32, read_points_list
from tfbus.compat.std_msgs.msg import Header
from tfbus.compat.std_srvs.srv import Trigger
from tfbus.compat.visualization_msgs.msg import Marker

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "porting-tf2-ros.md"


def ported(name: str) -> Any:
    """What a name of ROS is here: the module as far as it goes, then attributes."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            module = import_module(".".join(["tfbus.compat", *parts[:count]]))
        except ImportError:
            continue
        return reduce(getattr, parts[count:], module)
    raise AssertionError(f"there is no {name}")


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_names_that_a_public_program_uses_are_there(program: str) -> None:
    """All that it imports, reads and calls."""
    for name in PROGRAMS[program].split():
        assert ported(name) is not None


def test_the_page_says_how_many_programs_ran() -> None:
    """As many as are named here, to which it links."""
    page = PAGE.read_text()
    assert f"{len(PROGRAMS)} do\n([all by name](../../tests/compat/public_programs.py))" in page


ODOMETRY_TO_TF = """
import rclpy
import rclpy.qos  # the profile
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
import tf2_ros as tf2


class OdometryToTf(Node):
    def __init__(self):
        super().__init__("odometry_to_tf")
        self.declare_parameter("prefix", rclpy.Parameter.Type.STRING)
        self.broadcaster = tf2.TransformBroadcaster(self)
        self.create_subscription(
            Odometry, "odom", self.on_odometry, rclpy.qos.qos_profile_sensor_data
        )

    def on_odometry(self, msg):
        t = TransformStamped()
        t.header = msg.header
        t.child_frame_id = msg.child_frame_id
        t.transform.translation.x = msg.pose.pose.position.x
        t.transform.translation.y = msg.pose.pose.position.y
        t.transform.rotation = msg.pose.pose.orientation
        self.broadcaster.sendTransform(t)


def main():
    rclpy.init()
    node = OdometryToTf()
    rclpy.spin(node)


main()
"""

RELAY = """
import sys
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

LATCHED = QoSProfile(
    depth=100,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    reliability=ReliabilityPolicy.RELIABLE,
)


class Relay(Node):
    def __init__(self, robot):
        super().__init__("relay")
        self.prefix = robot + "/"
        self.static = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self.dynamic = self.create_publisher(TFMessage, "/tf", 100)
        self.create_subscription(
            TFMessage, f"/{robot}/tf_static", lambda m: self.pass_on(m, self.static), LATCHED
        )
        self.create_subscription(
            TFMessage, f"/{robot}/tf", lambda m: self.pass_on(m, self.dynamic), 100
        )

    def pass_on(self, message, publisher):
        for each in message.transforms:
            each.header.frame_id = self.prefix + each.header.frame_id
            each.child_frame_id = self.prefix + each.child_frame_id
        publisher.publish(message)


rclpy.init()
rclpy.spin(Relay(sys.argv[1]))
"""

RECORDER = """
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.executors import ExternalShutdownException
from rclpy.time import Time
from std_srvs.srv import Trigger
from tf2_ros import Buffer, TransformException, TransformListener


class Recorder(Node):
    def __init__(self):
        super().__init__("recorder")
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.path = Path()
        self.path.header.frame_id = "map"
        self.publisher = self.create_publisher(Path, "path", 1)
        self.create_service(Trigger, "clear", self.on_clear)
        self.create_timer(0.02, self.on_timer)

    def on_timer(self):
        try:
            t = self.buffer.lookup_transform("map", "base_link", Time().to_msg())
        except TransformException as error:
            self.get_logger().info(f"not yet: {error}", throttle_duration_sec=1.0)
            return
        pose = PoseStamped(header=t.header)
        pose.pose.position.x = t.transform.translation.x
        pose.pose.orientation = t.transform.rotation
        self.path.poses.append(pose)
        self.publisher.publish(self.path)

    def on_clear(self, request, response):
        response.success = bool(self.path.poses)
        response.message = f"{len(self.path.poses)} poses"
        self.path.poses.clear()
        return response


rclpy.init()
try:
    rclpy.spin(Recorder())
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

FOLLOWER = """
import math
import rclpy
from geometry_msgs.msg import Twist
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import LaserScan
import tf_transformations
from tf2_ros import Buffer, TransformListener
from tf2_ros import ConnectivityException, ExtrapolationException, LookupException
from visualization_msgs.msg import Marker


class Follower(Node):
    def __init__(self):
        super().__init__("follower")
        self.buffer = Buffer(cache_time=Duration(seconds=5.0), node=self)
        self.listener = TransformListener(self.buffer, self)
        self.is_free = False
        self.publisher = self.create_publisher(Twist, "/cmd_vel", 1)
        self.marker = self.create_publisher(Marker, "goal", 1)
        self.create_subscription(LaserScan, "/scan", self.on_scan, 1)
        self.create_timer(0.02, self.on_timer)

    def on_scan(self, msg):
        self.is_free = min(msg.ranges) > msg.range_min

    def on_timer(self):
        try:
            t = self.buffer.lookup_transform(
                "base_link", "person", Time(), timeout=Duration(seconds=0.01)
            )
        except (LookupException, ConnectivityException, ExtrapolationException):
            return
        q = t.transform.rotation
        yaw = tf_transformations.euler_from_quaternion([q.x, q.y, q.z, q.w])[2]
        marker = Marker(type=Marker.ARROW, action=Marker.ADD, ns="goal", header=t.header)
        marker.color.r = marker.color.a = 1.0
        marker.scale.x = math.hypot(t.transform.translation.x, t.transform.translation.y)
        self.marker.publish(marker)
        if self.is_free:
            msg = Twist()
            msg.linear.x = marker.scale.x
            msg.angular.z = yaw
            self.publisher.publish(msg)


rclpy.init()
rclpy.spin(Follower())
"""

CLOUDS = """
import rclpy
import message_filters
from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2
from tf2_ros import Buffer, TransformListener
from tf2_sensor_msgs import do_transform_cloud


class Clouds(Node):
    def __init__(self):
        super().__init__("clouds")
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.publisher = self.create_publisher(PointCloud2, "cloud_in_map", 1)
        both = [
            message_filters.Subscriber(self, PointCloud2, "cloud"),
            message_filters.Subscriber(self, Imu, "imu", qos_profile=10),
        ]
        self.filter = message_filters.ApproximateTimeSynchronizer(both, 10, 0.1)
        self.filter.registerCallback(self.on_both)

    def on_both(self, cloud, imu):
        if self.buffer.can_transform("map", cloud.header.frame_id, rclpy.time.Time()):
            t = self.buffer.lookup_transform("map", cloud.header.frame_id, rclpy.time.Time())
            self.publisher.publish(do_transform_cloud(cloud, t))


rclpy.init()
rclpy.spin(Clouds())
"""


SHAPES = [ODOMETRY_TO_TF, RELAY, RECORDER, FOLLOWER, CLOUDS]


def rules() -> str:
    """The page's port.sed."""
    found = re.search(r"<!-- file: port.sed -->\n```sed\n(.*?)```", PAGE.read_text(), re.S)
    assert found is not None
    return found[1]


def changed(program: str) -> str:
    """A program with its imports changed as the page says."""
    for rule in rules().splitlines():
        _, sought, put, _ = rule.replace("[[:space:]]", r"[ \t]").split("/")
        program = re.sub(sought, put, program, flags=re.M)
    return program


def changed_by_sed(folder: Path, program: str) -> Path:
    """The same by what the page tells to run: the file of it."""
    (folder / "port.sed").write_text(rules())
    (folder / "program.py").write_text(program)
    sed = needs.program("sed")
    subprocess.run([sed, "-E", "-i", "-f", "port.sed", "program.py"], cwd=folder, check=True)
    return folder / "program.py"


def start(bus: Bus, program: str, *arguments: str) -> None:
    """A program of ROS with its imports changed, once it is ready."""
    code = compile(changed(program), "program.py", "exec")

    def main() -> None:
        exec(code, {"__name__": "__main__"})

    bus.start_main(main, *arguments, name="program.py").wait_for_line("ready")


@pytest.mark.real
@pytest.mark.parametrize("program", SHAPES)
def test_sed_changes_imports_as_in_the_programs_here(program: str, tmp_path: Path) -> None:
    """The programs below run with what sed makes of them."""
    assert changed_by_sed(tmp_path, program).read_text() == changed(program) != program


@pytest.mark.real
def test_a_changed_program_runs(bus: LiveBus, buffer: Buffer, tmp_path: Path) -> None:
    """As a process of its own."""
    program = changed_by_sed(tmp_path, RELAY)
    process = bus.start_command([sys.executable, str(program), "robot_1"])
    process.wait_for_line("ready")
    keep_sending(bus.node("arm", namespace="robot_1"), "odom", "base")
    eventually(lambda: buffer.can_transform("robot_1/odom", "robot_1/base"))


def test_odometry_becomes_transforms(rclpy: ModuleType, bus: Bus, buffer: Buffer) -> None:
    """By a program of ROS, with a parameter that has no value."""
    start(bus, ODOMETRY_TO_TF)
    node = rclpy.create_node("robot")
    odometry = Odometry(header=Header(frame_id="odom"), child_frame_id="base_link")
    odometry.header.stamp = node.get_clock().now().to_msg()
    odometry.pose.pose.position.x = 1.5
    publisher = node.create_publisher(Odometry, "odom", 10)
    publish_until(node, publisher, odometry, lambda: buffer.can_transform("odom", "base_link"))
    assert x_of(buffer, "odom", "base_link") == 1.5


def test_a_relay_passes_on_the_transforms_of_a_robot(bus: Bus, buffer: Buffer) -> None:
    """Dynamic and static ones of its namespace, with a prefix."""
    start(bus, RELAY, "robot_1")
    robot = bus.node("arm", namespace="robot_1")
    keep_sending(robot, "odom", "base")
    eventually(lambda: buffer.can_transform("robot_1/odom", "robot_1/base"))


def test_a_path_is_recorded(rclpy: ModuleType, bus: Bus) -> None:
    """As poses of a Path, which a service clears."""
    start(bus, RECORDER)
    keep_sending(bus.node("robot"), "map", "base_link")
    node, paths = rclpy.create_node("reader"), []
    node.create_subscription(PathMessage, "path", paths.append, 10)
    spin_until(node, lambda: paths and len(paths[-1].poses) > 2)
    assert isinstance(paths[-1].poses[0], PoseStamped)
    client = node.create_client(Trigger, "clear")
    assert client.wait_for_service(20)
    future = client.call_async(Trigger.Request())
    spin_until(node, future.done)
    assert future.result().success and future.result().message.endswith("poses")


def test_a_follower_drives(rclpy: ModuleType, bus: Bus) -> None:
    """While its scan is free, and shows a marker."""
    start(bus, FOLLOWER)
    keep_sending(bus.node("robot"), "base_link", "person")
    node, got = rclpy.create_node("world"), {Twist: [], Marker: []}
    node.create_subscription(Twist, "/cmd_vel", got[Twist].append, 10)
    node.create_subscription(Marker, "goal", got[Marker].append, 10)
    scans = node.create_publisher(LaserScan, "/scan", 10)
    scan = LaserScan(ranges=[1.0, 2.0], range_min=0.1)
    publish_until(node, scans, scan, lambda: all(got.values()))
    assert got[Marker][0].ns == "goal" and got[Marker][0].header.frame_id == "base_link"


def test_clouds_are_transformed(rclpy: ModuleType, bus: Bus) -> None:
    """With the messages of another topic that belong to them."""
    start(bus, CLOUDS)
    node, got = rclpy.create_node("world"), []
    keep_sending(bus.node("robot"), "map", "lidar")
    header = Header(frame_id="lidar", stamp=node.get_clock().now().to_msg())
    node.create_subscription(PointCloud2, "cloud_in_map", got.append, 10)
    imus, clouds = (
        node.create_publisher(Imu, "imu", 10),
        node.create_publisher(PointCloud2, "cloud", 10),
    )

    def transformed() -> bool:
        imus.publish(Imu(header=header))
        clouds.publish(create_cloud_xyz32(header, [(1, 2, 3), (4, 5, 6)]))
        rclpy.spin_once(node, timeout_sec=0.01)
        return bool(got)

    eventually(transformed)
    assert got[0].header.frame_id == "map"
    assert read_points_list(got[0]) == [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]
