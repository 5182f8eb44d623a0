"""Files of topics: how topics of other types than those of the table cross.

    my_robot/battery:
      {type: Battery, ros: sensor_msgs/msg/BatteryState, fields: {charge: percentage}}
    turtle1/pose: {direction: from-ros}
    debug/*: off

Every mistake names its line and key.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tfbus.bridge.topic_table import DIRECTIONS, TABLE, TopicLine
from tfbus.errors import DecodeError
from tfbus.ros.counterparts import BY_ROS_TYPE, LIVE_COUNTERPARTS, Counterpart, as_in_ros
from tfbus.ros.definition_text import message_of
from tfbus.ros.definitions import (
    STRING,
    Definition,
    completed,
    message_names,
    standard_definition,
)
from tfbus.ros.fitted import field_at, plain
from tfbus.ros.message_type import Message
from tfbus.ros.value_codec import UnfitError
from tfbus.runtime.yaml_file import Value, read_yaml_file
from tfbus.wording import did_you_mean, printable

_KEYS = ("type", "ros", "msg", "direction", "fields", "retained", "depth")
_TRUTH = {"true": True, "false": False}
_OFF = TopicLine(Counterpart("", STRING, dict, dict), direction="off")


def read_topic_file(path: Path) -> list[TopicLine]:
    """The lines of a file, in its order. Raises YamlFileError."""
    content = "lines such as `my_robot/battery: {type: Battery, ros: sensor_msgs/msg/BatteryState}`"
    document = read_yaml_file(path, content)
    return [_line(name, value, path) for name, value in document.entries().items()]


def _line(name: str, value: Value, path: Path) -> TopicLine:
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
    """The line for topics of this pattern; where it is one name, that is looked for in ROS."""
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
    """What the types are, and how one becomes the other."""
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
    """The name of a type as the bus has it: `Battery`, also where its module stands before it."""
    parts = text.split(".")
    while len(parts) > 1 and parts[0][:1].islower():
        del parts[0]
    return ".".join(parts)


def _full_name(text: str) -> str:
    package, _, leaf = text.rpartition("/")
    return text if "/" in package or not package else f"{package}/msg/{leaf}"


# Definitions


def _definition(
    ros_type: str, fields: Mapping[str, Value], path: Path
) -> tuple[Definition, Message]:
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


def _pairs(value: Value, message: Message) -> _Pairs:
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
    type_name: str, definition: Definition, message: Message, pairs: _Pairs | None
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
