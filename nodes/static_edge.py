"""A static edge from its fields, and these of the form that ROS had before there were flags."""

import math
import shlex
from collections.abc import Mapping, Sequence
from itertools import takewhile

from tfbus import InvalidArgumentException, TfbusError, Transform, TransformStamped
from tfbus.command.types import frame_mistake

XYZ = ("x", "y", "z")
RPY = ("roll", "pitch", "yaw")
QUATERNION = ("qx", "qy", "qz", "qw")
NUMBERS = (*XYZ, *RPY, *QUATERNION)
FRAMES = ("frame_id", "child_frame_id")

_IDENTITY = {"qw": 1.0}


class EdgeMistake(TfbusError):
    """An edge that is not possible; `field` is the one at fault."""

    def __init__(self, field: str, reason: str) -> None:
        super().__init__(reason)
        self.field = field
        self.reason = reason


def make_edge(
    frames: Mapping[str, str], numbers: Mapping[str, float], *, degrees: bool = False
) -> TransformStamped:
    """The edge with these fields, with the stamp 0; missing numbers are the identity's.

    Lengths in metres; roll, pitch and yaw in radians, or in degrees if `degrees`. Raises
    EdgeMistake.
    """
    _check_frames(frames)
    for field, value in numbers.items():
        if not math.isfinite(value):
            raise EdgeMistake(field, f"must be finite, not {value}")
    return TransformStamped(
        0, frames["frame_id"], frames["child_frame_id"], _transform(numbers, degrees)
    )


def _check_frames(frames: Mapping[str, str]) -> None:
    for field in FRAMES:
        if field not in frames:
            raise EdgeMistake(field, "is missing: name the parent frame and the child frame")
        if mistake := frame_mistake(frames[field]):
            raise EdgeMistake(field, mistake)
    if frames["frame_id"] == frames["child_frame_id"]:
        raise EdgeMistake(
            "child_frame_id",
            f"{frames['frame_id']!r} is the parent's name too; give the child another",
        )


def _transform(numbers: Mapping[str, float], degrees: bool) -> Transform:
    turned = [field for field in RPY if field in numbers]
    quaternion = [field for field in QUATERNION if field in numbers]
    if turned and quaternion:
        raise EdgeMistake(
            quaternion[0],
            f"cannot be combined with {turned[0]}: give roll, pitch and yaw, or a quaternion",
        )
    xyz = [numbers.get(field, 0.0) for field in XYZ]
    if not quaternion:
        roll, pitch, yaw = (
            math.radians(value) if degrees else value
            for value in (numbers.get(field, 0.0) for field in RPY)
        )
        return Transform.from_rpy(roll, pitch, yaw, xyz=xyz)
    try:
        quat_xyzw = [numbers.get(field, _IDENTITY.get(field, 0.0)) for field in QUATERNION]
        return Transform(xyz, quat_xyzw)
    except InvalidArgumentException as error:
        raise EdgeMistake(quaternion[0], f"{error}{_remedy(quat_xyzw)}") from error


def _remedy(quat_xyzw: list[float]) -> str:
    norm = math.hypot(*quat_xyzw)
    if norm == 0.0:
        return ""
    unit = " ".join(
        f"{field} {value / norm:.9g}" for field, value in zip(QUATERNION, quat_xyzw, strict=True)
    )
    return f"; divided by its norm it is {unit}"


# The old form has yaw first.
_FIELDS_BY_COUNT = {6: (*XYZ, "yaw", "pitch", "roll"), 7: (*XYZ, "qx", "qy", "qz", "qw")}


def in_new_form(words: Sequence[str]) -> str:
    """`tfbus static` with the frames and numbers of `x y z yaw pitch roll FRAME CHILD` or of
    `x y z qx qy qz qw FRAME CHILD`, with or without ROS 1's period at the end; "" for others.
    """
    numbers = [*takewhile(_is_number, words)]
    frames, behind = words[len(numbers) :][:2], words[len(numbers) :][2:]
    fields = _FIELDS_BY_COUNT.get(len(numbers))
    if fields is None or len(frames) < 2 or len(behind) > 1 or not all(map(_is_number, behind)):
        return ""
    given = zip(fields, numbers, strict=True)
    flags = [word for name, text in given if float(text) for word in (f"--{name}", text)]
    return shlex.join(["tfbus", "static", *(frame.lstrip("/") for frame in frames), *flags])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
