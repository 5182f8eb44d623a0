"""ROS's tf2_sensor_msgs: transforms of clouds of points, which `Buffer.transform` then does too."""

from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.compat.sensor_msgs_py.point_cloud2 import create_cloud, read_points
from tfbus.compat.tf2_geometry_msgs import from_msg_msg, to_msg_msg
from tfbus.compat.tf2_ros.buffer_interface import ConvertRegistration, TransformRegistration
from tfbus.ros.message_classes import message_class
from tfbus.ros.transforms import Header, transform_of

__all__ = ["do_transform_cloud", "from_msg_msg", "to_msg_msg", "transform_points"]

_PointCloud2: Any = message_class("sensor_msgs/msg/PointCloud2")

# Fields that are a direction, and so turn with the points.
_NORMALS = ("normal_x", "normal_y", "normal_z")


def transform_points(point_cloud: Any, transform: Any) -> Any:
    """Points (N, 3), moved by a Transform."""
    motion = transform_of(transform.translation, transform.rotation)
    return motion.apply(np.asarray(point_cloud, float))


def do_transform_cloud(cloud: Any, transform: Any) -> Any:
    """A PointCloud2, moved by a TransformStamped, and then in its frame, or by a Transform; fields
    other than x, y, z and normals stay as they are.

    Raises AssertionError for a cloud without x, y and z.
    """
    header = Header(stamp=cloud.header.stamp, frame_id=cloud.header.frame_id)
    if hasattr(transform, "transform"):
        header.frame_id = transform.header.frame_id
        transform = transform.transform
    points = read_points(cloud, reshape_organized_cloud=True).copy()
    names = points.dtype.names or ()
    if not {*"xyz"} <= {*names}:
        raise AssertionError(f"the cloud must have x, y and z: it has {', '.join(names)}")
    _set(points, tuple("xyz"), transform_points(_rows(points, tuple("xyz")), transform))
    if {*_NORMALS} <= {*names}:
        motion = transform_of(transform.translation, transform.rotation)
        _set(points, _NORMALS, motion.rotate(_rows(points, _NORMALS)))
    done = create_cloud(header, cloud.fields, points, cloud.point_step)
    done.is_dense = cloud.is_dense
    return done


def _rows(points: Any, names: tuple[str, ...]) -> Any:
    return np.stack([points[name].ravel() for name in names], axis=-1).astype(float)


def _set(points: Any, names: tuple[str, ...], rows: Any) -> None:
    for at, name in enumerate(names):
        points[name] = rows[:, at].reshape(points.shape)


TransformRegistration().add(_PointCloud2, do_transform_cloud)
ConvertRegistration().add_to_msg(_PointCloud2, to_msg_msg)
ConvertRegistration().add_from_msg(_PointCloud2, from_msg_msg)
