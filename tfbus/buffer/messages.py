"""Messages of `tfbus.messages`, moved from their frame into another one: `Buffer.transform`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from tfbus import messages
from tfbus.base.errors import InvalidArgumentException
from tfbus.geometry.transform import Transform, TransformStamped
from tfbus.geometry.transform_array import TransformArray

Stamps = NDArray[np.int64]

M = TypeVar("M")

_NORMALS = ("normal_x", "normal_y", "normal_z")


class Lookups(NamedTuple):
    """The lookups of a buffer or a recording: from a target and a source frame and a stamp, or the
    latest time for None, the transform; and with stamps (N,) the transforms.
    """

    one: Callable[[str, str, int | None], TransformStamped]
    each: Callable[[str, str, Stamps], TransformArray]


def transformed(
    lookups: Lookups, message: Any, target_frame: str, fixed_frame: str | None = None
) -> Any:
    """The message in the target frame; see `Buffer.transform`."""
    if isinstance(message, messages.MarkerArray):
        moved = (transformed(lookups, each, target_frame, fixed_frame) for each in message.markers)
        return replace(message, markers=tuple(moved))
    if isinstance(message, messages.Marker) and message.action in _DELETIONS:
        return message
    if type(message) not in (*_MOVES, messages.PointCloud, messages.LaserScan):
        names = sorted(each.__name__ for each in _MOVES)
        raise InvalidArgumentException(
            f"message: a {type(message).__name__} cannot be transformed; expected one of "
            f"{', '.join(names)}, LaserScan, MarkerArray, PointCloud"
        )
    if not message.frame_id:
        raise InvalidArgumentException(f"this {type(message).__name__} has no frame_id")
    stamps = stamps_in(message)
    if stamps is not None and len(stamps):
        return _undistorted(lookups, message, stamps, target_frame, fixed_frame)
    stamp_ns = message.stamp_ns or None  # 0 stands for the latest time, as in ROS
    if isinstance(message, messages.Marker) and message.frame_locked:
        stamp_ns = None
    answer = lookups.one(target_frame, message.frame_id, stamp_ns)
    if isinstance(message, messages.Path):
        message = _in_one_frame(lookups, message, stamp_ns)
    return moved_by(message, answer)


# Of a deletion only the name counts; often it has no frame.
_DELETIONS = (messages.Marker.DELETE, messages.Marker.DELETEALL)


def moved_by(message: M, transform: TransformStamped) -> M:
    """The message, moved by a transform from its frame; a scan becomes a PointCloud. The stamp
    stays, or is the transform's if it is 0.
    """
    stamp_ns = message.stamp_ns or transform.stamp_ns  # type: ignore[attr-defined]
    header = {"stamp_ns": stamp_ns, "frame_id": transform.frame_id}
    if isinstance(message, messages.PointCloud | messages.LaserScan):
        return cast(M, _with_points(_cloud_of(message), transform.transform, header))
    move = _MOVES[type(message)]
    moved: M = replace(message, **header, **move(message, transform.transform))  # type: ignore[type-var]
    return moved


def stamps_in(message: Any) -> Stamps | None:
    """When each point of a scan or cloud was measured (N,); None for a message of one time."""
    if isinstance(message, messages.PointCloud):
        return message.stamps_ns() if message.stamp_ns else None
    if isinstance(message, messages.LaserScan) and message.time_increment and message.stamp_ns:
        return message.stamps_ns()
    return None


def _undistorted(
    lookups: Lookups,
    message: messages.PointCloud | messages.LaserScan,
    stamps: Stamps,
    target_frame: str,
    fixed_frame: str | None,
) -> messages.PointCloud:
    """The points, each by the transform at its own time, as one at the stamp of the message."""
    last_ns = max(int(stamps.max()), message.stamp_ns)
    through = target_frame if fixed_frame is None else fixed_frame
    lookups.one(through, message.frame_id, last_ns)  # waits for the last one
    cloud = _cloud_of(message)
    times, of_point = _each_once(stamps)
    motions = lookups.each(through, message.frame_id, times)
    if of_point is not None:
        motions = motions[of_point]
    if fixed_frame is not None:
        motions = lookups.one(target_frame, fixed_frame, message.stamp_ns).transform @ motions
    return _with_points(cloud, motions, {"stamp_ns": message.stamp_ns, "frame_id": target_frame})


def _each_once(stamps: Stamps) -> tuple[Stamps, NDArray[np.intp] | None]:
    """Each run of equal stamps once, and the index of each stamp's run, None if few repeat; many
    points of a lidar are measured at once.
    """
    begins = np.empty(len(stamps), np.bool_)
    begins[0] = True
    np.not_equal(stamps[1:], stamps[:-1], out=begins[1:])
    if begins.sum() * 2 > len(stamps):
        return stamps, None
    return stamps[begins], np.cumsum(begins) - 1


# Points


def _cloud_of(message: messages.PointCloud | messages.LaserScan) -> messages.PointCloud:
    return message if isinstance(message, messages.PointCloud) else message.cloud()


def _with_points(
    cloud: messages.PointCloud, motion: Transform | TransformArray, header: Mapping[str, Any]
) -> messages.PointCloud:
    missing = [name for name in "xyz" if name not in cloud]
    if missing:
        raise InvalidArgumentException(
            f"the cloud must have the columns x, y and z; it lacks {', '.join(missing)}"
        )
    points = cloud.as_array().copy()
    _move(points, tuple("xyz"), motion, motion.xyz.T)
    if all(name in cloud for name in _NORMALS):
        _move(points, _NORMALS, motion, np.zeros(3))
    if isinstance(motion, TransformArray):
        cloud.at_stamp(points)
    data = points.reshape(-1).view(np.uint8)
    row_step = cloud.width * cloud.point_step
    return replace(cloud, **header, data=data, row_step=row_step)


def _move(
    points: NDArray[Any],
    names: tuple[str, ...],
    motion: Transform | TransformArray,
    distances: NDArray[np.float64],
) -> None:
    """Turn the vectors in three columns, and then move them.

    Column by column: on a busy machine the
    threads of BLAS take fifty times as long for matrices that are three wide.
    """
    x, y, z = (points[name].astype(np.float64).reshape(-1) for name in names)
    if isinstance(motion, Transform):
        turned = [a * x + b * y + c * z for a, b, c in motion.as_matrix()[:3, :3].tolist()]
    else:
        qx, qy, qz, qw = motion.quat_xyzw.T
        twice_x, twice_y, twice_z = (
            2.0 * (qy * z - qz * y),
            2.0 * (qz * x - qx * z),
            2.0 * (qx * y - qy * x),
        )
        turned = [
            x + qw * twice_x + qy * twice_z - qz * twice_y,
            y + qw * twice_y + qz * twice_x - qx * twice_z,
            z + qw * twice_z + qx * twice_y - qy * twice_x,
        ]
    for name, column, distance in zip(names, turned, distances, strict=True):
        points[name] = (column + distance).reshape(points.shape)


# Poses, vectors and covariances


def _pose(pose: messages.Pose3D, motion: Transform) -> messages.Pose3D:
    position, turn = pose.position, pose.orientation
    moved = motion @ Transform(
        (position.x, position.y, position.z), (turn.x, turn.y, turn.z, turn.w)
    )
    x, y, z, qx, qy, qz, qw = moved.as_pose()
    return messages.Pose3D(messages.Vector3(x, y, z), messages.Quaternion(qx, qy, qz, qw))


def _point(point: messages.Vector3, motion: Transform) -> messages.Vector3:
    x, y, z = motion.apply((point.x, point.y, point.z)).tolist()
    return messages.Vector3(x, y, z)


def _vector(vector: messages.Vector3, motion: Transform) -> messages.Vector3:
    x, y, z = motion.rotate((vector.x, vector.y, vector.z)).tolist()
    return messages.Vector3(x, y, z)


def _covariance(covariance: tuple[float, ...], motion: Transform) -> tuple[float, ...]:
    """The covariance of a vector (3 by 3), or of a pose (6 by 6), about the axes of the target.

    A pose's is of x, y, z and of rotations about fixed axes through the body, as in ROS: its
    adjoint turns both, and the distance of the frames couples nothing. All 0 and a first -1 stand
    for a covariance that is not known, and stay.
    """
    if not any(covariance) or (len(covariance) == 9 and covariance[0] == -1.0):
        return covariance
    size = 3 if len(covariance) == 9 else 6
    adjoint = np.zeros((size, size))
    turn = motion.as_matrix()[:3, :3]
    for at in range(0, size, 3):
        adjoint[at : at + 3, at : at + 3] = turn
    matrix = np.array(covariance).reshape(size, size)
    return tuple((adjoint @ matrix @ adjoint.T).ravel().tolist())


def _pose_with_covariance(
    pose: messages.PoseWithCovariance, motion: Transform
) -> messages.PoseWithCovariance:
    return messages.PoseWithCovariance(
        _pose(pose.pose, motion), _covariance(pose.covariance, motion)
    )


def _imu(imu: messages.Imu, motion: Transform) -> dict[str, Any]:
    """The measurements about the axes of the target, and its own orientation: in the same world as
    before.
    """
    turn = imu.orientation
    orientation = imu.orientation
    if any((turn.x, turn.y, turn.z, turn.w)) and imu.orientation_covariance[0] != -1.0:
        of_target = Transform((0, 0, 0), (turn.x, turn.y, turn.z, turn.w)) @ ~motion
        orientation = messages.Quaternion(*of_target.as_pose()[3:])
    made: dict[str, Any] = {"orientation": orientation}
    for name in ("angular_velocity", "linear_acceleration"):
        made[name] = _vector(getattr(imu, name), motion)
        covariance = f"{name}_covariance"
        made[covariance] = _covariance(getattr(imu, covariance), motion)
    return made


def _in_one_frame(lookups: Lookups, path: messages.Path, stamp_ns: int | None) -> messages.Path:
    """The path with all poses in its own frame; some may have another one."""
    others = {each.frame_id for each in path.poses} - {"", path.frame_id}
    if not others:
        return path
    into = {frame: lookups.one(path.frame_id, frame, stamp_ns) for frame in others}
    poses = tuple(
        replace(each, frame_id=path.frame_id, pose=_pose(each.pose, into[each.frame_id].transform))
        if each.frame_id in into
        else each
        for each in path.poses
    )
    return replace(path, poses=poses)


def _path(path: messages.Path, motion: Transform) -> dict[str, Any]:
    return {"poses": tuple(replace(each, pose=_pose(each.pose, motion)) for each in path.poses)}


def _poses(poses: messages.PoseArray, motion: Transform) -> dict[str, Any]:
    moved = motion @ TransformArray(poses.poses[:, :3], poses.poses[:, 3:])
    return {"poses": np.hstack((moved.xyz, moved.quat_xyzw))}


# The fields of each type that change, beside stamp and frame.
_MOVES: Mapping[type, Callable[[Any, Transform], dict[str, Any]]] = {
    messages.Imu: _imu,
    messages.Marker: lambda it, motion: {"pose": _pose(it.pose, motion)},
    messages.OccupancyGrid: lambda it, motion: {
        "info": replace(it.info, origin=_pose(it.info.origin, motion))
    },
    messages.Odometry: lambda it, motion: {"pose": _pose_with_covariance(it.pose, motion)},
    messages.Path: _path,
    messages.PointStamped: lambda it, motion: {"point": _point(it.point, motion)},
    messages.PolygonStamped: lambda it, motion: {
        "polygon": messages.Polygon(motion.apply(it.polygon.points).astype(np.float32))
    },
    messages.PoseArray: _poses,
    messages.PoseStamped: lambda it, motion: {"pose": _pose(it.pose, motion)},
    messages.PoseWithCovarianceStamped: lambda it, motion: {
        "pose": _pose_with_covariance(it.pose, motion)
    },
}
