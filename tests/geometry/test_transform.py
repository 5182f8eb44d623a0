"""Transforms obey the laws of the group of rigid motions, and convert without loss."""

import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import lengths, transforms, units
from tfbus.errors import InvalidArgumentException
from tfbus.geometry.transform import Transform, TransformStamped

TINY = 1e-12


@given(transforms(), transforms(), transforms())
def test_composition_is_associative(a, b, c):
    """(a b) c is a (b c)."""
    assert ((a @ b) @ c).is_close(a @ (b @ c), 100 * TINY)


@given(transforms())
def test_the_inverse_undoes(a):
    """A motion and its inverse leave everything in place, and the identity changes nothing."""
    assert (a @ a.inverse()).is_close(Transform.identity(), 10 * TINY)
    assert (a.inverse() @ a).is_close(Transform.identity(), 10 * TINY)
    assert (a @ Transform.identity()).is_close(a, TINY)


@given(transforms(), transforms(), st.tuples(lengths, lengths, lengths))
def test_points_go_through_a_product_as_through_its_factors(a, b, point):
    """(a b) p is a (b p), and the matrices say the same."""
    assert np.allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-11)
    assert np.allclose((a @ b).as_matrix(), a.as_matrix() @ b.as_matrix(), atol=1e-11)


@given(transforms())
def test_log_and_exp_undo_each_other(a):
    """exp(log(T)) is T, for screws of up to half a turn."""
    assert Transform.exp(a.log()).is_close(a, 10 * TINY)


@given(st.tuples(lengths, lengths, lengths), st.tuples(units, units, units))
def test_exp_then_log_is_the_twist(linear, angular):
    """log(exp(twist)) is the twist, where it turns by less than half a turn."""
    twist = np.array((*linear, *angular))
    assert np.allclose(Transform.exp(twist).log(), twist, rtol=0.0, atol=10 * TINY)


@given(transforms(), transforms())
def test_interpolation_begins_and_ends_at_its_ends(a, b):
    """Ratio 0 is the first, ratio 1 the second, straight or along a screw."""
    assert a.interpolate(b, 0.0).is_close(a, TINY)
    assert a.interpolate(b, 1.0).is_close(b, 10 * TINY)
    assert a.interpolate_screw(b, 0.0).is_close(a, TINY)
    assert a.interpolate_screw(b, 1.0).is_close(b, 1e-9)


@given(transforms())
def test_a_matrix_brings_the_transform_back(a):
    """from_matrix undoes as_matrix."""
    assert Transform.from_matrix(a.as_matrix()).is_close(a, 1e-9)


@given(transforms())
def test_a_rotation_vector_brings_the_rotation_back(a):
    """from_rotvec undoes as_rotvec."""
    assert Transform.from_rotvec(a.as_rotvec(), a.xyz).is_close(a, 1e-9)


ORDERS = ["".join(p) for p in itertools.product("xyz", repeat=3) if p[0] != p[1] != p[2]]


@pytest.mark.parametrize("axes", [*ORDERS, *map(str.upper, ORDERS)])
@given(st.tuples(*[st.floats(-math.pi, math.pi)] * 3))
def test_euler_angles_bring_the_rotation_back(axes, angles):
    """as_euler undoes from_euler in all 24 conventions."""
    rotation = Transform.from_euler(axes, angles)
    assert Transform.from_euler(axes, rotation.as_euler(axes)).is_close(rotation, 1e-6)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_in_gimbal_lock_one_angle_is_zero(pitch):
    """Where roll and yaw turn about one axis, yaw is 0 and the rotation is still right."""
    rotation = Transform.from_rpy(0.3, pitch, 0.5)
    roll, same_pitch, yaw = rotation.as_rpy()
    assert yaw == 0.0
    assert same_pitch == pytest.approx(pitch, abs=1e-7)
    assert Transform.from_rpy(roll, same_pitch, yaw).is_close(rotation, 1e-7)


def test_rpy_turns_about_fixed_axes():
    """Roll, then pitch, then yaw, each about an axis of the parent, as in URDF."""
    turn = Transform.from_rpy(0, 0, math.pi / 2)
    assert np.allclose(turn.apply((1, 0, 0)), (0, 1, 0))
    both = Transform.from_rpy(math.pi / 2, 0, math.pi / 2)
    assert np.allclose(both.apply((0, 1, 0)), (0, 0, 1))


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_are_no_exception(axis):
    """A rotation by half a turn has a rotation vector, a matrix and a logarithm."""
    half = Transform((1, 2, 3), (*axis, 0.0))
    assert np.allclose(np.abs(half.as_rotvec()), math.pi * axis)
    assert Transform.exp(half.log()).is_close(half, TINY)
    assert Transform.from_matrix(half.as_matrix()).is_close(half, TINY)


def test_a_quaternion_and_its_negative_are_the_same_motion():
    """is_close compares motions, == compares numbers."""
    a = Transform((1, 2, 3), (0, 0, 0, 1))
    b = Transform((1, 2, 3), (0, 0, 0, -1))
    assert a.is_close(b) and a != b and a == Transform((1, 2, 3))


@pytest.mark.parametrize(
    ("xyz", "quat"),
    [
        ((0, 0, math.nan), (0, 0, 0, 1)),
        ((0, math.inf, 0), (0, 0, 0, 1)),
        ((0, 0), (0, 0, 0, 1)),
        ((0, 0, 0), (0, 0, 0, 0)),
        ((0, 0, 0), (0, 0, 0, 2)),
        ("abc", (0, 0, 0, 1)),
    ],
)
def test_numbers_that_are_no_motion_are_refused(xyz, quat):
    """Not finite, of another shape, or of another norm than 1."""
    with pytest.raises(InvalidArgumentException):
        Transform(xyz, quat)


def test_a_matrix_that_is_no_rotation_is_refused():
    """Scaled, mirrored, or of another shape."""
    for matrix in (np.eye(4) * 2, np.diag((1, 1, -1, 1)), np.eye(3) * 2, np.eye(2)):
        with pytest.raises(InvalidArgumentException):
            Transform.from_matrix(matrix)


def test_values_cannot_be_changed():
    """Transforms and their arrays are read-only; they can be keys, and be pickled."""
    a = TransformStamped(5, "world", "robot", Transform((1, 2, 3)))
    with pytest.raises(AttributeError):
        a.stamp_ns = 6
    with pytest.raises(AttributeError):
        a.transform.x = 6
    with pytest.raises(ValueError, match="read-only"):
        a.transform.xyz[0] = 6
    assert pickle.loads(pickle.dumps(a)) == a
    assert {a: 1}[TransformStamped(5, "world", "robot", Transform((1, 2, 3)))] == 1


def test_scipy_goes_in_and_out():
    """Rotations and rigid transforms of scipy convert both ways, where scipy is there."""
    spatial = pytest.importorskip("scipy.spatial.transform", reason="needs scipy")
    a = Transform.from_rpy(0.1, 0.2, 0.3, (1, 2, 3))
    assert Transform.from_scipy(a.as_scipy_rotation(), (1, 2, 3)).is_close(a, TINY)
    assert np.allclose(a.as_scipy_rotation().as_euler("xyz"), (0.1, 0.2, 0.3))
    if hasattr(spatial, "RigidTransform"):
        assert Transform.from_scipy(a.as_scipy()).is_close(a, TINY)


def test_a_pose_is_seven_numbers():
    """x y z, then the quaternion x y z w."""
    half = math.sqrt(0.5)
    turned = Transform.from_pose([1.0, 2.0, 3.0, 0.0, 0.0, half, half])
    assert turned.is_close(Transform((1.0, 2.0, 3.0), (0.0, 0.0, half, half)))
    with pytest.raises(InvalidArgumentException):
        Transform.from_pose([1.0, 2.0, 3.0])
