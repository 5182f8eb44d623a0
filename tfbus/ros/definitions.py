"""Definitions of messages as ROS 2 writes them in .msg files, and MCAP as `ros2msg`."""

from dataclasses import dataclass

# Between a definition and those of the messages in it.
SEPARATOR = "=" * 80


@dataclass(frozen=True)
class Definition:
    """The name of a message type, `tf2_msgs/msg/TFMessage`, and its text with all in it."""

    name: str
    text: str


TF_MESSAGE = Definition(
    "tf2_msgs/msg/TFMessage",
    f"""\
geometry_msgs/TransformStamped[] transforms
{SEPARATOR}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{SEPARATOR}
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
{SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
""",
)

# Any value, in MessagePack: what a ROS message cannot express otherwise.
MSGPACK = Definition("tfbus_msgs/msg/Msgpack", "uint8[] data\n")

JOINT_STATE = Definition(
    "sensor_msgs/msg/JointState",
    f"""\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""",
)

_HEADER = f"""\
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

_POSE = f"""\
{SEPARATOR}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""

_VECTOR3 = f"""\
{SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""

TWIST = Definition(
    "geometry_msgs/msg/Twist",
    f"geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{_VECTOR3}",
)

POSE_STAMPED = Definition(
    "geometry_msgs/msg/PoseStamped",
    f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{_HEADER}{_POSE}",
)

ODOMETRY = Definition(
    "nav_msgs/msg/Odometry",
    f"""\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
{_HEADER}{SEPARATOR}
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
{_POSE}{SEPARATOR}
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
{SEPARATOR}
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{_VECTOR3}""",
)

# Of turtlesim. It has no stamp.
TURTLE_POSE = Definition(
    "turtlesim/msg/Pose",
    """\
float32 x
float32 y
float32 theta
float32 linear_velocity
float32 angular_velocity
""",
)

STRING = Definition("std_msgs/msg/String", "string data\n")

CLOCK = Definition(
    "rosgraph_msgs/msg/Clock",
    f"""\
builtin_interfaces/Time clock
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""",
)
