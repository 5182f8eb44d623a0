"""ROS's tf_transformations: laws of rotations and matrices, and numbers worked out by hand."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from tests import needs
from tfbus.compat import tf_transformations as tf

AXES = [
    f"{frame}{first}{second}{third}"
    for frame in "sr"
    for first, second, third in itertools.product("xyz", repeat=3)
    if first != second and second != third
]

angles = some.floats(-3.0, 3.0)
numbers = some.floats(-10.0, 10.0)
vectors = some.tuples(numbers, numbers, numbers).filter(lambda v: math.hypot(*v) > 0.1)
points = some.tuples(numbers, numbers, numbers)


def on(matrix: Any, point: Any) -> Any:
    """Where a matrix puts a point."""
    moved = matrix @ [*point, 1.0]
    return moved[:3] / moved[3]


@pytest.mark.parametrize("axes", AXES)
def test_euler_angles_are_those_of_scipy(axes: str) -> None:
    """Small letters turn about fixed axes there, capitals about those that turn along."""
    rotations = needs.module("scipy.spatial.transform")
    letters = axes[1:].upper() if axes[0] == "r" else axes[1:]
    for three in ((0.3, 0.5, -1.2), (-2.0, 1.0, 3.0), (0.0, 0.0, 0.0)):
        theirs = rotations.Rotation.from_euler(letters, three).as_matrix()
        ours = tf.euler_matrix(*three, axes)
        assert np.allclose(ours[:3, :3], theirs)
        assert np.allclose(tf.euler_matrix(*tf.euler_from_matrix(ours, axes), axes), ours)


@given(angles, some.sampled_from([math.pi / 2, -math.pi / 2, 0.0]), angles, some.sampled_from(AXES))
def test_euler_angles_hold_where_two_axes_meet(a: float, b: float, c: float, axes: str) -> None:
    """The angles are others, their rotation is the same."""
    matrix = tf.euler_matrix(a, b, c, axes)
    assert np.allclose(
        tf.euler_matrix(*tf.euler_from_matrix(matrix, axes), axes), matrix, atol=1e-6
    )


def test_quaternions_are_x_y_z_w() -> None:
    """A quarter turn about z, in both directions."""
    quarter = tf.quaternion_from_euler(0, 0, math.pi / 2)
    assert np.allclose(quarter, [0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    assert np.allclose(tf.euler_from_quaternion(quarter), [0, 0, math.pi / 2])
    assert np.allclose(on(tf.quaternion_matrix(quarter), (1, 0, 0)), [0, 1, 0])
    assert np.allclose(tf.quaternion_from_matrix(tf.quaternion_matrix(quarter)), quarter)


@given(angles, vectors, angles, vectors)
def test_products_of_quaternions_are_those_of_matrices(
    a: float, axis: Any, b: float, other: Any
) -> None:
    """And the inverse undoes."""
    one, two = tf.quaternion_about_axis(a, axis), tf.quaternion_about_axis(b, other)
    product = tf.quaternion_multiply(one, two)
    assert np.allclose(
        tf.quaternion_matrix(product), tf.quaternion_matrix(one) @ tf.quaternion_matrix(two)
    )
    assert np.allclose(tf.quaternion_multiply(one, tf.quaternion_inverse(one)), [0, 0, 0, 1])
    again = tf.quaternion_from_matrix(tf.quaternion_matrix(one))
    assert abs(again @ one) == pytest.approx(1.0)


def test_slerp_goes_the_shorter_way() -> None:
    """Half of a quarter turn is an eighth."""
    quarter = tf.quaternion_from_euler(0, 0, math.pi / 2)
    half = tf.quaternion_slerp([0, 0, 0, 1], -quarter, 0.5)
    assert np.allclose(tf.euler_from_quaternion(half), [0, 0, math.pi / 4])
    assert np.allclose(tf.quaternion_slerp(quarter, [0, 0, 0, 1], 0.0), quarter)


@given(some.floats(0.1, 3.0), vectors, points)
def test_rotations_are_found_again(angle: float, axis: Any, point: Any) -> None:
    """The angle, the axis and a point of it; the point stays."""
    matrix = tf.rotation_matrix(angle, axis, point)
    assert np.allclose(on(matrix, point), point)
    assert tf.is_same_transform(tf.rotation_matrix(*tf.rotation_from_matrix(matrix)), matrix)


@given(points, vectors)
def test_reflections_are_found_again(point: Any, normal: Any) -> None:
    """Twice is nothing."""
    matrix = tf.reflection_matrix(point, normal)
    assert np.allclose(matrix @ matrix, np.identity(4), atol=1e-6)
    again = tf.reflection_matrix(*tf.reflection_from_matrix(matrix))
    assert np.allclose(again, matrix, atol=1e-5)


@given(some.floats(2.0, 5.0), points, some.none() | vectors)
def test_scales_are_found_again(factor: float, origin: Any, direction: Any) -> None:
    """In all directions and in one."""
    matrix = tf.scale_matrix(factor, origin, direction)
    assert np.allclose(on(matrix, origin), origin)
    assert np.allclose(tf.scale_matrix(*tf.scale_from_matrix(matrix)), matrix, atol=1e-5)


@given(points, vectors, vectors)
def test_parallel_projections_are_found_again(point: Any, normal: Any, direction: Any) -> None:
    """Onto the plane, along the normal or a direction."""
    plane = tf.unit_vector(normal)
    if abs(plane @ tf.unit_vector(direction)) < 0.1:
        return
    matrix = tf.projection_matrix(point, normal, direction)
    moved = on(matrix, (1.0, 2.0, 3.0))
    assert (moved - point) @ plane == pytest.approx(0.0, abs=1e-6)
    found = tf.projection_from_matrix(matrix)
    assert np.allclose(tf.projection_matrix(*found), matrix, atol=1e-4)


@pytest.mark.parametrize("pseudo", [False, True])
def test_perspective_is_found_again(pseudo: bool) -> None:
    """What is seen from a point lies in the plane, on the line to that point."""
    eye, point, normal = (0.0, 0.0, 5.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)
    matrix = tf.projection_matrix(point, normal, perspective=eye, pseudo=pseudo)
    assert np.allclose(on(matrix, (1.0, 2.0, 3.0))[:2], [2.0, 4.0])
    found = tf.projection_from_matrix(matrix, pseudo)
    assert tf.is_same_transform(tf.projection_matrix(*found[:4], pseudo=found[4]), matrix)


def test_shears_are_found_again() -> None:
    """The plane stays."""
    matrix = tf.shear_matrix(0.5, (1, 0, 0), (0, 0, 2), (0, 0, 1))
    assert np.allclose(on(matrix, (3, 4, 2)), [3, 4, 2])
    assert np.allclose(on(matrix, (0, 0, 3)), [math.tan(0.5), 0, 3])
    found = tf.shear_from_matrix(matrix)
    assert np.allclose(tf.shear_matrix(*found), matrix)


@given(
    some.tuples(*[some.floats(0.5, 3.0)] * 3),
    points,
    some.tuples(*[some.floats(-1, 1)] * 3),
    points,
)
def test_a_matrix_is_taken_apart_and_put_together(
    scale: Any, shear: Any, turned: Any, moved: Any
) -> None:
    """Scales, shears, angles and translation."""
    matrix = tf.compose_matrix(scale, shear, turned, moved)
    found = tf.decompose_matrix(matrix)
    assert np.allclose(found[0], scale) and np.allclose(found[1], shear, atol=1e-6)
    assert np.allclose(found[2], turned, atol=1e-6) and np.allclose(found[3], moved)
    assert np.allclose(tf.compose_matrix(*found), matrix)


def test_a_perspective_is_taken_apart_too() -> None:
    """It stays before the rest."""
    matrix = tf.compose_matrix((1, 2, 3), (0.1, 0, 0), (0.1, 0.2, 0.3), (1, 2, 3), (0.1, 0.2, 0, 1))
    assert np.allclose(tf.compose_matrix(*tf.decompose_matrix(matrix)), matrix)


@pytest.mark.parametrize("scaling", [False, True])
def test_points_are_laid_onto_others(scaling: bool) -> None:
    """By the rotation, the translation and, where asked for, the scale between them."""
    wanted = tf.concatenate_matrices(
        tf.translation_matrix((1, 2, 3)),
        tf.random_rotation_matrix((0.2, 0.4, 0.9)),
        tf.scale_matrix(2.0 if scaling else 1.0),
    )
    here = np.array([[1.0, 0, 0, 2], [0, 1, 0, 3], [0, 0, 1, -1]])
    there = np.array([on(wanted, each) for each in here.T]).T
    assert np.allclose(tf.superimposition_matrix(here, there, scaling), wanted)


def test_boxes_are_clipped_and_cells_made_square() -> None:
    """The corners of the box go to -1 and 1; a square cell is a scale."""
    clip = tf.clip_matrix(0, 2, 1, 3, 2, 6)
    assert np.allclose(on(clip, (0, 1, 2)), [-1, -1, -1]) and np.allclose(on(clip, (2, 3, 6)), 1)
    frustum = tf.clip_matrix(-1, 1, -1, 1, 1, 10, perspective=True)
    assert np.allclose(on(frustum, (0, 0, 1)), [0, 0, -1])
    assert np.allclose(on(frustum, (0, 0, 10)), [0, 0, 1])
    cell = tf.orthogonalization_matrix((2, 3, 4), (90, 90, 90))
    assert np.allclose(cell, np.diag([2, 3, 4, 1]))
    with pytest.raises(ValueError, match="empty"):
        tf.clip_matrix(1, 0, 0, 1, 1, 2)


def test_vectors_are_measured_along_an_axis() -> None:
    """And made of length 1, also where the caller gives the array."""
    rows = np.array([[3.0, 4.0], [0.0, 2.0]])
    assert np.allclose(tf.vector_norm(rows, axis=1), [5, 2])
    assert np.allclose(tf.unit_vector(rows, axis=1), [[0.6, 0.8], [0, 1]])
    out = np.empty((2, 2))
    assert tf.unit_vector(rows, axis=1, out=out) is None and np.allclose(out[0], [0.6, 0.8])
    assert tf.vector_norm(tf.random_quaternion()) == pytest.approx(1.0)
    assert (
        tf.random_vector(3).shape == (3,)
        and tf.translation_from_matrix(np.identity(4)).tolist() == [0] * 3
    )


@pytest.mark.parametrize("axes", ["sxx", "xyz", "sxxy", 5])
def test_unknown_axes_are_refused(axes: Any) -> None:
    """With those there are."""
    with pytest.raises(ValueError, match="axes must"):
        tf.quaternion_from_euler(0, 0, 0, axes)
