"""Our messages that ROS has with other fields, such as joint states and descriptions of robots."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tfbus.errors import DecodeError
from tfbus.ros.definitions import (
    CLOCK,
    JOINT_STATE,
    ODOMETRY,
    POSE_STAMPED,
    STRING,
    TURTLE_POSE,
    TWIST,
    Definition,
)
from tfbus.ros.value_codec import UnfitError

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Counterpart:
    """A type of ours, by its name, and that of ROS with the same content.

    `to_ros` makes the values of a message of ROS of ours, and raises UnfitError where they would
    not come back by `of_ros`, which raises DecodeError for a message with other fields.
    """

    type_name: str
    definition: Definition
    to_ros: Callable[[Mapping[str, Any]], dict[str, Any]]
    of_ros: Callable[[dict[str, Any]], dict[str, Any]]


def counterpart_of_ros(ros_type: str, said: str, topic: str) -> Counterpart | None:
    """Our counterpart of a topic of this type in ROS; `said` is the name of the type that the file
    says as well.
    """
    if ros_type in _STAMPED:
        return _STAMPED[ros_type]
    is_description = said == "RobotDescription" or topic.rpartition("/")[2] == "robot_description"
    return COUNTERPARTS["RobotDescription"] if ros_type == STRING.name and is_description else None


# With a stamp, in a header

_OF_JOINT_STATE = {
    "names": "name",
    "positions": "position",
    "velocities": "velocity",
    "efforts": "effort",
}


def _joint_state_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    _check_fields(values, "stamp_ns", *_OF_JOINT_STATE)
    return {
        "header": _header(values["stamp_ns"], ""),
        **{theirs: values[ours] for ours, theirs in _OF_JOINT_STATE.items()},
    }


def _joint_state_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "stamp_ns": _stamp_ns(values),
        **{ours: values[theirs] for ours, theirs in _OF_JOINT_STATE.items()},
    }


def _pose_stamped_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    _check_fields(values, "stamp_ns", "frame", "position", "quat_xyzw")
    return {"header": _header(values["stamp_ns"], values["frame"]), "pose": _pose(values)}


def _pose_stamped_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "stamp_ns": _stamp_ns(values),
        "frame": values["header"]["frame_id"],
        **_pose_of_ros(values["pose"]),
    }


def _odometry_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    _check_fields(values, "stamp_ns", "frame", "child_frame", "position", "quat_xyzw", *_MOTION)
    return {
        "header": _header(values["stamp_ns"], values["frame"]),
        "child_frame_id": values["child_frame"],
        "pose": {"pose": _pose(values), "covariance": values["pose_covariance"]},
        "twist": {"twist": values["twist"], "covariance": values["twist_covariance"]},
    }


_MOTION = ("twist", "pose_covariance", "twist_covariance")


def _odometry_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    return {
        "stamp_ns": _stamp_ns(values),
        "frame": values["header"]["frame_id"],
        "child_frame": values["child_frame_id"],
        **_pose_of_ros(values["pose"]["pose"]),
        "twist": values["twist"]["twist"],
        "pose_covariance": values["pose"]["covariance"],
        "twist_covariance": values["twist"]["covariance"],
    }


def _check_fields(values: Mapping[str, Any], *names: str) -> None:
    if values.keys() != {*names}:
        raise UnfitError(f"its fields must be {', '.join(names)}")


def _header(stamp_ns: Any, frame: Any) -> dict[str, Any]:
    if type(stamp_ns) is not int:
        raise UnfitError("stamp_ns must be an integer")
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _stamp_ns(values: Mapping[str, Any]) -> int:
    stamp = values["header"]["stamp"]
    stamp_ns: int = stamp["sec"] * _SECOND_NS + stamp["nanosec"]
    return stamp_ns


def _pose(values: Mapping[str, Any]) -> dict[str, Any]:
    quaternion = values["quat_xyzw"]
    if not isinstance(quaternion, list | tuple) or len(quaternion) != 4:
        raise UnfitError("quat_xyzw must be four numbers")
    return {
        "position": values["position"],
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }


def _pose_of_ros(pose: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "position": pose["position"],
        "quat_xyzw": [pose["orientation"][axis] for axis in "xyzw"],
    }


# Without one: a message of ROS gets that of its arrival. A stamp of ours is left out.


def _turtle_pose_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    _check_fields(values, "stamp_ns", *_OF_TURTLE_POSE)
    return {name: values[name] for name in _OF_TURTLE_POSE}


def _turtle_pose_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    return {"stamp_ns": 0, **{name: values[name] for name in _OF_TURTLE_POSE}}


_OF_TURTLE_POSE = ("x", "y", "theta", "linear_velocity", "angular_velocity")


def _twist_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    _check_fields(values, "linear", "angular")
    return dict(values)


def _twist_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    return {"linear": values["linear"], "angular": values["angular"]}


# The simulated time: its rate, and whether it is paused, stay here.


def _clock_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    if not isinstance(values.get("stamp_ns"), int):
        raise UnfitError("stamp_ns must be an integer")
    seconds, nanoseconds = divmod(values["stamp_ns"], _SECOND_NS)
    return {"clock": {"sec": seconds, "nanosec": nanoseconds}}


def _clock_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    time = values["clock"]
    return {"stamp_ns": time["sec"] * _SECOND_NS + time["nanosec"]}


# Descriptions: the prefix and source stand behind the description, in a comment of XML.

_BEFORE, _AFTER = "\n<!-- tfbus: ", " -->"


def _description_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    if values.keys() != {"urdf", "prefix", "source"}:
        raise UnfitError
    urdf, *others = values["urdf"], values["prefix"], values["source"]
    if any(type(text) is not str for text in (urdf, *others)):
        raise UnfitError
    # Hyphens are escaped: two of them would end the comment.
    about = json.dumps(others).replace("-", "\\u002d")
    data = f"{urdf}{_BEFORE}{about}{_AFTER}" if any(others) or _BEFORE in urdf else urdf
    return {"data": data}


def _description_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    data = values.get("data")
    if not isinstance(data, str):
        raise DecodeError(f"a {STRING.name} has other fields than ROS's own")
    urdf, found, about = data.rpartition(_BEFORE)
    if found and about.endswith(_AFTER):
        try:
            others = json.loads(about.removesuffix(_AFTER))
        except (ValueError, RecursionError):
            others = None
        if isinstance(others, list) and [type(each) for each in others] == [str, str]:
            return {"urdf": urdf, "prefix": others[0], "source": others[1]}
    return {"urdf": data, "prefix": "", "source": ""}


def _refusing(
    definition: Definition, of_ros: Callable[[dict[str, Any]], dict[str, Any]]
) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """The same, which raises DecodeError for a message with other fields."""

    def refuse(values: dict[str, Any]) -> dict[str, Any]:
        try:
            return of_ros(values)
        except (KeyError, TypeError) as error:
            raise DecodeError(f"a {definition.name} has other fields than ROS's own") from error

    return refuse


def _counterparts(*rows: tuple[str, Definition, Any, Any]) -> dict[str, Counterpart]:
    return {
        name: Counterpart(name, definition, to_ros, _refusing(definition, of_ros))
        for name, definition, to_ros, of_ros in rows
    }


# Those that are the same in ROS, bit by bit: a recording has them so.
COUNTERPARTS: Mapping[str, Counterpart] = _counterparts(
    ("JointState", JOINT_STATE, _joint_state_to_ros, _joint_state_of_ros),
    ("RobotDescription", STRING, _description_to_ros, _description_of_ros),
    ("PoseStamped", POSE_STAMPED, _pose_stamped_to_ros, _pose_stamped_of_ros),
    ("Odometry", ODOMETRY, _odometry_to_ros, _odometry_of_ros),
)

# And those by which a bridge passes messages on. In a recording each keeps its own type: a
# turtlesim/msg/Pose has no stamp, and its numbers are less exact.
LIVE_COUNTERPARTS: Mapping[str, Counterpart] = {
    **COUNTERPARTS,
    **_counterparts(
        ("Pose", TURTLE_POSE, _turtle_pose_to_ros, _turtle_pose_of_ros),
        ("Twist", TWIST, _twist_to_ros, _twist_of_ros),
        ("Clock", CLOCK, _clock_to_ros, _clock_of_ros),
    ),
}

_STAMPED = {
    each.definition.name: each for name, each in COUNTERPARTS.items() if each.definition != STRING
}

# The same by the names of the types in ROS: those of which each topic has one meaning.
BY_ROS_TYPE: Mapping[str, Counterpart] = {
    each.definition.name: each
    for each in LIVE_COUNTERPARTS.values()
    if each.definition.name != STRING.name
}
