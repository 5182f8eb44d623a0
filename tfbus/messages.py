"""Topics, services and actions of the supplied nodes; those of the turtles are turtlesim's.

Lengths are metres, angles radians (counter-clockwise, zero along x), times nanoseconds since the
Unix epoch. A value that is not finite or out of range raises ValueError; on the bus such a message
is dropped and counted.

A message that ROS has too has ROS's fields, by ROS's names; only its `header` is `stamp_ns` and
`frame_id`. `__ros__` names its type in ROS, and `__former__` the names that its fields had before;
a type with a `__msgtype__` is on the bus under that name of ROS's, in ROS's layout.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot, isfinite
from typing import ClassVar

# How far from 1 the length of a quaternion may be.
_UNIT_WITHIN = 1e-3

# Where a field with a former name is now, as a path; of a list, a path for each item.
Former = Mapping[str, str | tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Vector3:
    """Three components along x, y and z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def __post_init__(self) -> None:
        _check_finite("x", self.x)
        _check_finite("y", self.y)
        _check_finite("z", self.z)


@dataclass(frozen=True, slots=True)
class Quaternion:
    """A rotation, or no value where all are 0; the length is checked where it must be 1."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0

    def __post_init__(self) -> None:
        _check_finite("x", self.x)
        _check_finite("y", self.y)
        _check_finite("z", self.z)
        _check_finite("w", self.w)


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
        _check_finite("x", self.x)
        _check_finite("y", self.y)
        _check_finite("theta", self.theta)
        _check_finite("linear_velocity", self.linear_velocity)
        _check_finite("angular_velocity", self.angular_velocity)


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
        _check_stamp("stamp_ns", self.stamp_ns)
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
                _check_finite(f"the position of joint {name[:60]!r}", position)


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
        _check_stamp("stamp_ns", self.stamp_ns)


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
        _check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class PoseWithCovariance:
    """A pose, and how sure it is.

    The covariance has 6 by 6 numbers, row by row, in the order x, y, z and rotations about x, y, z;
    all are 0 if it is not known.
    """

    pose: Pose3D = field(default_factory=Pose3D)
    covariance: tuple[float, ...] = (0.0,) * 36

    def __post_init__(self) -> None:
        _check_count("covariance", self.covariance, 36)


@dataclass(frozen=True, slots=True)
class PoseWithCovarianceStamped:
    """A pose in the frame `frame_id` at stamp_ns, and how sure it is, as localisation gives it."""

    __msgtype__: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"

    stamp_ns: int
    frame_id: str
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)

    def __post_init__(self) -> None:
        _check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class TwistWithCovariance:
    """A velocity, and how sure it is, as in PoseWithCovariance."""

    twist: Twist = field(default_factory=Twist)
    covariance: tuple[float, ...] = (0.0,) * 36

    def __post_init__(self) -> None:
        _check_count("covariance", self.covariance, 36)


@dataclass(frozen=True, slots=True)
class Odometry:
    """The pose of a robot by its own reckoning at stamp_ns, and its velocity.

    `pose` is that of `child_frame_id` in `frame_id`; `twist` is its velocity, in `child_frame_id`,
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
        _check_stamp("stamp_ns", self.stamp_ns)


@dataclass(frozen=True, slots=True)
class Imu:
    """Measurements of an inertial sensor at stamp_ns, in the frame of the sensor, `frame_id`.

    `angular_velocity` is in rad/s, `linear_acceleration` in m/s², with that of gravity. Each
    covariance has 3 by 3 numbers about x, y and z, row by row: all are 0 where it is not known, and
    the first is -1 where the sensor does not measure the value, such as the `orientation`.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/Imu"

    stamp_ns: int
    frame_id: str
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: tuple[float, ...] = (0.0,) * 9
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: tuple[float, ...] = (0.0,) * 9
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: tuple[float, ...] = (0.0,) * 9

    def __post_init__(self) -> None:
        _check_stamp("stamp_ns", self.stamp_ns)
        for value in ("orientation", "angular_velocity", "linear_acceleration"):
            _check_count(f"{value}_covariance", getattr(self, f"{value}_covariance"), 9)


@dataclass(frozen=True, slots=True)
class Color:
    """A colour; each part from 0 to 255."""

    r: int
    g: int
    b: int

    def __post_init__(self) -> None:
        _check_byte("r", self.r)
        _check_byte("g", self.g)
        _check_byte("b", self.b)


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
        _check_stamp("stamp_ns", self.stamp_ns)
        _check_finite("rate", self.rate)


class SetClock:
    """Sets the simulated time, forward or back."""

    @dataclass(frozen=True, slots=True)
    class Request:
        """The new time."""

        stamp_ns: int

        def __post_init__(self) -> None:
            _check_stamp("stamp_ns", self.stamp_ns)

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
            _check_finite("rate", self.rate)

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
            _check_finite("offset_s", self.offset_s)
            _check_stamp("log_ns", self.log_ns)

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
            _check_finite("x", self.x)
            _check_finite("y", self.y)
            _check_finite("theta", self.theta)

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
            _check_byte("r", self.r)
            _check_byte("g", self.g)
            _check_byte("b", self.b)
            _check_byte("width", self.width)

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
            _check_finite("x", self.x)
            _check_finite("y", self.y)
            _check_finite("theta", self.theta)

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
            _check_finite("linear", self.linear)
            _check_finite("angular", self.angular)

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
            _check_finite("theta", self.theta)

    @dataclass(frozen=True, slots=True)
    class Result:
        """Heading at the start minus heading at the end, in rad in [-pi, pi)."""

        delta: float

    @dataclass(frozen=True, slots=True)
    class Feedback:
        """The angle left to turn, in rad in [-pi, pi)."""

        remaining: float


def _check_finite(name: str, value: float) -> None:
    if not isfinite(value):
        raise ValueError(f"{name} must be finite, not {value}")


def _check_count(name: str, numbers: tuple[float, ...], count: int) -> None:
    if len(numbers) != count:
        raise ValueError(f"{name} must be {count} numbers, not {len(numbers)}")


def _check_stamp(name: str, value: int) -> None:
    if not 0 <= value < 2**63:
        raise ValueError(f"{name} must be nanoseconds from 0 to 2^63 - 1, not {value}")


def _check_byte(name: str, value: int) -> None:
    if not 0 <= value <= 255:
        raise ValueError(f"{name} must be from 0 to 255, not {value}")
