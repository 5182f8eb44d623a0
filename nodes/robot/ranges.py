"""How far the joints of a robot go, and where they rest."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from tfbus import Joint, Robot

# A joint that slides without a limit goes as far as this to either side, in metres.
_UNLIMITED_M = 1.0

# Where the description has no speed: rad/s, and m/s.
_SPEED = {"prismatic": 0.2}
_TURNING_SPEED = 1.0

# Slower than this is a mistake in the description.
_LEAST_SPEED = 1e-6


@dataclass(frozen=True)
class Range:
    """A joint's positions from `lower` to `upper`, in rad or m, its `rest`, and its greatest speed.

    The limits are the narrower of the joint's and its safety controller's. A continuous joint goes
    from -pi to pi.
    """

    name: str
    lower: float
    upper: float
    rest: float
    speed: float
    turns: bool

    def clamped(self, position: float) -> float:
        """The nearest position within the limits."""
        return min(max(position, self.lower), self.upper)

    @property
    def width(self) -> float:
        """From one limit to the other."""
        return self.upper - self.lower


def ranges_of(robot: Robot, rests: Mapping[str, float] | None = None) -> dict[str, Range]:
    """The ranges of the joints that a joint state can give: neither fixed, nor mimics, nor planar
    or floating. `rests` are other positions of rest.
    """
    given = rests or {}
    found = {}
    for joint in robot.free_joints:
        if joint.position_size == 1:
            found[joint.name] = _range(joint, given.get(joint.name))
    return found


def _range(joint: Joint, rest: float | None) -> Range:
    lower, upper = _limits(joint)
    if rest is None:
        rest = 0.0 if lower <= 0.0 <= upper else 0.5 * (lower + upper)
    said = joint.limits.velocity if joint.limits else math.inf
    speed = said if _LEAST_SPEED < said < math.inf else math.inf
    speed = min(speed, _SPEED.get(joint.type, _TURNING_SPEED))
    turns = joint.type != "prismatic"
    return Range(joint.name, lower, upper, min(max(rest, lower), upper), speed, turns)


def _limits(joint: Joint) -> tuple[float, float]:
    lower, upper = -math.inf, math.inf
    if joint.limits is not None and joint.type != "continuous":
        lower, upper = joint.limits.lower, joint.limits.upper
    if joint.soft_limits is not None and joint.soft_limits[0] < joint.soft_limits[1]:
        lower, upper = max(lower, joint.soft_limits[0]), min(upper, joint.soft_limits[1])
    unlimited = _UNLIMITED_M if joint.type == "prismatic" else math.pi
    # Where one limit is finite, a range outside the usual one begins or ends at it.
    least = -unlimited if upper > -unlimited else upper - 2.0 * unlimited
    most = unlimited if lower < unlimited else lower + 2.0 * unlimited
    lower = least if lower == -math.inf else lower
    upper = most if upper == math.inf else upper
    return (lower, upper) if lower <= upper else (upper, lower)
