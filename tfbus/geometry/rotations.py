"""Rotations as arrays: quaternions (N, 4) x y z w, matrices (N, 3, 3) and Euler angles (N, 3).

The formulas are those of `Transform`, which has them for one.
"""

import numpy as np
from numpy.typing import NDArray

from tfbus.geometry.transform import LOCKED_BELOW, ORTHOGONAL_WITHIN, euler_axes

Floats = NDArray[np.float64]
Angles = tuple[Floats, Floats, Floats]


def product(a: Floats, b: Floats) -> Floats:
    """First the turn of `b`, then that of `a`; of norm one."""
    axis_a, w_a = a[..., :3], a[..., 3:]
    axis_b, w_b = b[..., :3], b[..., 3:]
    w = w_a * w_b - np.sum(axis_a * axis_b, axis=-1, keepdims=True)
    axis = w_a * axis_b + w_b * axis_a + np.cross(axis_a, axis_b)
    return _unit(np.concatenate((axis, w), axis=-1))


def matrices_of(quat_xyzw: Floats) -> Floats:
    """The matrices of quaternions."""
    x, y, z, w = quat_xyzw.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def are_rotations(matrices: Floats) -> NDArray[np.bool_]:
    """Of each matrix whether it is a rotation, as `Transform.from_matrix` judges."""
    squares = matrices @ np.swapaxes(matrices, 1, 2)
    are_orthogonal = np.isclose(squares, np.eye(3), atol=ORTHOGONAL_WITHIN).all(axis=(1, 2))
    checked: NDArray[np.bool_] = are_orthogonal & (np.linalg.det(matrices) > 0.0)
    return checked


def quaternions_of_matrices(matrices: Floats) -> Floats:
    """The quaternions of matrices that are rotations; Shepperd's method: from the largest component
    of each, so that nothing is lost.
    """
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


def quaternions_of_angles(axes: str, angles_rad: Floats) -> Floats:
    """The quaternions of three angles a row, about axes as `Transform.from_euler` names them."""
    order, fixed = euler_axes(axes)
    rotations = np.zeros((len(angles_rad), 4))
    rotations[:, 3] = 1.0
    for axis, angle in zip(order, angles_rad.T, strict=True):
        turns = np.zeros_like(rotations)
        turns[:, axis], turns[:, 3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
        rotations = product(turns, rotations) if fixed else product(rotations, turns)
    return rotations


def angles_of(axes: str, quat_xyzw: Floats) -> Floats:
    """The angles a row that `quaternions_of_angles` takes, as `Transform.as_euler` has them."""
    order, fixed = euler_axes(axes)
    angles = _fixed_axes_angles(quat_xyzw, order if fixed else order[::-1], free_last=fixed)
    return np.column_stack(angles if fixed else angles[::-1])


def _fixed_axes_angles(quat_xyzw: Floats, order: list[int], *, free_last: bool) -> Angles:
    """As of one rotation: Bernardes and Viollet, PLOS ONE 2022."""
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
    return _wrapped(first), second, _wrapped(third)


def _wrapped(angles_rad: Floats) -> Floats:
    turns = (angles_rad < -np.pi).astype(float) - (angles_rad > np.pi)
    return angles_rad + 2.0 * np.pi * turns


def _unit(quaternions: Floats) -> Floats:
    unit: Floats = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return unit
