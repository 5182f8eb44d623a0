"""ROS's geometry_msgs.msg: the same names and fields, to be filled in as there.

Lengths are metres, angles radians, quaternions x, y, z, w. A new quaternion is the identity.
Covariances are lists of 36 numbers, row by row, in the order x, y, z, and rotations about them.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages
from tfbus.compat.std_msgs.msg import Header

__all__ = [
    "Point",
    "Point32",
    "PointStamped",
    "Polygon",
    "PolygonStamped",
    "Pose",
    "PoseStamped",
    "PoseWithCovariance",
    "PoseWithCovarianceStamped",
    "Quaternion",
    "Transform",
    "TransformStamped",
    "Twist",
    "Vector3",
    "Vector3Stamped",
]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


@dataclass(slots=True, kw_only=True)
class Vector3:
    """A direction with a length; a transform turns it, and does not move it."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(slots=True, kw_only=True)
class Point:
    """A position."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(slots=True, kw_only=True)
class Point32:
    """A position, in ROS in single precision."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(slots=True, kw_only=True)
class Quaternion:
    """A rotation."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


@dataclass(slots=True, kw_only=True)
class Transform:
    """A rotation, then a translation."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass(slots=True, kw_only=True)
class TransformStamped:
    """Takes data in `child_frame_id` into the frame of the header, at the time of the header."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass(slots=True, kw_only=True)
class Pose:
    """A position and an orientation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass(slots=True, kw_only=True)
class PoseStamped:
    """A pose in the frame and at the time of its header."""

    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass(slots=True, kw_only=True)
class PoseWithCovariance:
    """A pose, and how uncertain it is."""

    pose: Pose = field(default_factory=Pose)
    covariance: list[float] = field(default_factory=lambda: [0.0] * 36)


@dataclass(slots=True, kw_only=True)
class PoseWithCovarianceStamped:
    """A pose with its covariance in the frame and at the time of its header."""

    header: Header = field(default_factory=Header)
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)


@dataclass(slots=True, kw_only=True)
class PointStamped:
    """A point in the frame and at the time of its header."""

    header: Header = field(default_factory=Header)
    point: Point = field(default_factory=Point)


@dataclass(slots=True, kw_only=True)
class Vector3Stamped:
    """A vector in the frame and at the time of its header."""

    header: Header = field(default_factory=Header)
    vector: Vector3 = field(default_factory=Vector3)


@dataclass(slots=True, kw_only=True)
class Polygon:
    """The corners of an area."""

    points: list[Point32] = field(default_factory=list)


@dataclass(slots=True, kw_only=True)
class PolygonStamped:
    """An area in the frame and at the time of its header."""

    header: Header = field(default_factory=Header)
    polygon: Polygon = field(default_factory=Polygon)


@dataclass(slots=True, kw_only=True)
class Twist:
    """Velocities of a body: `linear` in m/s, `angular` in rad/s about each axis."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)
