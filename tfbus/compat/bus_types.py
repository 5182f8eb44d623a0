"""What ROS's messages are on the bus: those that tfbus has in another layout are converted.

All others go as they are, by the names of their fields: Twist, and every dataclass of a program.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from tfbus import messages as bus
from tfbus.compat.rclpy.time import Time, stamp_ns_of
from tfbus.compat.sensor_msgs.msg import JointState
from tfbus.compat.std_msgs.msg import Header
from tfbus.compat.turtlesim.msg import Pose
from tfbus.runtime.clock import Clock


@dataclass(frozen=True)
class BusType:
    """The type of a topic's messages on the bus, and the way there and back."""

    type: type[Any]
    to_bus: Callable[[Any], Any]
    from_bus: Callable[[Any], Any]


def bus_type_of(message_type: type, clock: Clock) -> BusType:
    """How messages of this type go over the bus; `clock` stamps those that have no stamp in ROS."""
    if message_type is Pose:
        return BusType(bus.Pose, partial(_pose_to_bus, clock), _pose_from_bus)
    if message_type is JointState:
        return BusType(bus.JointState, _joints_to_bus, _joints_from_bus)
    return BusType(message_type, _as_it_is, _as_it_is)


def _as_it_is(message: Any) -> Any:
    return message


def _pose_to_bus(clock: Clock, pose: Pose) -> bus.Pose:
    return bus.Pose(
        clock.now_ns(), pose.x, pose.y, pose.theta, pose.linear_velocity, pose.angular_velocity
    )


def _pose_from_bus(pose: bus.Pose) -> Pose:
    return Pose(
        x=pose.x,
        y=pose.y,
        theta=pose.theta,
        linear_velocity=pose.linear_velocity,
        angular_velocity=pose.angular_velocity,
    )


def _joints_to_bus(state: JointState) -> bus.JointState:
    return bus.JointState(
        stamp_ns_of(state.header.stamp, "header.stamp"),
        tuple(state.name),
        tuple(map(float, state.position)),
        tuple(map(float, state.velocity)),
        tuple(map(float, state.effort)),
    )


def _joints_from_bus(state: bus.JointState) -> JointState:
    return JointState(
        header=Header(stamp=Time(nanoseconds=max(0, state.stamp_ns)).to_msg()),
        name=list(state.names),
        position=list(state.positions),
        velocity=list(state.velocities),
        effort=list(state.efforts),
    )
