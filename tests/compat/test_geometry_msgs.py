"""Messages of ROS's layout, and how transforms change them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from tests.builders import transforms
from tfbus import Transform
from tfbus.compat import tf2_geometry_msgs as tf2
from tfbus.compat import tf2_ros
from tfbus.compat.builtin_interfaces import msg as builtin
from tfbus.compat.geometry_msgs.msg import (
    Point32,
    PointStamped,
    PolygonStamped,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Vector3Stamped,
)
from tfbus.compat.geometry_msgs.msg import PointStamped as Ported
from tfbus.compat.rclpy.time import Time
from tfbus.compat.std_msgs.msg import Header

# Half a turn about x, a metre along x.
FLIP = TransformStamped(header=Header(stamp=builtin.Time(sec=2), frame_id="a"), child_frame_id="b")
FLIP.transform.translation.x = 1.0
FLIP.transform.rotation = Quaternion(x=1.0, w=0.0)


def xyz(point: Any) -> tuple[float, float, float]:
    """The three numbers of a point or vector."""
    return point.x, point.y, point.z


def of(transform: Transform) -> TransformStamped:
    """The transform as a message."""
    message = TransformStamped()
    message.transform.translation.x, message.transform.translation.y = transform.x, transform.y
    message.transform.translation.z = transform.z
    q = message.transform.rotation
    q.x, q.y, q.z, q.w = (float(number) for number in transform.quat_xyzw)
    return message


def test_two_messages_share_nothing() -> None:
    """What is filled into one does not show in another."""
    one = TransformStamped()
    one.header.frame_id, one.transform.rotation.x = "a", 1.0
    assert TransformStamped().header.frame_id == "" and TransformStamped().transform.rotation.x == 0


def test_a_new_rotation_is_the_identity() -> None:
    """As in ROS 2."""
    assert TransformStamped().transform.rotation == Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def test_a_point_is_turned_and_moved_a_vector_only_turned() -> None:
    """Both get the header of the transform, which stays as it is."""
    point, vector = PointStamped(), Vector3Stamped()
    for each in (point.point, vector.vector):
        each.x, each.y, each.z = 1.0, 2.0, 3.0
    moved, turned = tf2.do_transform_point(point, FLIP), tf2.do_transform_vector3(vector, FLIP)
    assert xyz(moved.point) == (2.0, -2.0, -3.0) and xyz(turned.vector) == (1.0, -2.0, -3.0)
    assert moved.header == turned.header == FLIP.header and moved.header is not FLIP.header
    assert FLIP.transform.translation.x == 1.0 and xyz(point.point) == (1.0, 2.0, 3.0)


def test_a_pose_is_turned_and_moved() -> None:
    """Of the two quaternions of its rotation it has the one whose w is not negative."""
    pose = PoseStamped(pose=Pose(orientation=Quaternion(x=1.0, w=0.0)))
    pose.pose.position.x = 1.0
    done = tf2.do_transform_pose_stamped(pose, FLIP)
    assert xyz(done.pose.position) == (2.0, 0.0, 0.0)
    assert done.pose.orientation == Quaternion() and done.header == FLIP.header


def test_a_pose_stamped_is_no_pose() -> None:
    """As in ROS 1 it was; the error says which function takes one."""
    with pytest.raises(TypeError, match="do_transform_pose_stamped"):
        tf2.do_transform_pose(PoseStamped(), FLIP)


def test_a_covariance_is_turned() -> None:
    """With y and z flipped each covariance of one of them with another axis changes its sign."""
    pose = PoseWithCovarianceStamped()
    pose.pose.covariance = [float(number) for _ in range(6) for number in range(1, 7)]
    done = tf2.do_transform_pose_with_covariance_stamped(pose, FLIP)
    signs = np.outer((1, -1, -1, 1, -1, -1), (1, -1, -1, 1, -1, -1))
    expected = signs * np.tile(np.arange(1.0, 7.0), (6, 1))
    assert np.array_equal(np.reshape(done.pose.covariance, (6, 6)), expected)
    with pytest.raises(ValueError, match="36 numbers"):
        tf2.transform_covariance([0.0] * 9, FLIP)


@given(transforms())
def test_a_covariance_keeps_its_axes(transform: Transform) -> None:
    """Its eigenvalues stay, and the way back gives it as it was."""
    covariance = np.diag((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    turned = np.reshape(tf2.transform_covariance(covariance.ravel(), of(transform)), (6, 6))
    assert np.allclose(np.linalg.eigvalsh(turned), (1, 2, 3, 4, 5, 6))
    back = tf2.transform_covariance(turned.ravel(), of(transform.inverse()))
    assert np.allclose(np.reshape(back, (6, 6)), covariance)


@given(transforms(), transforms())
def test_a_pose_is_composed(transform: Transform, pose: Transform) -> None:
    """As `@` of tfbus composes, and its point as `apply`."""
    given = Pose(orientation=of(pose).transform.rotation)
    given.position.x, given.position.y, given.position.z = pose.x, pose.y, pose.z
    done = tf2.do_transform_pose(given, of(transform))
    o = done.orientation
    assert Transform(xyz(done.position), (o.x, o.y, o.z, o.w)).is_close(transform @ pose, 1e-6)


def test_a_polygon_is_moved_corner_by_corner() -> None:
    """Its corners stay in their order."""
    area = PolygonStamped()
    area.polygon.points = [Point32(y=1.0), Point32(z=2.0)]
    done = tf2.do_transform_polygon_stamped(area, FLIP)
    assert [xyz(point) for point in done.polygon.points] == [(1.0, -1.0, 0.0), (1.0, 0.0, -2.0)]


@pytest.mark.parametrize("new_type", [None, PointStamped])
def test_a_buffer_transforms_registered_messages(new_type: type | None) -> None:
    """At the time of their header."""
    buffer = tf2_ros.Buffer()
    buffer.set_transform(FLIP, "test")
    point = PointStamped(header=Header(stamp=builtin.Time(sec=2), frame_id="a"))
    point.point.y = 2.0
    found = buffer.transform(point, "b", new_type=new_type)
    assert xyz(found.point) == (-1.0, -2.0, 0.0) and found.header.frame_id == "b"
    full = buffer.transform_full(point, "b", Time(seconds=2), "a")
    assert full == found


def test_a_type_of_ones_own_is_registered() -> None:
    """Or the error says how."""

    @dataclass
    class Height:
        header: Header
        z: float

    buffer = tf2_ros.Buffer()
    buffer.set_transform(FLIP, "test")
    height = Height(FLIP.header, 2.0)
    with pytest.raises(tf2_ros.TypeException, match=r"TransformRegistration\(\)\.add\(Height"):
        buffer.transform(height, "b")
    buffer.registration.add(Height, lambda it, t: Height(t.header, -it.z))
    assert buffer.transform(height, "b").z == -2.0


def test_a_message_of_ros_itself_is_known_by_its_name() -> None:
    """geometry_msgs' PointStamped has the function of ours, and stays of its class."""

    class PointStamped(Ported):
        pass

    PointStamped.__module__ = "geometry_msgs.msg._point_stamped"
    found = tf2_ros.TransformRegistration().get(PointStamped)(PointStamped(), FLIP)
    assert type(found) is PointStamped and found.header.stamp.sec == 2


def test_objects_are_converted_by_what_was_registered() -> None:
    """By way of a message, or directly; to their own type they are copied."""

    class Reading:
        def __init__(self, x: float) -> None:
            self.x = x

    reading = tf2_ros.Stamped(Reading(3.0), builtin.Time(sec=1), "map")
    with pytest.raises(tf2_ros.TypeException, match="add_to_msg"):
        tf2_ros.convert(reading, PointStamped)
    registration = tf2_ros.ConvertRegistration()

    def to_msg(it: Any) -> PointStamped:
        message = PointStamped(header=it.header)
        message.point.x = it.x
        return message

    registration.add_to_msg(Reading, to_msg)
    registration.add_from_msg(Reading, lambda message: Reading(message.point.x))
    message = tf2_ros.convert(reading, PointStamped)
    assert message.header == Header(stamp=builtin.Time(sec=1), frame_id="map")
    assert tf2_ros.convert(message, Reading).x == 3.0
    copied = tf2_ros.convert(message, PointStamped)
    assert copied == message and copied is not message
