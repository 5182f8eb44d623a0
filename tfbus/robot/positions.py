"""Positions of joints as their callers give them, checked and put in the order of the joints."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

from tfbus.core.kernel import IDENTITY
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.transform import Transform, as_floats
from tfbus.geometry.transform_array import TransformArray
from tfbus.robot.model import Joint
from tfbus.wording import counted, did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
else:
    from tfbus.core import lazy_numpy as np

# A number; of a planar joint x, y and angle; of a floating one a Transform or its seven numbers.
Position = float | Sequence[float] | Transform


class Positions:
    """Which joints of a robot move, and where they are.

    Each joint that moves has a place in a list of positions: the free ones in order, then the
    mimics, each after its source. `mimics` are their places and names, and those of the sources.
    """

    def __init__(self, joints: Mapping[str, Joint], free: Sequence[Joint]) -> None:
        self._joints = joints
        self._free = free
        movable = [*free, *_mimics(joints)]
        self.places = {joint.name: place for place, joint in enumerate(movable)}
        self.mimics = [
            (place, joint.name, self.places[joint.mimic.joint], joint.mimic)
            for place, joint in enumerate(movable)
            if joint.mimic is not None
        ]
        self.zeros = [_zero(joint) for joint in free] + [0.0] * len(self.mimics)
        self._are_numbers = all(joint.position_size == 1 for joint in free)

    def of_one(self, given: Mapping[str, Position] | ArrayLike | None) -> list[Any]:
        """A position for each joint that moves, by place."""
        if given is None:
            given = {}
        if not isinstance(given, Mapping):
            return self._follow(self._of_array(given), ())
        positions = self.zeros.copy()
        places = self.places
        for name, value in given.items():
            place = places.get(name)
            if place is None:
                raise self._unknown(name)
            # Most are plain numbers, and finite.
            if type(value) is not float or not isfinite(value) or not self._are_numbers:
                value = _checked(self._joints[name], value)
            positions[place] = value
        return self._follow(positions, given)

    def _follow(self, positions: list[Any], given: Container[str]) -> list[Any]:
        """The positions, with those of the mimics that are not given."""
        for place, name, source, mimic in self.mimics:
            if name not in given:
                position = mimic.multiplier * positions[source] + mimic.offset
                if not (isfinite if type(position) is float else _all_finite)(position):
                    raise InvalidArgumentException(
                        f"joint {name!r} mimics {mimic.joint!r} to a position that is not finite"
                    )
                positions[place] = position
        return positions

    def _of_array(self, given: Any) -> list[Any]:
        numbers = as_floats(given, "positions")
        size = sum(joint.position_size for joint in self._free)
        if numbers.shape != (size,):
            raise InvalidArgumentException(
                f"positions: expected shape ({size},), got {numbers.shape}"
            )
        if not np.isfinite(numbers).all():
            raise InvalidArgumentException("positions must be finite")
        row = numbers.tolist()
        if self._are_numbers:
            return [*row, *([0.0] * len(self.mimics))]
        positions: list[Any] = []
        for joint in self._free:
            part, row = row[: joint.position_size], row[joint.position_size :]
            positions.append(part[0] if len(part) == 1 else _checked(joint, part))
        return [*positions, *([0.0] * len(self.mimics))]

    def _unknown(self, name: object) -> InvalidArgumentException:
        if name in self._joints:
            return InvalidArgumentException(f"joint {name!r} is fixed: it has no position")
        return InvalidArgumentException(
            f"the robot has no joint {name!r}{did_you_mean(str(name), self.places)}"
        )

    def of_many(self, given: Mapping[str, ArrayLike] | ArrayLike) -> tuple[list[Any], int]:
        """A position for each joint that moves, of arrays (N,); and N."""
        counts = {}
        if not isinstance(given, Mapping):
            rows = as_floats(given, "positions")
            given, counts[""] = self._columns_of(rows), len(rows)
        positions: list[Any] = [
            _by_number(joint, np.array(zero))
            for joint, zero in zip(self._free, self.zeros, strict=False)
        ]
        positions += [0.0] * len(self.mimics)
        for name, value in given.items():
            if name not in self.places:
                raise self._unknown(name)
            joint = self._joints[name]
            array = _numbers(value, f"positions of joint {name!r}")
            if not np.isfinite(array).all():
                raise InvalidArgumentException(f"positions of joint {name!r} must be finite")
            row = () if joint.position_size == 1 else (joint.position_size,)
            if array.shape[1:] == row and array.ndim == 1 + len(row):
                counts[name] = len(array)
            elif array.shape != row:
                shape = f"(N, {joint.position_size})" if row else "(N,)"
                raise InvalidArgumentException(
                    f"positions of joint {name!r}: expected shape {shape}, got {array.shape}"
                )
            positions[self.places[name]] = _by_number(joint, array)
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{name!r} {count}" for name, count in list(counts.items())[:8])
            raise InvalidArgumentException(f"positions must be of one length, got {said}")
        self._follow(positions, given)
        return positions, next(iter(counts.values()), 1)

    def _columns_of(self, array: Floats) -> dict[str, Floats]:
        size = sum(joint.position_size for joint in self._free)
        if array.ndim != 2 or array.shape[1] != size:
            raise InvalidArgumentException(
                f"positions: expected shape (N, {size}), got {array.shape}"
            )
        columns, start = {}, 0
        for joint in self._free:
            end = start + joint.position_size
            columns[joint.name] = array[:, start] if end - start == 1 else array[:, start:end]
            start = end
        return columns


def _mimics(joints: Mapping[str, Joint]) -> list[Joint]:
    """The joints that mimic others, each after the one that it mimics."""
    ordered: dict[str, Joint] = {}
    for joint in joints.values():
        way = []
        while joint.mimic is not None and joint.name not in ordered:
            way.append(joint)
            joint = joints[joint.mimic.joint]
        ordered.update((each.name, each) for each in reversed(way))
    return list(ordered.values())


def _all_finite(array: Floats) -> bool:
    return bool(np.isfinite(array).all())


def _zero(joint: Joint) -> Any:
    if joint.type == "floating":
        return IDENTITY
    return (0.0, 0.0, 0.0) if joint.type == "planar" else joint.zero


def _checked(joint: Joint, value: Any) -> Any:
    """The position of a joint as a number, or as a tuple of as many as it has."""
    if joint.type == "floating":
        return (value if isinstance(value, Transform) else Transform.from_pose(value)).as_pose()
    try:
        numbers = np.array(np.nan if isinstance(value, str) else value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if joint.position_size == 1 and numbers.shape == () and np.isfinite(numbers):
        return float(numbers)
    if joint.position_size == 3 and numbers.shape == (3,) and np.isfinite(numbers).all():
        return tuple(numbers.tolist())
    wanted = counted(joint.position_size, "finite number")
    raise InvalidArgumentException(
        f"the position of {joint.type} joint {joint.name!r} must be {wanted}, got {value!r}"
    )


def _numbers(value: Any, what: str) -> Floats:
    """Positions as an array; of transforms their seven numbers."""
    if isinstance(value, Transform):
        return np.array(value.as_pose())
    if isinstance(value, TransformArray):
        return np.hstack((value.xyz, value.quat_xyzw))
    return as_floats(value, what)


def _by_number(joint: Joint, array: Floats) -> Any:
    """An array of positions (N,), or of (N, numbers) a tuple of those."""
    if joint.position_size == 1:
        return array
    if joint.type == "floating":
        rows = array.reshape(-1, 7)
        # Checks and normalises the quaternions.
        checked = TransformArray(rows[:, :3], rows[:, 3:])
        array = np.hstack((checked.xyz, checked.quat_xyzw)).reshape(array.shape)
    return tuple(np.moveaxis(array, -1, 0))
