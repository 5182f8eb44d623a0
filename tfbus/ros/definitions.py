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
