"""Arithmetic of poses: seven floats x y z qx qy qz qw, the quaternion of norm 1."""

import math

from tfbus.errors import InvalidArgumentException

Pose = tuple[float, float, float, float, float, float, float]

# tf2 refuses a quaternion whose squared norm is this far from 1.
QUATERNION_TOLERANCE = 0.01


def unit_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    """The quaternion with norm exactly 1.

    Raises InvalidArgumentException where its squared norm is not within 0.01 of 1, as in tf2.
    """
    squared = x * x + y * y + z * z + w * w
    if abs(squared - 1.0) >= QUATERNION_TOLERANCE:
        raise InvalidArgumentException(
            f"the quaternion ({x:g}, {y:g}, {z:g}, {w:g}) has norm {math.sqrt(squared):.6g}; "
            "a rotation has norm 1"
        )
    norm = math.sqrt(squared)
    return x / norm, y / norm, z / norm, w / norm


def rotate(q: Pose, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The vector turned by the pose's rotation: v + 2 q x (q x v + w v)."""
    _, _, _, qx, qy, qz, qw = q
    tx = 2 * (qy * z - qz * y)
    ty = 2 * (qz * x - qx * z)
    tz = 2 * (qx * y - qy * x)
    return (
        x + qw * tx + qy * tz - qz * ty,
        y + qw * ty + qz * tx - qx * tz,
        z + qw * tz + qx * ty - qy * tx,
    )


def compose(a: Pose, b: Pose) -> Pose:
    """b first, then a."""
    x, y, z = rotate(a, b[0], b[1], b[2])
    ax, ay, az, aw = a[3:]
    bx, by, bz, bw = b[3:]
    return (
        a[0] + x,
        a[1] + y,
        a[2] + z,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def invert(a: Pose) -> Pose:
    """The pose the other way round."""
    turned_back = (0.0, 0.0, 0.0, -a[3], -a[4], -a[5], a[6])
    x, y, z = rotate(turned_back, a[0], a[1], a[2])
    return -x, -y, -z, -a[3], -a[4], -a[5], a[6]


def interpolate(a: Pose, b: Pose, ratio: float) -> Pose:
    """The pose at `ratio` of the way from a to b: the translation on a straight line, the rotation
    at constant speed the short way round (slerp, Shoemake 1985), as tf2 does.
    """
    dot = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    sign = 1.0 if dot >= 0.0 else -1.0
    dot = abs(dot)
    if dot > 1.0 - 1e-12:
        weight_a, weight_b = 1.0 - ratio, ratio * sign
    else:
        angle = math.acos(dot)
        sine = math.sin(angle)
        weight_a = math.sin((1.0 - ratio) * angle) / sine
        weight_b = sign * math.sin(ratio * angle) / sine
    return (
        a[0] + (b[0] - a[0]) * ratio,
        a[1] + (b[1] - a[1]) * ratio,
        a[2] + (b[2] - a[2]) * ratio,
        a[3] * weight_a + b[3] * weight_b,
        a[4] * weight_a + b[4] * weight_b,
        a[5] * weight_a + b[5] * weight_b,
        a[6] * weight_a + b[6] * weight_b,
    )


def rotation_rows(q: Pose) -> tuple[tuple[float, float, float], ...]:
    """The rotation matrix of the pose, row by row."""
    x, y, z, w = q[3:]
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
