"""Programs with ROS's names, as turtle_tf2_py and examples_tf2_py have them. Not a test itself.

    python -m tests.compat.turtle_programs PROGRAM [ARGUMENT ...] [--ros-args ...]

But for their imports they are programs of rclpy and tf2_ros.
"""

import math
import sys
from typing import Any

from tfbus.compat import rclpy
from tfbus.compat.geometry_msgs.msg import PointStamped, TransformStamped, Twist
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from tfbus.compat.rclpy.node import Node
from tfbus.compat.rclpy.qos import QoSProfile
from tfbus.compat.rclpy.utilities import remove_ros_args
from tfbus.compat.sensor_msgs.msg import JointState
from tfbus.compat.tf2_ros import LookupException, TransformException
from tfbus.compat.tf2_ros.buffer import Buffer
from tfbus.compat.tf2_ros.static_transform_broadcaster import StaticTransformBroadcaster
from tfbus.compat.tf2_ros.transform_broadcaster import TransformBroadcaster
from tfbus.compat.tf2_ros.transform_listener import TransformListener
from tfbus.compat.turtlesim.msg import Pose
from tfbus.compat.turtlesim.srv import Spawn


def transform(stamp: Any, parent: str, child: str, x: float, y: float, yaw: float = 0.0) -> Any:
    """A transform in the plane."""
    t = TransformStamped()
    t.header.stamp = stamp
    t.header.frame_id = parent
    t.child_frame_id = child
    t.transform.translation.x = x
    t.transform.translation.y = y
    t.transform.rotation.z = math.sin(yaw / 2)
    t.transform.rotation.w = math.cos(yaw / 2)
    return t


class TurtleFrame(Node):
    """The frame of a turtle, from its pose."""

    def __init__(self) -> None:
        super().__init__("turtle_frame")
        parameter = self.declare_parameter("turtlename", "turtle")
        self.turtlename = parameter.get_parameter_value().string_value
        self.broadcaster = TransformBroadcaster(self)
        self.create_subscription(Pose, f"/{self.turtlename}/pose", self.on_pose, 1)

    def on_pose(self, msg: Pose) -> None:
        """Send it as it comes."""
        now = self.get_clock().now().to_msg()
        self.broadcaster.sendTransform(
            transform(now, "world", self.turtlename, msg.x, msg.y, msg.theta)
        )


class Follower(Node):
    """Spawns turtle2, and drives it after a frame."""

    def __init__(self) -> None:
        super().__init__("follower")
        self.target = self.declare_parameter("target_frame", "turtle1").value
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.spawner = self.create_client(Spawn, "spawn")
        self.spawned: Any = None
        self.is_spawned = False
        self.publisher = self.create_publisher(Twist, "turtle2/cmd_vel", 1)
        self.timer = self.create_timer(0.1, self.on_timer)

    def on_timer(self) -> None:
        """One step a call."""
        if self.spawned is None:
            if self.spawner.service_is_ready():
                request = Spawn.Request()
                request.name, request.x, request.y = "turtle2", 4.0, 2.0
                self.spawned = self.spawner.call_async(request)
        elif not self.is_spawned:
            if self.spawned.done():
                self.get_logger().info(f"Spawned {self.spawned.result().name}")
                self.is_spawned = True
        else:
            self.follow()

    def follow(self) -> None:
        """Turn towards the frame, and drive the faster the farther it is."""
        try:
            t = self.buffer.lookup_transform("turtle2", self.target, rclpy.time.Time())
        except TransformException as ex:
            self.get_logger().info(f"No transform: {ex}", throttle_duration_sec=1.0)
            return
        x, y = t.transform.translation.x, t.transform.translation.y
        msg = Twist()
        msg.angular.z = 4.0 * math.atan2(y, x)
        msg.linear.x = 1.5 * math.hypot(x, y)
        self.publisher.publish(msg)
        if math.hypot(x, y) < 0.5:
            self.get_logger().info("Reached it", once=True)


class Carrot(Node):
    """A frame beside turtle1: one that stays, or with an argument one that goes round."""

    def __init__(self, moves: bool) -> None:
        super().__init__("carrot")
        self.broadcaster = TransformBroadcaster(self)
        self.moves = moves
        self.timer = self.create_timer(0.1, self.on_timer)

    def on_timer(self) -> None:
        """Send it."""
        seconds, _ = self.get_clock().now().seconds_nanoseconds()
        x, y = (math.sin(seconds), math.cos(seconds)) if self.moves else (0.0, 2.0)
        self.broadcaster.sendTransform(
            transform(self.get_clock().now().to_msg(), "turtle1", "carrot1", x, y)
        )


class StaticFrame(Node):
    """A frame that does not move, from the command line: its name, x, y and yaw."""

    def __init__(self, child: str, *numbers: str) -> None:
        super().__init__("static_frame")
        stamp = self.get_clock().now().to_msg()
        self.broadcaster = StaticTransformBroadcaster(self)
        self.broadcaster.sendTransform(
            transform(stamp, "world", child, *(float(number) for number in numbers))
        )


class PointSender(Node):
    """The place of turtle1 as points with a header."""

    def __init__(self) -> None:
        super().__init__("point_sender")
        self.create_subscription(Pose, "turtle1/pose", self.on_pose, 10)
        self.publisher = self.create_publisher(PointStamped, "turtle1/point", 10)

    def on_pose(self, msg: Pose) -> None:
        """Send it as it comes."""
        point = PointStamped()
        point.header.stamp = self.get_clock().now().to_msg()
        point.header.frame_id = "world"
        point.point.x, point.point.y = msg.x, msg.y
        self.publisher.publish(point)


class Wheel(Node):
    """The frame of a wheel from joint states."""

    def __init__(self) -> None:
        super().__init__("wheel")
        self.broadcaster = TransformBroadcaster(self, QoSProfile(depth=100))
        self.create_subscription(JointState, "joints", self.on_joints, QoSProfile(depth=10))

    def on_joints(self, msg: JointState) -> None:
        """Send a list of frames."""
        self.broadcaster.sendTransform(
            [
                transform(msg.header.stamp, "base_link", name, 0.05, 0.0, position)
                for name, position in zip(msg.name, msg.position, strict=True)
            ]
        )


class Joints(Node):
    """Joint states of a wheel that turns."""

    def __init__(self) -> None:
        super().__init__("joints")
        self.publisher = self.create_publisher(JointState, "joints", QoSProfile(depth=1))
        self.create_timer(0.02, self.on_timer)

    def on_timer(self) -> None:
        """Send one."""
        msg, now = JointState(), self.get_clock().now()
        msg.header.stamp = now.to_msg()
        msg.name, msg.position = ["wheel"], [now.nanoseconds / 1e9 % 6.0]
        self.publisher.publish(msg)


class Waiter(Node):
    """Waits for the wheel in three ways: with a timeout, a coroutine, and a callback."""

    def __init__(self) -> None:
        super().__init__("waiter")
        self.buffer = Buffer(cache_time=Duration(seconds=5))
        self.listener = TransformListener(self.buffer, self, spin_thread=False)
        self.timers = [
            self.create_timer(0.1, self.block),
            self.create_timer(0.1, self.suspend),
            self.create_timer(0.1, self.be_called),
        ]

    def block(self) -> None:
        """Hold up the callbacks until it is there."""
        try:
            self.buffer.lookup_transform(
                "base_link", "wheel", rclpy.time.Time(), timeout=Duration(seconds=0.1)
            )
            self.get_logger().info("blocked: got it", once=True)
        except LookupException as ex:
            self.get_logger().info(f"blocked: {ex}", once=True)

    async def suspend(self) -> None:
        """Let other callbacks run until it is there."""
        self.timers[1].cancel()
        await self.buffer.lookup_transform_async("base_link", "wheel", rclpy.time.Time())
        self.get_logger().info("suspended: got it")

    def be_called(self) -> None:
        """Have a callback called when it is there."""
        self.timers[2].cancel()
        future = self.buffer.wait_for_transform_async("base_link", "wheel", rclpy.time.Time())
        future.add_done_callback(self.on_ready)

    def on_ready(self, future: Any) -> None:
        """It is there."""
        child = future.result().child_frame_id
        self.get_logger().info(f"called: got {child}")
        print(self.buffer.all_frames_as_yaml(), flush=True)


PROGRAMS: dict[str, Any] = {
    "turtle": TurtleFrame,
    "follower": Follower,
    "carrot": lambda: Carrot(False),
    "moving_carrot": lambda: Carrot(True),
    "static": StaticFrame,
    "points": PointSender,
}


def main() -> None:
    """As one of theirs."""
    if sys.argv[1] in ("waiter", "wheel"):
        main_of_examples()
    else:
        main_of_turtles()


def main_of_turtles() -> None:
    """As the programs of turtle_tf2_py begin and end."""
    _, name, *arguments = remove_ros_args(sys.argv)
    rclpy.init()
    node = PROGRAMS[name](*arguments)
    try:  # noqa: SIM105  # as programs of ROS have it
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass

    rclpy.shutdown()


def main_of_examples() -> None:
    """As those of examples_tf2_py."""
    try:
        with rclpy.init():
            is_waiter = sys.argv[1] == "waiter"
            executor: Any = MultiThreadedExecutor() if is_waiter else SingleThreadedExecutor()
            nodes: list[Any] = [Waiter()] if is_waiter else [Wheel(), Joints()]
            for node in nodes:
                executor.add_node(node)
            executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
