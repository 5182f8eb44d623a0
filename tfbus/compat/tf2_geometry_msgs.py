"""ROS's tf2_geometry_msgs: transforms of its messages; importing it lets `Buffer.transform` do so.

Messages of ROS itself work as well; the result is of the type that was given, with the header of
the transform. No argument is changed.
"""

from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.compat.tf2_ros.buffer_interface import ConvertRegistration, TransformRegistration
from tfbus.geometry.transform import Transform
from tfbus.ros.message_classes import message_class
from tfbus.ros.transforms import stamp_ns_of, transform_of

__all__ = [
    "do_transform_point",
    "do_transform_polygon_stamped",
    "do_transform_pose",
    "do_transform_pose_stamped",
    "do_transform_pose_with_covariance_stamped",
    "do_transform_vector3",
    "from_msg_msg",
    "to_msg_msg",
    "transform_covariance",
]


def do_transform_point(point: Any, transform: Any) -> Any:
    """A PointStamped in the frame of the transform."""
    done = type(point)()
    _set_xyz(done.point, _motion(transform).apply(_xyz(point.point)))
    return _with_header(done, transform)


def do_transform_vector3(vector3: Any, transform: Any) -> Any:
    """A Vector3Stamped in the frame of the transform: turned, not moved."""
    done = type(vector3)()
    _set_xyz(done.vector, _motion(transform).rotate(_xyz(vector3.vector)))
    return _with_header(done, transform)


def do_transform_pose(pose: Any, transform: Any) -> Any:
    """A Pose in the frame of the transform. Raises TypeError for a PoseStamped."""
    if not hasattr(pose, "position"):
        raise TypeError(
            f"do_transform_pose takes a Pose, not a {type(pose).__name__}: "
            "do_transform_pose_stamped takes a PoseStamped"
        )
    moved = _motion(transform) @ transform_of(pose.position, pose.orientation)
    done = type(pose)()
    _set_xyz(done.position, moved.xyz)
    # Of the two quaternions of a rotation tf2 gives the one whose w is not negative.
    sign = -1.0 if moved.qw < 0.0 else 1.0
    quaternion = done.orientation
    quaternion.x, quaternion.y = sign * moved.qx, sign * moved.qy
    quaternion.z, quaternion.w = sign * moved.qz, sign * moved.qw
    return done


def do_transform_pose_stamped(pose: Any, transform: Any) -> Any:
    """A PoseStamped in the frame of the transform."""
    done = type(pose)()
    done.pose = do_transform_pose(pose.pose, transform)
    return _with_header(done, transform)


def do_transform_pose_with_covariance_stamped(pose: Any, transform: Any) -> Any:
    """A PoseWithCovarianceStamped in the frame of the transform; its covariance is turned."""
    done = type(pose)()
    done.pose.pose = do_transform_pose(pose.pose.pose, transform)
    done.pose.covariance = transform_covariance(pose.pose.covariance, transform)
    return _with_header(done, transform)


def do_transform_polygon_stamped(polygon: Any, transform: Any) -> Any:
    """A PolygonStamped in the frame of the transform."""
    motion = _motion(transform)
    done = type(polygon)()
    for point in polygon.polygon.points:
        moved = type(point)()
        _set_xyz(moved, motion.apply(_xyz(point)))
        done.polygon.points.append(moved)
    return _with_header(done, transform)


def transform_covariance(cov_in: Any, transform: Any) -> list[float]:
    """A covariance of 36 numbers, row by row, with its axes turned by the transform.

    Raises ValueError if they are not 36. Formula: C' = B C B^T, where B has the rotation twice
    on its diagonal.
    """
    covariance = np.asarray(cov_in, dtype=float)
    if covariance.shape != (36,):
        raise ValueError(f"a covariance has 36 numbers, not {covariance.shape}")
    rotation = _motion(transform).as_matrix()[:3, :3]
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = rotation
    turned: list[float] = (both @ covariance.reshape(6, 6) @ both.T).ravel().tolist()
    return turned


def to_msg_msg(msg: Any) -> Any:
    """The message itself, for `convert`."""
    return msg


def from_msg_msg(msg: Any) -> Any:
    """The message itself, for `convert`."""
    return msg


def _motion(transform: Any) -> Transform:
    return transform_of(transform.transform.translation, transform.transform.rotation)


def _xyz(point: Any) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _set_xyz(point: Any, xyz: Any) -> None:
    point.x, point.y, point.z = xyz.tolist()


def _with_header(done: Any, transform: Any) -> Any:
    # Field by field: the header of the transform may be of another type, and is not to be shared.
    stamp = done.header.stamp
    parts = divmod(stamp_ns_of(transform.header.stamp, "header.stamp"), 1_000_000_000)
    if hasattr(stamp, "nanosec"):
        stamp.sec, stamp.nanosec = parts
    else:  # that of ROS 1
        stamp.secs, stamp.nsecs = parts
    done.header.frame_id = transform.header.frame_id
    return done


for _name, _do_transform in (
    ("PointStamped", do_transform_point),
    ("Vector3Stamped", do_transform_vector3),
    ("PoseStamped", do_transform_pose_stamped),
    ("PoseWithCovarianceStamped", do_transform_pose_with_covariance_stamped),
    ("PolygonStamped", do_transform_polygon_stamped),
):
    _type = message_class(f"geometry_msgs/msg/{_name}")
    TransformRegistration().add(_type, _do_transform)
for _name in ("PointStamped", "Vector3Stamped", "PoseStamped"):
    _type = message_class(f"geometry_msgs/msg/{_name}")
    ConvertRegistration().add_to_msg(_type, to_msg_msg)
    ConvertRegistration().add_from_msg(_type, from_msg_msg)
