"""ROS's tf_transformations: rotations and matrices as arrays.

Quaternions are x, y, z, w; matrices are (4, 4), and map column vectors. `axes` names the order of
Euler angles: s for fixed axes or r for axes that turn along, then three letters, as "sxyz".
"""

import math
from collections.abc import Sequence
from typing import Any

from tfbus.base import lazy_numpy as np

__all__ = [
    "clip_matrix",
    "compose_matrix",
    "concatenate_matrices",
    "decompose_matrix",
    "euler_from_matrix",
    "euler_from_quaternion",
    "euler_matrix",
    "identity_matrix",
    "inverse_matrix",
    "is_same_transform",
    "orthogonalization_matrix",
    "projection_from_matrix",
    "projection_matrix",
    "quaternion_about_axis",
    "quaternion_conjugate",
    "quaternion_from_euler",
    "quaternion_from_matrix",
    "quaternion_inverse",
    "quaternion_matrix",
    "quaternion_multiply",
    "quaternion_slerp",
    "random_quaternion",
    "random_rotation_matrix",
    "random_vector",
    "reflection_from_matrix",
    "reflection_matrix",
    "rotation_from_matrix",
    "rotation_matrix",
    "scale_from_matrix",
    "scale_matrix",
    "shear_from_matrix",
    "shear_matrix",
    "superimposition_matrix",
    "translation_from_matrix",
    "translation_matrix",
    "unit_vector",
    "vector_norm",
]

# Less than this is no angle, and no length.
_NOTHING = 1e-9


# Quaternions


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Any:
    """The quaternion of three angles in rad."""
    turns = [quaternion_about_axis(a, _unit(n)) for a, n in _turns((ai, aj, ak), axes)]
    # The last turn about fixed axes comes first in the product.
    return quaternion_multiply(quaternion_multiply(turns[2], turns[1]), turns[0])


def euler_from_quaternion(quaternion: Sequence[float], axes: str = "sxyz") -> tuple[float, ...]:
    """The three angles of a quaternion, in rad."""
    return euler_from_matrix(quaternion_matrix(quaternion), axes)


def quaternion_about_axis(angle: float, axis: Sequence[float]) -> Any:
    """The quaternion of a turn by `angle` rad about an axis."""
    return np.append(math.sin(angle / 2) * unit_vector(axis), math.cos(angle / 2))


def quaternion_multiply(quaternion1: Sequence[float], quaternion0: Sequence[float]) -> Any:
    """The product: the turn of `quaternion0`, then the one of `quaternion1`."""
    one, other = np.asarray(quaternion1, float), np.asarray(quaternion0, float)
    vector = one[3] * other[:3] + other[3] * one[:3] + np.cross(one[:3], other[:3])
    return np.append(vector, one[3] * other[3] - one[:3] @ other[:3])


def quaternion_conjugate(quaternion: Any) -> Any:
    """The quaternion with its vector reversed."""
    return np.asarray(quaternion, float) * (-1.0, -1.0, -1.0, 1.0)


def quaternion_inverse(quaternion: Sequence[float]) -> Any:
    """The quaternion whose product with this one is 0, 0, 0, 1."""
    given = np.asarray(quaternion, float)
    return quaternion_conjugate(given) / (given @ given)


def quaternion_matrix(quaternion: Sequence[float]) -> Any:
    """The matrix of a quaternion of any length; one of length 0 is no turn."""
    given = np.asarray(quaternion, float)
    norm = given @ given
    matrix = np.identity(4)
    if norm > 1e-30:
        across = _cross_matrix(given[:3])
        matrix[:3, :3] += 2.0 / norm * (given[3] * across + across @ across)
    return matrix


def quaternion_from_matrix(matrix: Any) -> Any:
    """The quaternion of a matrix's rotation; w is not negative."""
    m = np.asarray(matrix, float)[:3, :3]
    # Of four expressions for the same quaternion the longest is the most exact.
    xx, yy, zz = np.diag(m)
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    wx, wy, wz = _vee(m)
    columns = np.array(
        [
            [1 + xx - yy - zz, xy, xz, wx],
            [xy, 1 - xx + yy - zz, yz, wy],
            [xz, yz, 1 - xx - yy + zz, wz],
            [wx, wy, wz, 1 + xx + yy + zz],
        ]
    )
    longest = columns[np.argmax(np.diag(columns))]
    return math.copysign(1.0, longest[3]) * longest / vector_norm(longest)


def quaternion_slerp(
    quat0: Sequence[float],
    quat1: Sequence[float],
    fraction: float,
    spin: int = 0,
    shortestpath: bool = True,
) -> Any:
    """The quaternion at `fraction` of the way from one to another, with `spin` half turns more."""
    first, last = unit_vector(quat0), unit_vector(quat1)
    cosine = float(first @ last)
    if shortestpath and cosine < 0.0:
        last, cosine = -last, -cosine
    angle = math.acos(min(1.0, max(-1.0, cosine))) + spin * math.pi
    if abs(angle) < _NOTHING or fraction in (0.0, 1.0):
        return last if fraction == 1.0 else first
    weights = math.sin((1.0 - fraction) * angle), math.sin(fraction * angle)
    return (weights[0] * first + weights[1] * last) / math.sin(angle)


def random_quaternion(rand: Any = None) -> Any:
    """A quaternion, each rotation as likely as any other; `rand` are three numbers from 0 to 1."""
    r = np.random.rand(3) if rand is None else np.asarray(rand, float)
    one, other = math.sqrt(1.0 - r[0]), math.sqrt(r[0])
    a, b = 2 * math.pi * r[1], 2 * math.pi * r[2]
    turned = (math.sin(a) * one, math.cos(a) * one, math.sin(b) * other, math.cos(b) * other)
    return np.array(turned)


# Euler angles


def euler_matrix(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Any:
    """The matrix of three angles in rad."""
    return quaternion_matrix(quaternion_from_euler(ai, aj, ak, axes))


def euler_from_matrix(matrix: Any, axes: str = "sxyz") -> tuple[float, ...]:
    """The three angles of a matrix's rotation, in rad."""
    names = _named(axes)
    m = np.asarray(matrix, float)[:3, :3]
    if axes[0] == "r":
        names = names[::-1]
    i, j, k = names
    if i == k:  # the first axis again: the angle between both is from 0 to pi
        k = 3 - i - j
        sign = 1.0 if (j - i) % 3 == 1 else -1.0
        sine = math.hypot(m[i, j], m[i, k])
        if sine > _NOTHING:
            found = (
                math.atan2(m[i, j], sign * m[i, k]),
                math.atan2(sine, m[i, i]),
                math.atan2(m[j, i], -sign * m[k, i]),
            )
        else:
            found = math.atan2(-sign * m[j, k], m[j, j]), math.atan2(sine, m[i, i]), 0.0
    else:
        sign = 1.0 if (j - i) % 3 == 1 else -1.0
        cosine = math.hypot(m[i, i], m[j, i])
        middle = math.atan2(-sign * m[k, i], cosine)
        if cosine > _NOTHING:
            found = (
                math.atan2(sign * m[k, j], m[k, k]),
                middle,
                math.atan2(sign * m[j, i], m[i, i]),
            )
        else:
            found = math.atan2(-sign * m[j, k], m[j, j]), middle, 0.0
    return found[::-1] if axes[0] == "r" else found


def _turns(angles: Sequence[float], axes: str) -> list[tuple[float, int]]:
    """Each angle with its axis, in the order in which they turn about fixed axes."""
    turns = list(zip(angles, _named(axes), strict=True))
    return turns[::-1] if axes[0] == "r" else turns


def _named(axes: str) -> tuple[int, ...]:
    letters = axes[1:].lower() if isinstance(axes, str) else ""
    if len(letters) != 3 or axes[0] not in "sr" or not {*letters} <= {*"xyz"}:
        raise ValueError(f"axes must be s or r and three of x, y and z, as 'sxyz', not {axes!r}")
    if letters[0] == letters[1] or letters[1] == letters[2]:
        raise ValueError(f"axes must not turn twice about one axis in a row, as {axes!r} does")
    return tuple("xyz".index(letter) for letter in letters)


def _unit(axis: int) -> Any:
    return np.identity(3)[axis]


# Matrices


def identity_matrix() -> Any:
    """The matrix that changes nothing."""
    return np.identity(4)


def translation_matrix(direction: Sequence[float]) -> Any:
    """The matrix that moves."""
    matrix = np.identity(4)
    matrix[:3, 3] = np.asarray(direction, float)[:3]
    return matrix


def translation_from_matrix(matrix: Any) -> Any:
    """How far a matrix moves."""
    return np.array(matrix, float)[:3, 3].copy()


def rotation_matrix(angle: float, direction: Sequence[float], point: Any = None) -> Any:
    """The matrix that turns by `angle` rad about an axis through a point."""
    matrix = quaternion_matrix(quaternion_about_axis(angle, direction[:3]))
    return _about(matrix, point)


def rotation_from_matrix(matrix: Any) -> tuple[float, Any, Any]:
    """The angle in rad, the axis, and a point of the axis, of a matrix that turns."""
    m = np.asarray(matrix, float)
    axis, point = _fixed_direction(m), _fixed_point(m)
    sine = float(axis @ _vee(m[:3, :3])) / 2.0
    return math.atan2(sine, (np.trace(m[:3, :3]) - 1.0) / 2.0), axis, point


def reflection_matrix(point: Sequence[float], normal: Sequence[float]) -> Any:
    """The matrix that mirrors at a plane."""
    across = unit_vector(np.asarray(normal, float)[:3])
    matrix = np.identity(4)
    matrix[:3, :3] -= 2.0 * np.outer(across, across)
    return _about(matrix, point)


def reflection_from_matrix(matrix: Any) -> tuple[Any, Any]:
    """A point of the plane and its normal, of a matrix that mirrors."""
    m = np.asarray(matrix, float)
    return _fixed_point(m), _eigenvector(m[:3, :3], -1.0)


def scale_matrix(factor: float, origin: Any = None, direction: Any = None) -> Any:
    """The matrix that makes larger, about a point; in one direction only if one is given."""
    matrix = np.identity(4)
    if direction is None:
        matrix[:3, :3] *= factor
    else:
        along = unit_vector(np.asarray(direction, float)[:3])
        matrix[:3, :3] += (factor - 1.0) * np.outer(along, along)
    return _about(matrix, origin)


def scale_from_matrix(matrix: Any) -> tuple[float, Any, Any]:
    """The factor, the point and the direction, None for all, of a matrix that makes larger."""
    m = np.asarray(matrix, float)
    linear = m[:3, :3]
    factor = float(np.trace(linear)) - 2.0
    if np.allclose(linear, linear[0, 0] * np.identity(3)):
        return float(linear[0, 0]), _fixed_point(m), None
    return factor, _fixed_point(m), _eigenvector(linear, factor)


def projection_matrix(
    point: Sequence[float],
    normal: Sequence[float],
    direction: Any = None,
    perspective: Any = None,
    pseudo: bool = False,
) -> Any:
    """The matrix that projects onto a plane: along its normal or a direction, or from a point."""
    through = np.asarray(point, float)[:3]
    across = unit_vector(np.asarray(normal, float)[:3])
    matrix = np.identity(4)
    if perspective is not None:
        eye = np.asarray(perspective, float)[:3]
        height = float((eye - through) @ across)
        matrix[:3, :3] = height * np.identity(3) - np.outer(eye, across)
        matrix[:3, 3] = (through @ across) * eye
        if pseudo:
            matrix[:3, :3] -= np.outer(across, across)
            matrix[:3, 3] += (through @ across) * across
        matrix[3, :3] = -across
        matrix[3, 3] = eye @ across
        return matrix
    along = across if direction is None else np.asarray(direction, float)[:3]
    matrix[:3, :3] -= np.outer(along, across) / (along @ across)
    return _about(matrix, through)


def projection_from_matrix(matrix: Any, pseudo: bool = False) -> tuple[Any, Any, Any, Any, bool]:
    """The point, normal, direction and eye of a projection, each None if it lacks it; `pseudo`."""
    m = np.asarray(matrix, float)
    if np.allclose(m[3], (0, 0, 0, m[3, 3])):
        along = _eigenvector(m[:3, :3] / m[3, 3], 0.0)
        across = _eigenvector(m[:3, :3].T / m[3, 3], 0.0)
        return _fixed_point(m), across, along, None, False
    m = m / vector_norm(m[3, :3])
    across = -m[3, :3]
    linear = m[:3, :3] + (np.outer(across, across) if pseudo else 0.0)
    height = (float(np.trace(linear)) + m[3, 3]) / 3.0
    eye = height * across - linear @ across
    return eye - height * across, across, None, eye, pseudo


def clip_matrix(
    left: float, right: float, bottom: float, top: float, near: float, far: float,
    perspective: bool = False,
) -> Any:  # fmt: skip
    """The matrix that maps a box, or a frustum, onto -1 to 1 in each direction. Raises ValueError
    for an empty one.
    """
    if left >= right or bottom >= top or near >= far:
        raise ValueError("the box is empty: left < right, bottom < top and near < far are needed")
    low, high = np.array([left, bottom, near]), np.array([right, top, far])
    size, middle = high - low, high + low
    matrix = np.zeros((4, 4))
    if not perspective:
        matrix[[0, 1, 2], [0, 1, 2]] = 2.0 / size * (1.0, 1.0, 1.0)
        matrix[:3, 3] = -middle / size
        matrix[3, 3] = 1.0
        return matrix
    if near <= _NOTHING:
        raise ValueError(f"near must be more than 0 of a frustum, not {near}")
    matrix[0, 0], matrix[1, 1] = -2.0 * near / size[0], -2.0 * near / size[1]
    matrix[:2, 2] = middle[:2] / size[:2]
    matrix[2, 2] = -middle[2] / size[2]
    matrix[2, 3] = 2.0 * near * far / size[2]
    matrix[3, 2] = -1.0
    return matrix


def shear_matrix(
    angle: float, direction: Sequence[float], point: Sequence[float], normal: Sequence[float]
) -> Any:
    """The matrix that shears by `angle` rad along a direction in a plane. Raises ValueError if
    the direction is not in the plane.
    """
    across, along = unit_vector(normal[:3]), unit_vector(direction[:3])
    if abs(across @ along) > 1e-6:
        raise ValueError("the direction must lie in the plane, at a right angle to the normal")
    matrix = np.identity(4)
    matrix[:3, :3] += math.tan(angle) * np.outer(along, across)
    return _about(matrix, point)


def shear_from_matrix(matrix: Any) -> tuple[float, Any, Any, Any]:
    """The angle in rad, the direction, a point of the plane and its normal, of a shear."""
    m = np.asarray(matrix, float)
    left, sizes, right = np.linalg.svd(m[:3, :3] - np.identity(3))
    return math.atan(sizes[0]), left[:, 0], _fixed_point(m), right[0]


def compose_matrix(
    scale: Any = None, shear: Any = None, angles: Any = None, translate: Any = None,
    perspective: Any = None,
) -> Any:  # fmt: skip
    """The matrix that scales, shears (xy, xz, yz), turns by three angles about fixed x, y and z,
    and moves; `perspective` is its last row.
    """
    matrix = np.identity(4)
    if perspective is not None:
        last = np.identity(4)
        last[3] = np.asarray(perspective, float)[:4]
        matrix = matrix @ last
    if translate is not None:
        matrix = matrix @ translation_matrix(translate)
    if angles is not None:
        matrix = matrix @ euler_matrix(angles[0], angles[1], angles[2])
    if shear is not None:
        sheared = np.identity(4)
        sheared[0, 1], sheared[0, 2], sheared[1, 2] = shear
        matrix = matrix @ sheared
    if scale is not None:
        matrix = matrix @ np.diag([*scale, 1.0])
    return matrix / matrix[3, 3]


def decompose_matrix(matrix: Any) -> tuple[Any, Any, Any, Any, Any]:
    """The arguments of `compose_matrix`: scale, shear, angles, translation and perspective. Raises
    ValueError for a matrix that cannot be inverted.
    """
    m = np.array(matrix, float)
    if abs(m[3, 3]) < _NOTHING or abs(np.linalg.det(m)) < 1e-300:
        raise ValueError("a matrix that cannot be inverted cannot be taken apart")
    m /= m[3, 3]
    perspective = np.array([0.0, 0.0, 0.0, 1.0])
    if np.any(np.abs(m[3, :3]) > _NOTHING):
        affine = m.copy()
        affine[3] = perspective
        perspective = np.linalg.solve(affine.T, m[3])
        m = affine
    # A rotation and the rest: scales, and shears above the diagonal.
    rotation, upper = np.linalg.qr(m[:3, :3])
    signs = np.where(np.diag(upper) < 0.0, -1.0, 1.0)
    rotation, upper = rotation * signs, upper * signs[:, None]
    if np.linalg.det(rotation) < 0.0:
        rotation, upper = -rotation, -upper
    scale = np.diag(upper).copy()
    sheared = upper / scale
    shear = [float(sheared[0, 1]), float(sheared[0, 2]), float(sheared[1, 2])]
    return scale, shear, list(euler_from_matrix(rotation)), m[:3, 3].copy(), perspective


def orthogonalization_matrix(lengths: Sequence[float], angles: Sequence[float]) -> Any:
    """The matrix from fractions of a crystal's cell into space; angles in degrees."""
    a, b, c = lengths
    alpha, beta, gamma = np.radians(angles)
    star = (np.cos(alpha) * np.cos(beta) - np.cos(gamma)) / (np.sin(alpha) * np.sin(beta))
    return np.array(
        [
            [a * np.sin(beta) * math.sqrt(1.0 - star * star), 0.0, 0.0, 0.0],
            [-a * np.sin(beta) * star, b * np.sin(alpha), 0.0, 0.0],
            [a * np.cos(beta), b * np.cos(alpha), c, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def superimposition_matrix(v0: Any, v1: Any, scaling: bool = False, usesvd: bool = True) -> Any:
    """The matrix that moves points (3, N) onto others with the least squares of the distances.

    Kabsch's and Umeyama's; `scaling` lets it make larger, too.
    """
    one, other = np.asarray(v0, float)[:3], np.asarray(v1, float)[:3]
    if one.shape != other.shape or one.ndim != 2 or one.shape[1] < 3:
        raise ValueError(f"both must be (3, N) with 3 points or more: {one.shape}, {other.shape}")
    from_, to = one.mean(axis=1), other.mean(axis=1)
    a, b = one - from_[:, None], other - to[:, None]
    left, _, right = np.linalg.svd(b @ a.T)
    handed = np.diag([1.0, 1.0, np.linalg.det(left) * np.linalg.det(right)])
    matrix = np.identity(4)
    matrix[:3, :3] = left @ handed @ right
    if scaling:
        matrix[:3, :3] *= math.sqrt((b * b).sum() / (a * a).sum())
    matrix[:3, 3] = to - matrix[:3, :3] @ from_
    return matrix


def inverse_matrix(matrix: Any) -> Any:
    """The matrix that undoes this one."""
    return np.linalg.inv(np.asarray(matrix, float))


def concatenate_matrices(*matrices: Any) -> Any:
    """The product: the last one acts first."""
    product = np.identity(4)
    for each in matrices:
        product = product @ np.asarray(each, float)
    return product


def is_same_transform(matrix0: Any, matrix1: Any) -> bool:
    """Whether both do the same, but for rounding."""
    one, other = np.asarray(matrix0, float), np.asarray(matrix1, float)
    return bool(np.allclose(one / one[3, 3], other / other[3, 3]))


def random_rotation_matrix(rand: Any = None) -> Any:
    """A rotation, each as likely as any other."""
    return quaternion_matrix(random_quaternion(rand))


# Vectors


def vector_norm(data: Any, axis: Any = None, out: Any = None) -> Any:
    """The length, of all numbers or along an axis of the array."""
    lengths = np.sqrt((np.asarray(data, float) ** 2).sum(axis=axis))
    if out is None:
        return lengths
    out[...] = lengths
    return None


def unit_vector(data: Any, axis: Any = None, out: Any = None) -> Any:
    """The vector of length 1 in the same direction, or several along an axis of the array."""
    given = np.array(data, float)
    lengths = np.sqrt((given**2).sum(axis=axis, keepdims=axis is not None))
    unit = given / lengths
    if out is None:
        return unit
    out[...] = unit
    return None


def random_vector(size: Any) -> Any:
    """Numbers from 0 to 1."""
    return np.random.random(size)


# Parts of the above


def _about(matrix: Any, point: Any) -> Any:
    """A matrix about a point rather than the origin."""
    if point is not None:
        given = np.asarray(point, float)[:3]
        matrix[:3, 3] = given - matrix[:3, :3] @ given
    return matrix


def _cross_matrix(v: Any) -> Any:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _vee(m: Any) -> Any:
    return np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def _eigenvector(linear: Any, value: float) -> Any:
    """The direction that a matrix makes so much larger. Raises ValueError if there is none."""
    _, sizes, rows = np.linalg.svd(linear - value * np.identity(3))
    if sizes[2] > 1e-6:
        raise ValueError(f"the matrix has no direction of eigenvalue {value:g}")
    return rows[2]


def _fixed_direction(m: Any) -> Any:
    """The axis of a rotation, in the sense in which the angle is positive."""
    axis = _eigenvector(m[:3, :3], 1.0)
    return -axis if axis @ _vee(m[:3, :3]) < 0.0 else axis


def _fixed_point(m: Any) -> Any:
    """The point nearest to the origin that stays where it is, with a 1 behind it."""
    found = np.linalg.lstsq(np.identity(3) - m[:3, :3] / m[3, 3], m[:3, 3] / m[3, 3], rcond=None)[0]
    return np.append(found, 1.0)
