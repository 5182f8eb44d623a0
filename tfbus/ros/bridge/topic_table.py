"""Topics that cross between the bus and ROS, and as which types: the table, and files of users.

    my_robot/battery:
      {type: Battery, ros: sensor_msgs/msg/BatteryState, fields: {charge: percentage}}
    turtle1/pose: {direction: from-ros}
    debug/*: off

Every mistake in a file names its line and key.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from tfbus.base.errors import DecodeError, SettingsError, TfbusError
from tfbus.base.wording import did_you_mean, mistake_in, printable
from tfbus.base.yaml_file import Value, read_yaml_file
from tfbus.ros.counterparts import (
    AS_IN_ROS,
    BY_ROS_TYPE,
    LIVE_COUNTERPARTS,
    OURS_IN_ROS,
    Counterpart,
    as_in_ros,
    field_at,
    plain,
)
from tfbus.ros.definitions import (
    STRING,
    Definition,
    completed,
    message_names,
    standard_definition,
)
from tfbus.ros.message_type import MessageType, message_of
from tfbus.ros.value_codec import UnfitError

Direction = Literal["both", "to-ros", "from-ros", "off"]
DIRECTIONS: tuple[Direction, ...] = ("both", "to-ros", "from-ros", "off")


@dataclass(frozen=True)
class TopicLine:
    """How topics of one of our types cross.

    Topics of the bus are found by their type, and by the `pattern` of their names, `*` for any
    text. In ROS `names` are looked for, and names that the bus subscribes to. A `retained` topic
    is transient local in ROS. `stamps` says that ROS's type has no stamp: it gets the time of its
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
        ours = getattr(OURS_IN_ROS.get(self.type_name), "__name__", self.type_name)
        return self.type_name, self.ros_type, self.type_name.rpartition("/")[2], ours

    @property
    def has_fields_of_ros(self) -> bool:
        """Whether its fields are ROS's, not a user's own."""
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
            own = read_topic_file(path)
        table = TopicTable(own)
        return TopicTable(own, dict([table._asked(text) for text in extra_topics]))

    def line_of(self, name: str, type_name: str) -> TopicLine | None:
        """The line for a topic of the bus; None if it does not cross.

        Raises TfbusError if its name stands in a line of the user, with another type.
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
            raise SettingsError(
                f"--topic: {text!r} is no topic: {mistake if name else 'it is empty'}"
            )
        lines = (*self._own, *TABLE)
        if type_name:
            for line in lines:
                if type_name in line.said_names:
                    return name, replace(line, names=())
            known = list(dict.fromkeys(line.type_name for line in lines))
            raise SettingsError(
                f"--topic: {type_name!r} is no type that crosses{did_you_mean(type_name, known)}; "
                "--topics FILE adds others"
            )
        for line in lines:
            leaves = [each.rpartition("/")[2] for each in line.names]
            if name.rpartition("/")[2] in leaves or (line in self._own and line.pattern == name):
                return name, line
        known = list(dict.fromkeys(line.type_name for line in lines))
        raise SettingsError(
            f"--topic: the type of {name!r} is not known: give it as {name}=TYPE, one of "
            f"{', '.join(known)}"
        )


# Files

_KEYS = ("type", "ros", "msg", "direction", "fields", "retained", "depth")
_TRUTH = {"true": True, "false": False}
_OFF = TopicLine(Counterpart("", STRING, dict, dict), direction="off")


def read_topic_file(path: Path) -> list[TopicLine]:
    """The lines of a file, in its order. Raises YamlFileError."""
    content = "lines such as `my_robot/battery: {type: Battery, ros: sensor_msgs/msg/BatteryState}`"
    document = read_yaml_file(path, content)
    return [_line_of_file(name, value, path) for name, value in document.entries().items()]


def _line_of_file(name: str, value: Value, path: Path) -> TopicLine:
    pattern = name.strip("/")
    if not value.is_mapping:
        if value.text() != "off":
            raise value.place.mistake("must be a map with `type` and `ros`, or off")
        return _with_names(_OFF, pattern)
    fields = value.fields(_KEYS)
    direction = fields["direction"].text() if "direction" in fields else "both"
    if direction not in DIRECTIONS:
        raise fields["direction"].place.mistake(
            f"must be one of {', '.join(DIRECTIONS)}, not {direction!r}"
        )
    counterpart = _counterpart(pattern, value, fields, path)
    usual = next(
        (each for each in TABLE if each.counterpart == counterpart), TopicLine(counterpart)
    )
    retained = _truth(fields["retained"]) if "retained" in fields else usual.retained
    return _with_names(
        TopicLine(
            counterpart,
            direction=direction,
            retained=retained,
            depth=_depth(fields["depth"]) if "depth" in fields else 1 if retained else 10,
            stamps=usual.stamps,
        ),
        pattern,
    )


def _with_names(line: TopicLine, pattern: str) -> TopicLine:
    """The line for topics of this pattern; if it is one name, that is looked for in ROS."""
    names = () if set("*?[") & set(pattern) or line.direction == "off" else (pattern,)
    return TopicLine(
        line.counterpart,
        names,
        pattern,
        line.direction,
        line.retained,
        line.depth,
        line.stamps,
    )


def _counterpart(
    pattern: str, value: Value, fields: Mapping[str, Value], path: Path
) -> Counterpart:
    """The two types of a line, and the way from each to the other."""
    type_name = _type_name(fields["type"].text()) if "type" in fields else ""
    if "ros" not in fields:
        leaf = pattern.rpartition("/")[2]
        usual = LIVE_COUNTERPARTS.get(type_name) if type_name else _usual(leaf)
        if usual is None or "fields" in fields:
            place = fields["type"].place if type_name else value.place
            raise place.mistake(
                "needs `ros`, the type in ROS, such as sensor_msgs/msg/BatteryState"
            )
        return usual
    ros_type = _full_name(fields["ros"].text())
    if type_name in LIVE_COUNTERPARTS and "fields" not in fields:
        usual = LIVE_COUNTERPARTS[type_name]
        if usual.definition.name != ros_type:
            raise fields["ros"].place.mistake(
                f"{type_name} is {usual.definition.name} in ROS; for another type write `fields`"
            )
        return usual
    if not type_name and "fields" not in fields and ros_type in BY_ROS_TYPE:
        return BY_ROS_TYPE[ros_type]
    definition, message = _definition(ros_type, fields, path)
    if "fields" not in fields and type_name in ("", ros_type):
        return as_in_ros(definition)
    pairs = _pairs(fields["fields"], message) if "fields" in fields else None
    return mapped(type_name or ros_type.rpartition("/")[2], definition, message, pairs)


def _usual(leaf: str) -> Counterpart | None:
    for line in TABLE:
        if leaf in [name.rpartition("/")[2] for name in line.names]:
            return line.counterpart
    return None


def _type_name(text: str) -> str:
    """The name of a type as the bus has it: `Battery`, also if its module stands before it."""
    parts = text.split(".")
    while len(parts) > 1 and parts[0][:1].islower():
        del parts[0]
    return ".".join(parts)


def _full_name(text: str) -> str:
    package, _, leaf = text.rpartition("/")
    return text if "/" in package or not package else f"{package}/msg/{leaf}"


def _definition(
    ros_type: str, fields: Mapping[str, Value], path: Path
) -> tuple[Definition, MessageType]:
    place = fields["ros"].place
    if "msg" in fields:
        place = fields["msg"].place
        file = path.parent / fields["msg"].text()
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
            raise place.mistake(f"{file} cannot be read: {reason}") from error
        try:
            definition = completed(Definition(ros_type, text))
        except DecodeError as error:
            raise place.mistake(f"is no definition of a message: {error}") from error
    elif (known := standard_definition(ros_type)) is not None:
        definition = known
    else:
        raise place.mistake(_why_unknown(ros_type))
    try:
        return definition, message_of(definition)
    except DecodeError as error:
        raise place.mistake(str(error)) from error


def _why_unknown(ros_type: str) -> str:
    """Why the definition of a type is not known."""
    near = did_you_mean(ros_type, message_names())
    return (
        f"{printable(ros_type, 100)} is no standard type of ROS 2{near}; give the definition of "
        "another by `msg: FILE`"
    )


# Fields

_Pairs = list[tuple[list[str], list[str]]]


def _pairs(value: Value, message: MessageType) -> _Pairs:
    """Paths of fields, ours and theirs."""
    pairs: _Pairs = []
    for ours, theirs in value.entries().items():
        path = theirs.text()
        if field_at(message, path) is None:
            names = [field.key for field in message.fields]
            raise theirs.place.mistake(
                f"{message.name} has no field {path!r}{did_you_mean(path, names)}"
            )
        pair = ours.split("."), path.split(".")
        for other in pairs:
            for own, its in zip(pair, other, strict=True):
                shorter, longer = sorted((own, its), key=len)
                if longer[: len(shorter)] == shorter:
                    raise theirs.place.mistake(
                        f"{'.'.join(longer)!r} overlaps with {'.'.join(shorter)!r}: give each "
                        "field once, and none that is within another"
                    )
        pairs.append(pair)
    if not pairs:
        raise value.place.mistake("has no fields; write some, or omit the key")
    return pairs


def mapped(
    type_name: str, definition: Definition, message: MessageType, pairs: _Pairs | None
) -> Counterpart:
    """Types whose fields have the same names, or of which these pairs of paths cross."""

    def to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
        return dict(values) if pairs is None else _moved(values, pairs)

    def of_ros(values: dict[str, Any]) -> dict[str, Any]:
        values = plain(values, message)
        return values if pairs is None else _moved(values, [(its, own) for own, its in pairs])

    return Counterpart(type_name, definition, to_ros, of_ros)


def _moved(values: Mapping[str, Any], pairs: _Pairs) -> dict[str, Any]:
    moved: dict[str, Any] = {}
    for source, target in pairs:
        value: Any = values
        for name in source:
            if not isinstance(value, Mapping) or name not in value:
                raise UnfitError(f"it has no field '{'.'.join(source)}'")
            value = value[name]
        within = moved
        for name in target[:-1]:
            within = within.setdefault(name, {})
        within[target[-1]] = value
    return moved


# Values


def _truth(value: Value) -> bool:
    if value.text() not in _TRUTH:
        raise value.place.mistake(f"must be true or false, not {value.text()!r}")
    return _TRUTH[value.text()]


def _depth(value: Value) -> int:
    text = value.text()
    if not text.isdecimal() or not 1 <= int(text) <= 10_000:
        raise value.place.mistake(f"must be a number from 1 to 10,000, not {text!r}")
    return int(text)
