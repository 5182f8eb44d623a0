"""Our messages that ROS has with other fields: joint states, and descriptions of robots."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tfbus.errors import DecodeError
from tfbus.ros.definitions import JOINT_STATE, STRING, Definition
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
    if ros_type == JOINT_STATE.name:
        return COUNTERPARTS["JointState"]
    is_description = said == "RobotDescription" or topic.rpartition("/")[2] == "robot_description"
    return COUNTERPARTS["RobotDescription"] if ros_type == STRING.name and is_description else None


# Joint states

_OF_JOINT_STATE = {
    "names": "name",
    "positions": "position",
    "velocities": "velocity",
    "efforts": "effort",
}


def _joint_state_to_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    stamp_ns = values.get("stamp_ns")
    if type(stamp_ns) is not int or values.keys() != {"stamp_ns", *_OF_JOINT_STATE}:
        raise UnfitError
    seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    return {
        "header": {"stamp": stamp, "frame_id": ""},
        **{theirs: values[ours] for ours, theirs in _OF_JOINT_STATE.items()},
    }


def _joint_state_of_ros(values: dict[str, Any]) -> dict[str, Any]:
    try:
        stamp = values["header"]["stamp"]
        return {
            "stamp_ns": stamp["sec"] * _SECOND_NS + stamp["nanosec"],
            **{ours: values[theirs] for ours, theirs in _OF_JOINT_STATE.items()},
        }
    except (KeyError, TypeError) as error:
        raise DecodeError(f"a {JOINT_STATE.name} has other fields than ROS's own") from error


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


COUNTERPARTS: Mapping[str, Counterpart] = {
    each.type_name: each
    for each in (
        Counterpart(
            "JointState",
            JOINT_STATE,
            _joint_state_to_ros,
            _joint_state_of_ros,
        ),
        Counterpart(
            "RobotDescription",
            STRING,
            _description_to_ros,
            _description_of_ros,
        ),
    )
}
