"""Rotations as quaternions x y z w, matrices and Euler angles: of one, and beside it of many rows.

Compiled if there is a C compiler, without C types of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, pi, sin, sqrt
from typing import TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException
from tfbus.base.lazy_numpy import NDArray
from tfbus.geometry.kernel import QUATERNION_TOLERANCE, UNIT_TO_THE_LAST_BIT

Floats: TypeAlias = "NDArray[np.float64]"
Angles: TypeAlias = "tuple[Floats, Floats, Floats]"
Triple = tuple[float, float, float]

# Two components of a quaternion that together are below this are rounding: gimbal lock.
LOCKED_BELOW = 1e-8
# The tolerance of a rotation's matrix, of the products of its rows.
ORTHOGONAL_WITHIN = 1e-5
# Below this sine of the angle between two directions rounding decides the normal of both.
PARALLEL_WITHIN = 1e-9


# Quaternions


def unit_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    """The quaternion, normalised.

    Raises InvalidArgumentException if its squared norm is not within 0.01 of one.
    """
    square = x * x + y * y + z * z + w * w
    if abs(square - 1.0) >= QUATERNION_TOLERANCE:
        raise InvalidArgumentException(
            f"the quaternion x={x:g} y={y:g} z={z:g} w={w:g} has norm {sqrt(square):.6g}; a "
            "rotation has norm 1" + (": was it never set?" if square == 0.0 else "")
        )
    if abs(square - 1.0) <= UNIT_TO_THE_LAST_BIT:
        # Unchanged, so that a transform that is sent and read back stays equal.
        return x, y, z, w
    norm = sqrt(square)
    return x / norm, y / norm, z / norm, w / norm


def _unit(quaternions: Floats) -> Floats:
    unit: Floats = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return unit


def product(a: Floats, b: Floats) -> Floats:
    """First the rotations of `b`, then the ones of `a`; of norm one."""
    axis_a, w_a = a[..., :3], a[..., 3:]
    axis_b, w_b = b[..., :3], b[..., 3:]
    w = w_a * w_b - np.sum(axis_a * axis_b, axis=-1, keepdims=True)
    axis = w_a * axis_b + w_b * axis_a + np.cross(axis_a, axis_b)
    return _unit(np.concatenate((axis, w), axis=-1))


# Matrices


def matrix_of(x: float, y: float, z: float, w: float) -> tuple[Triple, Triple, Triple]:
    """The matrix (3, 3) of a unit quaternion, row by row."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def matrices_of(quat_xyzw: Floats) -> Floats:
    """The matrices (N, 3, 3) of unit quaternions (N, 4)."""
    x, y, z, w = quat_xyzw.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def is_rotation(matrix: Floats) -> bool:
    """Whether a matrix (3, 3) is orthogonal (to 1e-5) and right-handed."""
    is_orthogonal = np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=ORTHOGONAL_WITHIN)
    return bool(is_orthogonal and not np.linalg.det(matrix) < 0)


def are_rotations(matrices: Floats) -> NDArray[np.bool_]:
    """Which of the matrices (N, 3, 3) are rotations, as `is_rotation` has it."""
    squares = matrices @ np.swapaxes(matrices, 1, 2)
    are_orthogonal = np.isclose(squares, np.eye(3), rtol=0.0, atol=ORTHOGONAL_WITHIN).all(
        axis=(1, 2)
    )
    checked: NDArray[np.bool_] = are_orthogonal & (np.linalg.det(matrices) > 0.0)
    return checked


def quaternion_of_matrix(m: list[list[float]]) -> list[float]:
    """The quaternion of a rotation, by Shepperd's method: it divides by the largest component, so
    that no digits are lost.
    """
    trace = m[0][0] + m[1][1] + m[2][2]
    largest = max(range(4), key=(m[0][0], m[1][1], m[2][2], trace).__getitem__)
    if largest == 3:
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1.0 + trace]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
        q[i] = 1.0 + m[i][i] - m[j][j] - m[k][k]
        q[j] = m[j][i] + m[i][j]
        q[k] = m[k][i] + m[i][k]
    norm = hypot(*q)
    return [component / norm for component in q]


def quaternions_of_matrices(matrices: Floats) -> Floats:
    """The quaternions (N, 4) of rotations (N, 3, 3), by Shepperd's method."""
    m = np.moveaxis(matrices, 0, -1)
    # Four times the products of the components with each other.
    products = np.empty((4, 4, len(matrices)))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[i, i] = 1.0 + m[i, i] - m[j, j] - m[k, k]
        products[i, j] = products[j, i] = m[j, i] + m[i, j]
        products[i, 3] = products[3, i] = m[k, j] - m[j, k]
    products[3, 3] = 1.0 + m[0, 0] + m[1, 1] + m[2, 2]
    largest = np.argmax(np.einsum("iin->in", products), axis=0)
    return _unit(products[largest, :, np.arange(len(matrices))])


def looking(forward: Floats, up: Floats, convention: str) -> Floats:
    """The matrices (..., 3, 3) of frames that look along `forward` (..., 3), their upper side
    towards `up` (3,), as `Transform.look_at` has it.
    """
    if convention not in ("robot", "camera"):
        raise InvalidArgumentException(
            f"convention must be 'robot' (x forward, z up) or 'camera' (z forward, y down), not "
            f"{convention!r}"
        )
    length = np.linalg.norm(forward, axis=-1, keepdims=True)
    if not (length > 0.0).all():
        raise InvalidArgumentException("eye and target are the same point: nothing to look along")
    ahead = forward / length
    left = np.cross(up, ahead)
    sine = np.linalg.norm(left, axis=-1, keepdims=True)
    if not (sine > PARALLEL_WITHIN * np.linalg.norm(up)).all():
        raise InvalidArgumentException(
            f"up {up.tolist()} is parallel to the direction from eye to target: give another, such "
            "as up=(1, 0, 0)"
        )
    left = left / sine
    above = np.cross(ahead, left)
    axes = (ahead, left, above) if convention == "robot" else (-left, -above, ahead)
    return np.stack(axes, axis=-1)


# Euler angles


def euler_axes(axes: str) -> tuple[list[int], bool]:
    """Three axes as indices, and whether they stay fixed: "xyz" (fixed) or "ZYX" (turning)."""
    order = ["xyz".find(axis) for axis in axes.lower()] if isinstance(axes, str) else []
    good = len(order) == 3 and -1 not in order and order[1] not in (order[0], order[2])
    if not good or axes not in (axes.lower(), axes.upper()):
        raise InvalidArgumentException(
            f"axes must be three of x, y, z, no two adjacent ones equal, such as 'xyz' (fixed) or "
            f"'ZYX' (rotating), not {axes!r}"
        )
    return order, axes.islower()


def quaternion_about(axis: int, angle_rad: float) -> list[float]:
    """The quaternion of a rotation about axis 0, 1 or 2."""
    quaternion = [0.0, 0.0, 0.0, cos(0.5 * angle_rad)]
    quaternion[axis] = sin(0.5 * angle_rad)
    return quaternion


def quaternions_of_angles(axes: str, angles_rad: Floats) -> Floats:
    """The quaternions (N, 4) of three angles a row, about axes as `euler_axes` reads them."""
    order, fixed = euler_axes(axes)
    rotations = np.zeros((len(angles_rad), 4))
    rotations[:, 3] = 1.0
    for axis, angle in zip(order, angles_rad.T, strict=True):
        turns = np.zeros_like(rotations)
        turns[:, axis], turns[:, 3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
        rotations = product(turns, rotations) if fixed else product(rotations, turns)
    return rotations


def angles_of(axes: str, quat_xyzw: Sequence[float]) -> Triple:
    """The three angles in radians about axes as `euler_axes` reads them.

    In gimbal lock the third is 0. Method: Bernardes and Viollet, Quaternion to Euler angles
    conversion, PLOS ONE 2022.
    """
    order, fixed = euler_axes(axes)
    first, second, third = _fixed_axes_angles(
        quat_xyzw, order if fixed else order[::-1], free_last=fixed
    )
    return (first, second, third) if fixed else (third, second, first)


def angles_of_rows(axes: str, quat_xyzw: Floats) -> Floats:
    """As `angles_of`, of quaternions (N, 4): the angles (N, 3)."""
    order, fixed = euler_axes(axes)
    angles = _fixed_axes_angles_of_rows(quat_xyzw, order if fixed else order[::-1], free_last=fixed)
    return np.column_stack(angles if fixed else angles[::-1])


def _fixed_axes_angles(
    quaternion: Sequence[float], order: Sequence[int], *, free_last: bool
) -> Triple:
    """Angles about three fixed axes; in gimbal lock the last is 0, or else the first."""
    i, j, k = order
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = float((i - j) * (j - k) * (k - i) // 2)
    qi, qj, qk, w = quaternion[i], quaternion[j], quaternion[k] * sign, quaternion[3]
    a, b, c, d = (w, qi, qj, qk) if proper else (w - qj, qi + qk, qj + w, qk - qi)
    low, high = hypot(c, d), hypot(a, b)
    second = 2.0 * atan2(low, high)
    half_sum, half_difference = atan2(b, a), atan2(d, c)
    # At a lock one of the two is the angle of a vanishing vector: noise.
    if min(low, high) < LOCKED_BELOW:
        lone = 2.0 * half_sum if low < high else -2.0 * half_difference
        if free_last:
            first, third = lone, 0.0
        else:
            first, third = 0.0, lone if low < high else -lone
    else:
        first, third = half_sum - half_difference, half_sum + half_difference
    if not proper:
        third *= sign
        # More exact near the lock than 2 atan2(...) - pi/2.
        second = second - 0.5 * pi
    return _wrapped(first), second, _wrapped(third)


def _fixed_axes_angles_of_rows(quat_xyzw: Floats, order: list[int], *, free_last: bool) -> Angles:
    """As `_fixed_axes_angles`, row by row."""
    i, j, k = order
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = float((i - j) * (j - k) * (k - i) // 2)
    qi, qj, qk, w = quat_xyzw[:, i], quat_xyzw[:, j], quat_xyzw[:, k] * sign, quat_xyzw[:, 3]
    a, b, c, d = (w, qi, qj, qk) if proper else (w - qj, qi + qk, qj + w, qk - qi)
    low, high = np.hypot(c, d), np.hypot(a, b)
    half_sum, half_difference = np.arctan2(b, a), np.arctan2(d, c)
    is_locked, is_low = np.minimum(low, high) < LOCKED_BELOW, low < high
    # At a lock one of the two is the angle of a vanishing vector: noise.
    lone = np.where(is_low, 2.0 * half_sum, -2.0 * half_difference)
    zero = np.zeros_like(lone)
    locked_first = lone if free_last else zero
    locked_third = zero if free_last else np.where(is_low, lone, -lone)
    first = np.where(is_locked, locked_first, half_sum - half_difference)
    third = np.where(is_locked, locked_third, half_sum + half_difference)
    second = 2.0 * np.arctan2(low, high)
    if not proper:
        third, second = third * sign, second - 0.5 * np.pi
    return _wrapped_rows(first), second, _wrapped_rows(third)


def _wrapped(angle_rad: float) -> float:
    if angle_rad > pi:
        return angle_rad - 2.0 * pi
    if angle_rad < -pi:
        return angle_rad + 2.0 * pi
    return angle_rad


def _wrapped_rows(angles_rad: Floats) -> Floats:
    turns = (angles_rad < -np.pi).astype(float) - (angles_rad > np.pi)
    return angles_rad + 2.0 * np.pi * turns
