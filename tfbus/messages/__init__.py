"""Topics, services and actions of the supplied nodes; the turtles' are turtlesim's.

Lengths are metres, angles radians (counter-clockwise, zero along x), times nanoseconds since the
Unix epoch. A value that is not finite or out of range raises ValueError; on the bus such a message
is dropped and counted.

A message that ROS has too has ROS's fields, by ROS's names; only its `header` is `stamp_ns` and
`frame_id`, and a time such as `lifetime` is `lifetime_ns`. Long sequences of numbers are arrays of
numpy, which cannot be written to. `__ros__` names its type in ROS, and `__former__` the names that
its fields had before; a type with a `__msgtype__` is on the bus under that name of ROS's, in ROS's
layout, and `__times__` are its fields that are times there.
"""

from collections import Counter
from dataclasses import dataclass, field
from math import isfinite
from typing import ClassVar

from tfbus.messages.fields import Former, check_byte, check_finite, check_stamp
from tfbus.messages.geometry import Odometry as Odometry
from tfbus.messages.geometry import Path as Path
from tfbus.messages.geometry import PointStamped as PointStamped
from tfbus.messages.geometry import Polygon as Polygon
from tfbus.messages.geometry import PolygonStamped as PolygonStamped
from tfbus.messages.geometry import Pose3D as Pose3D
from tfbus.messages.geometry import PoseArray as PoseArray
from tfbus.messages.geometry import PoseStamped as PoseStamped
from tfbus.messages.geometry import PoseWithCovariance as PoseWithCovariance
from tfbus.messages.geometry import PoseWithCovarianceStamped as PoseWithCovarianceStamped
from tfbus.messages.geometry import Quaternion as Quaternion
from tfbus.messages.geometry import Twist as Twist
from tfbus.messages.geometry import TwistWithCovariance as TwistWithCovariance
from tfbus.messages.geometry import Vector3 as Vector3
from tfbus.messages.images import CameraInfo as CameraInfo
from tfbus.messages.images import CompressedImage as CompressedImage
from tfbus.messages.images import Image as Image
from tfbus.messages.images import RegionOfInterest as RegionOfInterest
from tfbus.messages.scene import ColorRGBA as ColorRGBA
from tfbus.messages.scene import Log as Log
from tfbus.messages.scene import MapMetaData as MapMetaData
from tfbus.messages.scene import Marker as Marker
from tfbus.messages.scene import MarkerArray as MarkerArray
from tfbus.messages.scene import MeshFile as MeshFile
from tfbus.messages.scene import OccupancyGrid as OccupancyGrid
from tfbus.messages.sensors import Imu as Imu
from tfbus.messages.sensors import LaserScan as LaserScan
from tfbus.messages.sensors import NavSatFix as NavSatFix
from tfbus.messages.sensors import NavSatStatus as NavSatStatus
from tfbus.messages.sensors import PointCloud as PointCloud
from tfbus.messages.sensors import PointField as PointField
from tfbus.messages.sensors import Range as Range


@dataclass(frozen=True, slots=True)
class Pose:
    """The pose of a turtle at stamp_ns, on a field whose origin is the lower left corner.

    x and y in m, theta in rad in [-pi, pi). The velocities are the commanded ones, in m/s and
    rad/s; linear_velocity is a magnitude and never negative.
    """

    __ros__: ClassVar[str] = "turtlesim/msg/Pose"

    stamp_ns: int
    x: float
    y: float
    theta: float
    linear_velocity: float
    angular_velocity: float

    def __post_init__(self) -> None:
        check_finite("x", self.x)
        check_finite("y", self.y)
        check_finite("theta", self.theta)
        check_finite("linear_velocity", self.linear_velocity)
        check_finite("angular_velocity", self.angular_velocity)


@dataclass(frozen=True, slots=True)
class JointState:
    """The positions of a robot's joints at stamp_ns, on the topic joint_states.

    `position`, `velocity` and `effort` are in the order of `name`, or empty if they are not
    known: rad, rad/s and N m for joints that turn, m, m/s and N for those that slide. Positions are
    finite; a velocity or an effort that is not known is NaN. The stamp 0 stands for the time at
    which the message arrives. No name is there twice. `frame_id` is not used.
    """

    __ros__: ClassVar[str] = "sensor_msgs/msg/JointState"
    __former__: ClassVar[Former] = {
        "names": "name",
        "positions": "position",
        "velocities": "velocity",
        "efforts": "effort",
    }

    stamp_ns: int
    frame_id: str = field(default="", kw_only=True)
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for field_name in ("position", "velocity", "effort"):
            numbers = getattr(self, field_name)
            if numbers and len(numbers) != len(self.name):
                raise ValueError(
                    f"{field_name} must be empty or as many as name, which are {len(self.name)}, "
                    f"not {len(numbers)}"
                )
        if len(set(self.name)) != len(self.name):
            [(twice, _)] = Counter(self.name).most_common(1)
            raise ValueError(f"joint {twice[:60]!r} must be in name once, not twice")
        if not all(map(isfinite, self.position)):
            for name, position in zip(self.name, self.position, strict=True):
                check_finite(f"the position of joint {name[:60]!r}", position)


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """A robot, on the topic robot_description, which is retained.

    `urdf` is its description, all xacro expanded. Its frames are the names of its links behind
    `prefix`. `source` says for people where it is from, such as a file.
    """

    __ros__: ClassVar[str] = "std_msgs/msg/String"

    urdf: str
    prefix: str = ""
    source: str = ""


class SetDescription:
    """Gives robot_state another robot."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The new description, in URDF."""

        urdf: str

    @dataclass(frozen=True, slots=True)
    class Response:
        """It is the robot now: its name, and how many links and joints it has."""

        robot: str
        links: int
        joints: int


class RobotMesh:
    """Reads a mesh of a robot from the machine that publishes its description, part by part."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The name of the mesh as in the description, and the first byte to read.

        A name may also be of a texture or material that belongs to a mesh, as a path from it:
        `package://arm/meshes/hand.dae` and then `package://arm/meshes/hand.png`.
        """

        mesh: str
        offset: int = 0

        def __post_init__(self) -> None:
            if self.offset < 0:
                raise ValueError(f"offset must be at least 0, not {self.offset}")

    @dataclass(frozen=True, slots=True)
    class Response:
        """At most a million bytes from `offset` on, and the size of the file in bytes.

        `version` is another one once the file has changed: then read it from its beginning.
        """

        data: bytes
        size: int
        version: str = ""


@dataclass(frozen=True, slots=True)
class Color:
    """A colour; each part from 0 to 255."""

    r: int
    g: int
    b: int

    def __post_init__(self) -> None:
        check_byte("r", self.r)
        check_byte("g", self.g)
        check_byte("b", self.b)


@dataclass(frozen=True, slots=True)
class Clock:
    """The simulated time, on the topic clock.

    `rate` is how many simulated seconds go by in a real one while it is not paused.
    """

    __ros__: ClassVar[str] = "rosgraph_msgs/msg/Clock"

    stamp_ns: int
    rate: float = 1.0
    paused: bool = False

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        check_finite("rate", self.rate)


class SetClock:
    """Sets the simulated time, forward or back."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The new time."""

        stamp_ns: int

        def __post_init__(self) -> None:
            check_stamp("stamp_ns", self.stamp_ns)

    @dataclass(frozen=True, slots=True)
    class Response:
        """Done, and published on the topic clock."""


class SetRate:
    """Sets how fast a recording is played."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """Recorded seconds in a second, from 0.001 to 10,000."""

        rate: float

        def __post_init__(self) -> None:
            check_finite("rate", self.rate)

    @dataclass(frozen=True, slots=True)
    class Response:
        """Done."""


class Seek:
    """Goes to another moment of a recording that is played."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """`offset_s` seconds after `log_ns`, or after the beginning if that is 0."""

        offset_s: float = 0.0
        log_ns: int = 0

        def __post_init__(self) -> None:
            check_finite("offset_s", self.offset_s)
            check_stamp("log_ns", self.log_ns)

    @dataclass(frozen=True, slots=True)
    class Response:
        """The place at which it goes on: the log time in ns, and how many seconds after the
        beginning.
        """

        log_ns: int
        offset_s: float


class PlayNext:
    """Pauses a recording that is played, and plays its next messages."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """How many messages."""

        messages: int = 1

        def __post_init__(self) -> None:
            if self.messages < 1:
                raise ValueError(f"messages must be at least 1, not {self.messages}")

    @dataclass(frozen=True, slots=True)
    class Response:
        """They are played now."""


class PlayProgress:
    """How far a recording is played."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """No values."""

    @dataclass(frozen=True, slots=True)
    class Response:
        """It plays from `start_ns` to `end_ns` and is at `log_ns`, log times in ns.

        `sent` messages were played. `loops` is which round of a loop it is, from 1; 0 if it does
        not loop.
        """

        log_ns: int
        start_ns: int
        end_ns: int
        rate: float
        paused: bool
        sent: int
        loops: int


class SaveRecording:
    """Has a recorder end its file and go on in a new one, or write a snapshot."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """No values."""

    @dataclass(frozen=True, slots=True)
    class Response:
        """The file that is whole now, by its path on the recorder's host; how many seconds it is
        long, from the first message to the last, and its size in bytes.
        """

        file: str
        seconds: float
        size: int


class Field:
    """The look of the turtles' field, for programs that show it."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The version of the picture that the caller has, empty if it has none."""

        version: str = ""

    @dataclass(frozen=True, slots=True)
    class Response:
        """The background, the names of the turtles, and the ink that they have drawn.

        `ink` is a square of `size` by `size` pixels, 45 to the metre, rows from the top, each
        pixel red, green, blue and opacity, packed by zlib; empty if the caller has this
        version already.
        """

        version: str
        background: Color
        turtles: list[str]
        size: int
        ink: bytes


class Empty:
    """A service without values: clear, reset."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """No values."""

    @dataclass(frozen=True, slots=True)
    class Response:
        """Done."""


class Spawn:
    """Puts another turtle on the field."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The start, in m and rad; an empty name means the next free turtleN."""

        x: float
        y: float
        theta: float = 0.0
        name: str = ""

        def __post_init__(self) -> None:
            check_finite("x", self.x)
            check_finite("y", self.y)
            check_finite("theta", self.theta)

    @dataclass(frozen=True, slots=True)
    class Response:
        """The name of the new turtle."""

        name: str


class Kill:
    """Takes a turtle off the field."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The turtle to take."""

        name: str

    @dataclass(frozen=True, slots=True)
    class Response:
        """Done."""


class SetPen:
    """Changes the pen that a turtle draws its trail with."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """Colour parts and width (pixels) from 0 to 255; width 0 draws as 1.

        `off` lifts the pen, which then keeps its colour and width.
        """

        r: int = 179
        g: int = 184
        b: int = 255
        width: int = 3
        off: bool = False

        def __post_init__(self) -> None:
            check_byte("r", self.r)
            check_byte("g", self.g)
            check_byte("b", self.b)
            check_byte("width", self.width)

    @dataclass(frozen=True, slots=True)
    class Response:
        """Done."""


class TeleportAbsolute:
    """Moves a turtle to a place; the pen draws the way as a straight line."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The new pose, in m and rad."""

        x: float
        y: float
        theta: float = 0.0

        def __post_init__(self) -> None:
            check_finite("x", self.x)
            check_finite("y", self.y)
            check_finite("theta", self.theta)

    @dataclass(frozen=True, slots=True)
    class Response:
        """Accepted; it happens on the next tick."""


class TeleportRelative:
    """Turns a turtle, then moves it straight ahead; the pen draws the way."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """`angular` rad to turn, then `linear` m to move in the new direction."""

        linear: float
        angular: float

        def __post_init__(self) -> None:
            check_finite("linear", self.linear)
            check_finite("angular", self.angular)

    @dataclass(frozen=True, slots=True)
    class Response:
        """Accepted; it happens on the next tick."""


class RotateAbsolute:
    """An action: turn on the spot to a heading, by the shorter way, at 1 rad/s."""

    @dataclass(frozen=True, slots=True)
    class Goal:
        """The new heading, in rad."""

        theta: float

        def __post_init__(self) -> None:
            check_finite("theta", self.theta)

    @dataclass(frozen=True, slots=True)
    class Result:
        """Heading at the start minus heading at the end, in rad in [-pi, pi)."""

        delta: float

    @dataclass(frozen=True, slots=True)
    class Feedback:
        """The angle left to turn, in rad in [-pi, pi)."""

        remaining: float
