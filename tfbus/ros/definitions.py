"""Definitions of ROS 2's messages: one table, the files of `interfaces/`, written like .msg files.

The message of a request is called `std_srvs/srv/Trigger_Request` there, that of a goal
`example_interfaces/action/Fibonacci_Goal`, as ROS does.
"""

import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path

from tfbus.ros.message_type import SEPARATOR as SEPARATOR
from tfbus.ros.message_type import Definition as Definition
from tfbus.ros.message_type import Definitions, MessageType, sections_in, text_of_ros

# Folders with packages of one's own, my_msgs/msg/Weight.msg in each, separated as in PATH.
FOLDERS_VARIABLE = "TFBUS_INTERFACES"

_TABLE = Path(__file__).parent / "interfaces"

# Names may come from a bus: at most as many packages and definitions are remembered.
_MOST_REMEMBERED = 1000

# The parts of a file, separated by ---, and the suffix of each part's message.
_PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}


class _Sections(Mapping[str, list[str]]):
    """The lines of every message that is known, by its full name, after the lines of one's `own`;
    packages are read when needed.
    """

    def __init__(self, own: Mapping[str, list[str]] | None = None) -> None:
        self._own = own or {}

    def __getitem__(self, name: str) -> list[str]:
        return self._own[name] if name in self._own else _package(name.partition("/")[0])[name]

    def __iter__(self) -> Iterator[str]:
        for package in packages():
            yield from _package(package)

    def __len__(self) -> int:
        return sum(1 for _ in self)


_definitions = Definitions(_Sections())


def message_named(name: str) -> MessageType:
    """The message of this full name. Raises DecodeError if it is not known, or not valid."""
    return _definitions.message(name)


@lru_cache(_MOST_REMEMBERED)
def standard_definition(name: str) -> Definition | None:
    """The definition of `sensor_msgs/msg/Imu`; None for a type that is not in the table.

    Raises DecodeError if one's own is not valid.
    """
    if name not in _package(name.partition("/")[0]):
        return None
    return Definition(name, text_of_ros(message_named(name)))


def completed(definition: Definition) -> Definition:
    """A definition as people write it, with the ones of the table that it needs in it.

    Raises DecodeError if it is not valid, or needs one that is not known.
    """
    own = sections_in(definition.text, definition.name)
    message = Definitions(_Sections(own)).message(definition.name)
    return Definition(definition.name, text_of_ros(message))


def message_names() -> list[str]:
    """The full names of all messages that are known, parts of services and actions too."""
    return [*_Sections()]


def packages() -> list[str]:
    """The packages that are known, by name."""
    own = {path.name for folder in _own_folders() for path in folder.iterdir() if _has_any(path)}
    return sorted(own | {path.stem for path in _TABLE.glob("*.msgs")})


def interfaces_of(package: str) -> dict[str, list[str]]:
    """The names of a package's interfaces by kind, msg, srv and action; {} for an unknown one."""
    found: dict[str, list[str]] = {}
    for name in _package(package):
        _, kind, leaf = name.split("/")
        last = _PARTS[kind][-1]
        if leaf.endswith(last):
            found.setdefault(kind, []).append(leaf.removesuffix(last))
    return found


@lru_cache(_MOST_REMEMBERED)
def _package(name: str) -> dict[str, list[str]]:
    """The lines of the messages of a package by full name; of one that is not known, none."""
    if not name.isidentifier():
        return {}
    file = _TABLE / f"{name}.msgs"
    found = sections_in(file.read_text("utf-8")) if file.is_file() else {}
    for folder in _own_folders():
        for kind in _PARTS:  # in folders below it too, as rosidl takes them
            for path in sorted((folder / name / kind).rglob(f"*.{kind}")):
                found |= _sections_of_file(name, path)
    return found


def _sections_of_file(package: str, path: Path) -> dict[str, list[str]]:
    """The messages of a file as people write them."""
    pieces: list[list[str]] = [[]]
    # A comment may be in any encoding.
    for line in path.read_text("utf-8", errors="replace").splitlines():
        if line.startswith("---"):
            pieces.append([])
        else:
            pieces[-1].append(line)
    kind = path.suffix[1:]
    names = [f"{package}/{kind}/{path.stem}{part}" for part in _PARTS[kind]]
    pieces += [[] for _ in names[len(pieces) :]]
    return dict(zip(names, pieces, strict=False))


def _own_folders() -> list[Path]:
    said = os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep)
    return [path for text in said if text and (path := Path(text)).is_dir()]


def _has_any(path: Path) -> bool:
    return any((path / kind).is_dir() for kind in _PARTS)


def known_definition(name: str) -> Definition:
    """The definition of a type that is in the table."""
    definition = standard_definition(name)
    assert definition is not None, name
    return definition


# Any value, in MessagePack: for values that a ROS message cannot express otherwise.
MSGPACK = Definition("tfbus_msgs/msg/Msgpack", "uint8[] data\n")

TF_MESSAGE = known_definition("tf2_msgs/msg/TFMessage")
JOINT_STATE = known_definition("sensor_msgs/msg/JointState")
TWIST = known_definition("geometry_msgs/msg/Twist")
POSE_STAMPED = known_definition("geometry_msgs/msg/PoseStamped")
ODOMETRY = known_definition("nav_msgs/msg/Odometry")
# Of turtlesim. It has no stamp.
TURTLE_POSE = known_definition("turtlesim/msg/Pose")
STRING = known_definition("std_msgs/msg/String")
CLOCK = known_definition("rosgraph_msgs/msg/Clock")
