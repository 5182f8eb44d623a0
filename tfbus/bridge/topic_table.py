"""Which topics cross between the bus and ROS, and as what: the one table, and lines of users."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

from tfbus.errors import TfbusError
from tfbus.names import mistake_in
from tfbus.ros.counterparts import AS_IN_ROS, LIVE_COUNTERPARTS, Counterpart
from tfbus.wording import did_you_mean

Direction = Literal["both", "to-ros", "from-ros", "off"]
DIRECTIONS: tuple[Direction, ...] = ("both", "to-ros", "from-ros", "off")


@dataclass(frozen=True)
class TopicLine:
    """How topics of one of our types cross.

    Topics of the bus are found by their type, and by the `pattern` of their names, `*` for any
    text. In ROS `names` are looked for, beside those that the bus subscribes to. A `retained` one
    is transient local in ROS. `stamps` says that ROS's type has no stamp: it gets that of its
    arrival.
    """

    counterpart: Counterpart
    names: tuple[str, ...] = ()
    pattern: str = "*"
    direction: Direction = "both"
    retained: bool = False
    depth: int = 10
    stamps: bool = False

    @property
    def type_name(self) -> str:
        """The name of our type."""
        return self.counterpart.type_name

    @property
    def ros_type(self) -> str:
        """The name of the type in ROS."""
        return self.counterpart.definition.name

    @property
    def said_names(self) -> tuple[str, ...]:
        """The names that a user may give the type by; `Imu` is sensor_msgs/msg/Imu."""
        return self.type_name, self.ros_type, self.type_name.rpartition("/")[2]

    @property
    def has_fields_of_ros(self) -> bool:
        """Whether its fields are those of ROS, not those of a user's type."""
        usual = LIVE_COUNTERPARTS.get(self.type_name)
        return self.type_name == self.ros_type or self.counterpart is usual

    @property
    def goes_to_ros(self) -> bool:
        return self.direction in ("both", "to-ros")

    @property
    def comes_from_ros(self) -> bool:
        return self.direction in ("both", "from-ros")


def _line(
    type_name: str,
    *names: str,
    retained: bool = False,
    depth: int = 10,
    stamps: bool = False,
) -> TopicLine:
    counterpart = LIVE_COUNTERPARTS[type_name]
    return TopicLine(counterpart, names, retained=retained, depth=depth, stamps=stamps)


# Our type, and names that topics of that type usually have in ROS.
TABLE: tuple[TopicLine, ...] = (
    _line("Twist", "cmd_vel", "turtle1/cmd_vel"),
    _line("Pose", "turtle1/pose", stamps=True),
    _line("JointState", "joint_states"),
    _line("RobotDescription", "robot_description", retained=True, depth=1),
    _line("PoseStamped", "goal_pose", "move_base_simple/goal"),
    _line("Odometry", "odom"),
    *map(TopicLine, AS_IN_ROS.values()),
)


class TopicTable:
    """The table with the lines of a user before it: the first that fits counts."""

    def __init__(self, own: Sequence[TopicLine] = (), asked: Mapping[str, TopicLine] | None = None):
        self._own = tuple(own)
        # Topics to look for in ROS, by their names on the bus.
        self.names: dict[str, TopicLine] = {}
        for name, line in (asked or {}).items():
            self.names[name] = line
        for line in (*self._own, *TABLE):
            for name in line.names:
                self.names.setdefault(name, self._ruling(name, line))

    @staticmethod
    def of_file(path: Path | None, extra_topics: Sequence[str] = ()) -> "TopicTable":
        """The table with the lines of a YAML file, and topics that were asked for: "arm/cmd_vel",
        or with a type as "arm/goal=PoseStamped".

        Raises YamlFileError for a mistake in the file, TfbusError for a topic whose type is not
        clear.
        """
        own: Sequence[TopicLine] = ()
        if path is not None:
            from tfbus.bridge.topic_file import read_topic_file

            own = read_topic_file(path)
        table = TopicTable(own)
        return TopicTable(own, dict([table._asked(text) for text in extra_topics]))

    def line_of(self, name: str, type_name: str) -> TopicLine | None:
        """The line for a topic of the bus; None where it does not cross.

        Raises TfbusError where its name stands in a line of the user, with another type.
        """
        for line in self._own:
            if fnmatchcase(name, line.pattern):
                if line.direction != "off" and type_name not in ("", line.type_name):
                    raise TfbusError(
                        f"it carries {type_name}, and its line in the file of topics says "
                        f"{line.type_name}: give the line `type: {type_name}`, or correct the topic"
                    )
                return line
        if (asked := self.names.get(name)) is not None and type_name in ("", asked.type_name):
            return asked
        return next((line for line in TABLE if line.type_name == type_name), None)

    def _ruling(self, name: str, line: TopicLine) -> TopicLine:
        return next((own for own in self._own if fnmatchcase(name, own.pattern)), line)

    def _asked(self, text: str) -> tuple[str, TopicLine]:
        """A topic as the command line has it."""
        name, _, type_name = text.partition("=")
        name = name.strip("/")
        if not name or (mistake := mistake_in(name)):
            raise TfbusError(f"--topic: {text!r} is no topic: {mistake if name else 'it is empty'}")
        lines = (*self._own, *TABLE)
        if type_name:
            for line in lines:
                if type_name in line.said_names:
                    return name, replace(line, names=())
            known = list(dict.fromkeys(line.type_name for line in lines))
            raise TfbusError(
                f"--topic: {type_name!r} is no type that crosses{did_you_mean(type_name, known)}; "
                "--topics FILE adds others"
            )
        for line in lines:
            leaves = [each.rpartition("/")[2] for each in line.names]
            if name.rpartition("/")[2] in leaves or (line in self._own and line.pattern == name):
                return name, line
        known = list(dict.fromkeys(line.type_name for line in lines))
        raise TfbusError(
            f"--topic: the type of {name!r} is not known: give it as {name}=TYPE, one of "
            f"{', '.join(known)}"
        )
