"""Messages of poses, velocities and their covariances."""

from dataclasses import dataclass, field
from math import hypot
from typing import ClassVar

from tfbus.messages.fields import (
    Former,
    Points32Array,
    PosesArray,
    WithArrays,
    check_all_finite,
    check_count,
    check_finite,
    check_stamp,
    no_numbers,
)

# How far from 1 the length of a quaternion may be.
_UNIT_WITHIN = 1e-3


@dataclass(frozen=True, slots=True)
class Vector3:
    """Three components along x, y and z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def __post_init__(self) -> None:
        check_finite("x", self.x)
        check_finite("y", self.y)
        check_finite("z", self.z)


@dataclass(frozen=True, slots=True)
class Quaternion:
    """A rotation, or no value if all are 0; the length is checked if it must be 1."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0

    def __post_init__(self) -> None:
        check_finite("x", self.x)
        check_finite("y", self.y)
        check_finite("z", self.z)
        check_finite("w", self.w)


@dataclass(frozen=True, slots=True)
class Pose3D:
    """A pose in space, geometry_msgs/Pose: `position` in m, `orientation` a unit quaternion.

    `Pose` is turtlesim's.
    """

    position: Vector3 = field(default_factory=Vector3)
    orientation: Quaternion = field(default_factory=Quaternion)

    def __post_init__(self) -> None:
        turn = self.orientation
        if abs(hypot(turn.x, turn.y, turn.z, turn.w) - 1.0) > _UNIT_WITHIN:
            raise ValueError(f"orientation must be a unit quaternion, not {turn}")


@dataclass(frozen=True, slots=True)
class Twist:
    """Velocities in the frame of the body: `linear` in m/s, `angular` in rad/s about each axis.

    A turtle drives forward by linear.x, turns by angular.z, and moves left by linear.y if the
    simulator is holonomic.
    """

    __ros__: ClassVar[str] = "geometry_msgs/msg/Twist"

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass(frozen=True, slots=True)
class PoseStamped:
    """A pose in the frame `frame_id` at stamp_ns."""

    __ros__: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    __former__: ClassVar[Former] = {
        "frame": "frame_id",
        "position": "pose.position",
        "quat_xyzw": tuple(f"pose.orientation.{axis}" for axis in "xyzw"),
    }

    stamp_ns: int
    frame_id: str
    pose: Pose3D = field(default_factory=Pose3D)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class PointStamped:
    """A point in the frame `frame_id` at stamp_ns, in m, as a click on a scene gives it."""

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/PointStamped"

    stamp_ns: int
    frame_id: str
    point: Vector3 = field(default_factory=Vector3)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class Path:
    """A way to go at stamp_ns: poses one behind the other, in the frame `frame_id`.

    A pose may have a stamp of its own, when to be there, and another frame.
    """

    __msgtype__: ClassVar[str] = "nav_msgs/msg/Path"

    stamp_ns: int
    frame_id: str
    poses: tuple[PoseStamped, ...] = ()

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class PoseWithCovariance:
    """A pose, and how sure it is.

    The covariance has 6 by 6 numbers, row by row, in the order x, y, z and rotations about x, y, z;
    all are 0 if it is not known.
    """

    pose: Pose3D = field(default_factory=Pose3D)
    covariance: tuple[float, ...] = (0.0,) * 36

    def __post_init__(self) -> None:
        check_count("covariance", self.covariance, 36)


@dataclass(frozen=True, slots=True)
class PoseWithCovarianceStamped:
    """A pose in the frame `frame_id` at stamp_ns, and how sure it is, as localisation gives it."""

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"

    stamp_ns: int
    frame_id: str
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class TwistWithCovariance:
    """A velocity, and how sure it is, as in PoseWithCovariance."""

    twist: Twist = field(default_factory=Twist)
    covariance: tuple[float, ...] = (0.0,) * 36

    def __post_init__(self) -> None:
        check_count("covariance", self.covariance, 36)


@dataclass(frozen=True, slots=True)
class Odometry:
    """The pose of a robot by its own reckoning at stamp_ns, and its velocity.

    `pose` is of `child_frame_id` in `frame_id`; `twist` is its velocity, in `child_frame_id`,
    in m/s and rad/s.
    """

    __ros__: ClassVar[str] = "nav_msgs/msg/Odometry"
    __former__: ClassVar[Former] = {
        "frame": "frame_id",
        "child_frame": "child_frame_id",
        "position": "pose.pose.position",
        "quat_xyzw": tuple(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
        "pose_covariance": "pose.covariance",
        "twist": "twist.twist",
        "twist_covariance": "twist.covariance",
    }

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True, eq=False)
class PoseArray(WithArrays):
    """Poses in the frame `frame_id` at stamp_ns, such as the particles of a filter.

    `poses` (N, 7) has a row for each: x, y, z in m, and a unit quaternion x, y, z, w.
    """

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/PoseArray"

    stamp_ns: int
    frame_id: str
    poses: PosesArray = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        self._make_arrays()
        check_all_finite("poses", self.poses)
        quat_xyzw = self.poses[:, 3:]
        squares = (quat_xyzw * quat_xyzw).sum(axis=1)
        if len(squares) and max(squares.max() - 1.0, 1.0 - squares.min()) > 2 * _UNIT_WITHIN:
            at = int(abs(squares - 1.0).argmax())
            raise ValueError(f"poses[{at}] must have a unit quaternion, not {quat_xyzw[at]}")


@dataclass(frozen=True, slots=True, eq=False)
class Polygon(WithArrays):
    """An area with the corners `points` (N, 3) in m, of which the last is joined to the first."""

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/Polygon"

    points: Points32Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        self._make_arrays()
        check_all_finite("points", self.points)


@dataclass(frozen=True, slots=True)
class PolygonStamped:
    """A polygon in the frame `frame_id` at stamp_ns, such as the footprint of a robot."""

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/PolygonStamped"

    stamp_ns: int
    frame_id: str
    polygon: Polygon = field(default_factory=Polygon)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
