"""Transforms obey the laws of the group of rigid motions, and convert without loss."""

import itertools
import json
import math
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import lengths, transforms, units
from tfbus.base.errors import InvalidArgumentException
from tfbus.geometry.transform import Transform, TransformStamped, check_stamp
from tfbus.geometry.transform_array import TransformArray
from tfbus.geometry.twist import TwistStamped

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


@given(st.tuples(*[st.floats(-math.pi, math.pi)] * 3))
def test_euler_angles_bring_the_rotation_back(angles):
    """as_euler undoes from_euler in all 24 conventions."""
    for axes in (*ORDERS, *map(str.upper, ORDERS)):
        rotation = Transform.from_euler(axes, angles)
        assert Transform.from_euler(axes, rotation.as_euler(axes)).is_close(rotation, 1e-6), axes


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


@pytest.mark.parametrize("at", [(0, 0), (0, 1), (2, 1)])
def test_a_matrix_is_a_rotation_to_the_same_tolerance_everywhere(at):
    """To 1e-5 in the lengths of its rows and between them, one or many."""
    near, far = np.eye(3), np.eye(3)
    near[at] += 4e-6
    far[at] += 3e-5
    assert Transform.from_matrix(near).is_close(Transform.identity(), 1e-5)
    assert len(TransformArray.from_matrix([near, near])) == 2
    for refused in (Transform.from_matrix, lambda matrix: TransformArray.from_matrix([matrix])):
        with pytest.raises(InvalidArgumentException, match="not a rotation"):
            refused(far)


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


# In the manner of numpy


@given(transforms(), st.lists(st.tuples(lengths, lengths, lengths), min_size=1, max_size=4))
def test_a_transform_times_points_applies_it(a, points):
    """T @ p is T.apply(p), of one point or many, and ~T brings them back."""
    assert np.array_equal(a @ points, a.apply(points))
    assert (a @ np.array(points[0])).shape == (3,)
    assert np.allclose(~a @ (a @ points), points, atol=1e-11)


@pytest.mark.parametrize("shape", [(4,), (4, 4), (3, 4), (2, 2, 3), ()])
def test_what_is_no_list_of_points_names_apply(shape):
    """An image of points, a matrix, a homogeneous point."""
    with pytest.raises(InvalidArgumentException, match=r"got \(.*T\.apply\(points\)"):
        Transform() @ np.ones(shape)


def test_points_come_second():
    """An array or a list on the left is an error that says so, not a matrix product."""
    for points in (np.ones(3), np.ones((2, 3)), np.eye(4), [1.0, 2.0, 3.0]):
        with pytest.raises(InvalidArgumentException, match="T @ points"):
            points @ Transform()
    with pytest.raises(TypeError):
        np.ones(3) * Transform()


@pytest.mark.parametrize("other", [2.0, [1.0, 2.0, 3.0], np.ones(3), Transform.identity()])
def test_a_star_names_the_operator(other):
    """Eigen and Sophus multiply by a star; here it says which operator does it."""
    for product in (lambda: Transform.identity() * other, lambda: other * Transform.identity()):
        with pytest.raises(TypeError, match="applied with @: T @ points"):
            product()


def test_apply_keeps_the_shape_of_an_image_of_points():
    """The points of a depth image (H, W, 3) are one call."""
    image = np.arange(24.0).reshape(2, 4, 3)
    assert np.array_equal(Transform((1, 0, 0)).apply(image), image + np.array([1, 0, 0]))
    with pytest.raises(InvalidArgumentException, match=r"^points: .*array"):
        Transform().apply([[1, 2, 3], [4, 5]])
    with pytest.raises(InvalidArgumentException, match=r"vectors: expected .* got \(2,\)"):
        Transform().rotate([1, 2])


def test_an_array_of_a_transform_is_its_matrix():
    """np.asarray and np.array take dtype and copy; a list of transforms is (N, 4, 4)."""
    a = Transform.from_rpy(0.1, 0.2, 0.3, (1, 2, 3))
    assert np.array_equal(np.asarray(a), a.as_matrix())
    assert np.asarray(a, dtype=np.float32).dtype == np.float32
    assert np.array([a, Transform()]).shape == (2, 4, 4)
    assert np.allclose(a, a @ Transform())
    with pytest.raises(ValueError, match="always a new array"):
        a.__array__(copy=False)


# Angles and quaternions


def test_degrees_are_asked_for():
    """Every angle that goes in or comes out, as scipy has it."""
    turn = Transform.from_rpy(10, -20, 90, (1, 2, 3), degrees=True)
    assert turn.is_close(Transform.from_rpy(*np.radians((10, -20, 90)), (1, 2, 3)))
    assert turn.as_rpy(degrees=True) == pytest.approx((10, -20, 90))
    assert Transform.from_euler("ZYX", (90, -20, 10), (1, 2, 3), degrees=True).is_close(turn)
    assert turn.as_euler("ZYX", degrees=True) == pytest.approx((90, -20, 10))
    assert np.allclose(turn.as_rotvec(degrees=True), np.degrees(turn.as_rotvec()))
    assert Transform.from_rotvec(turn.as_rotvec(degrees=True), turn.xyz, degrees=True).is_close(
        turn
    )
    assert Transform.from_rpy(0, 0, 90, degrees=True).as_rpy(degrees=True) == (0.0, 0.0, 90.0)


@given(transforms())
def test_both_orders_of_a_quaternion_have_a_name(a):
    """from_quat_wxyz undoes quat_wxyz, whose first is the scalar."""
    assert a.quat_wxyz.tolist() == [a.qw, a.qx, a.qy, a.qz]
    assert Transform.from_quat_wxyz(a.quat_wxyz, a.xyz) == a


def test_a_rotation_and_a_translation_make_a_transform():
    """from_matrix(R, t), and from_matrix(R) alone."""
    a = Transform.from_rpy(0.1, 0.2, 0.3, (1, 2, 3))
    rotation = a.as_matrix()[:3, :3]
    assert Transform.from_matrix(rotation, (1, 2, 3)).is_close(a)
    assert Transform.from_matrix(rotation).is_close(Transform((0, 0, 0), a.quat_xyzw))
    with pytest.raises(InvalidArgumentException, match=r"shape \(3, 3\) beside xyz, got \(4, 4\)"):
        Transform.from_matrix(a.as_matrix(), (1, 2, 3))


@given(transforms(), transforms())
def test_angle_and_distance_are_of_the_motion_between(a, b):
    """The angle is that of the rotation vector from one to the other, the distance that of the
    origins; both are the same from either side.
    """
    between = a.inverse() @ b
    assert a.angle(b) == pytest.approx(np.linalg.norm(between.as_rotvec()), abs=1e-9)
    assert a.angle(b) == pytest.approx(b.angle(a), abs=1e-12)
    assert a.angle(b, degrees=True) == math.degrees(a.angle(b))
    assert a.distance(b) == pytest.approx(np.linalg.norm(between.xyz), abs=1e-9)
    assert a.distance(a) == 0.0


def test_what_is_no_transform_is_named():
    """Also a stamped one, which has one."""
    stamped = TransformStamped(frame_id="a", child_frame_id="b", transform=Transform())
    for ask in ("distance", "angle", "is_close"):
        with pytest.raises(InvalidArgumentException, match=r"tfbus\.Transform, got None"):
            getattr(Transform(), ask)(None)
        with pytest.raises(InvalidArgumentException, match=r"its .transform is one"):
            getattr(Transform(), ask)(stamped)
    for between in ("interpolate", "interpolate_screw"):
        with pytest.raises(InvalidArgumentException, match=r"tfbus\.Transform, got int"):
            getattr(Transform(), between)(5, 0.5)
    for other in (stamped, np.ones(3), Transform()):
        with pytest.raises(InvalidArgumentException, match=r"takes its .transform"):
            stamped @ other
    with pytest.raises(InvalidArgumentException, match=r"transform: .* got ndarray"):
        TransformStamped(0, "a", "b", np.eye(4))


# Looking at

points = st.tuples(lengths, lengths, lengths)


@given(points, points, st.sampled_from([(0, 0, 1), (0, 1, 0), (0.3, -0.2, 5)]))
def test_a_robot_looks_along_x_and_a_camera_along_z(eye, target, up):
    """The axis points at the target, the upper side as near to `up` as it can, right-handed."""
    distance = math.dist(eye, target)
    ahead = np.subtract(target, eye) / (distance or 1.0)
    if distance < 1e-3 or np.linalg.norm(np.cross(ahead, up)) < 1e-2:
        return
    robot = Transform.look_at(eye, target, up)
    camera = Transform.look_at(eye, target, up, convention="camera")
    assert np.allclose(~robot @ target, (distance, 0, 0), atol=1e-9)
    assert np.allclose(~camera @ target, (0, 0, distance), atol=1e-9)
    above = robot.inverse().rotate(up)
    assert above[2] > 0 and above[1] == pytest.approx(0, abs=1e-9)
    # What is above a robot's frame is -y of a camera's, and what is left of it -x.
    optical = Transform.from_rpy(-90, 0, -90, degrees=True)
    assert camera.is_close(robot @ optical, 1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (((0, 0, 0), (0, 0, 2)), "parallel to the direction from eye to target: give another"),
        (((1, 0, 0), (1, 0, 0)), "the same point"),
        (((0, 0, 0), (1, 0, 0), (0, 0, 0)), "parallel"),
        (((0, 0), (1, 0, 0)), r"eye: expected shape \(3,\), got \(2,\)"),
        (((0, 0, 0), (math.nan, 0, 0)), "target is .* finite"),
    ],
)
def test_a_look_in_no_direction_is_refused(arguments, says):
    """Straight up with the default `up`, or at itself."""
    with pytest.raises(InvalidArgumentException, match=says):
        Transform.look_at(*arguments)
    with pytest.raises(InvalidArgumentException, match=r"'robot' .* or 'camera'"):
        Transform.look_at((0, 0, 0), (1, 0, 0), convention="opengl")


# As plain values


@given(transforms(), st.integers(-(2**62) + 1, 2**62 - 1), st.integers(0, 10**9))
def test_json_brings_values_back(a, stamp_ns, extrapolated_ns):
    """To the last bit, of a Transform and a TransformStamped."""
    stamped = TransformStamped(stamp_ns, "map", "base", a, extrapolated_ns=extrapolated_ns)
    assert Transform.from_dict(json.loads(json.dumps(a.to_dict()))) == a
    assert TransformStamped.from_dict(json.loads(json.dumps(stamped.to_dict()))) == stamped
    assert list(stamped.to_dict())[:5] == [
        "stamp_ns",
        "frame_id",
        "child_frame_id",
        "xyz",
        "quat_xyzw",
    ]


def test_json_brings_a_twist_back():
    """With its window."""
    twist = TwistStamped(5, "base", "base", "map", [1.0, 0.0, 0.0], [0.0, 0.0, 0.5], 1, 9)
    back = TwistStamped.from_dict(json.loads(json.dumps(twist.to_dict())))
    assert back.to_dict() == twist.to_dict()
    assert back.linear.tolist() == [1.0, 0.0, 0.0] and back.end_ns == 9


@pytest.mark.parametrize(
    ("kind", "values", "says"),
    [
        (Transform, {"xyz": [0, 0, 0]}, "'quat_xyzw' is missing"),
        (Transform, [1, 2], "expected a dict with xyz and quat_xyzw, got list"),
        (TransformStamped, {"frame_id": "a"}, "'child_frame_id' is missing"),
        (TwistStamped, {}, "'stamp_ns' is missing"),
    ],
)
def test_a_dict_without_a_key_is_refused(kind, values, says):
    """The key is named, and those that are expected."""
    with pytest.raises(InvalidArgumentException, match=says):
        kind.from_dict(values)


def test_a_static_transform_needs_no_stamp():
    """By name the frames and the transform are enough; what else is missing is named."""
    stamped = TransformStamped(frame_id="base", child_frame_id="lidar", transform=Transform())
    assert stamped == TransformStamped(0, "base", "lidar", Transform())
    with pytest.raises(InvalidArgumentException, match=r"^frame_id .*empty"):
        TransformStamped()
    with pytest.raises(InvalidArgumentException, match=r"transform: .* got None"):
        TransformStamped(0, "base", "lidar")


@pytest.mark.parametrize("stamp", [1.5, None, np.datetime64("2024-01-01", "us").astype(object)])
def test_a_stamp_of_another_type_is_told_of_stamp_ns(stamp):
    """Floats, datetimes: they are not rounded silently."""
    with pytest.raises(InvalidArgumentException, match=r"tfbus\.stamp_ns\("):
        TransformStamped(stamp, "base", "lidar", Transform())


@pytest.mark.parametrize("axes", ["xyz", "ZYX", "zxz"])
@given(st.tuples(*[st.floats(-170, 170)] * 3))
def test_degrees_and_angles_are_scipys(axes, degrees):
    """The same rotation of the same angles, and the same angle between two."""
    spatial = pytest.importorskip("scipy.spatial.transform", reason="needs scipy")
    ours = Transform.from_euler(axes, degrees, degrees=True)
    theirs = spatial.Rotation.from_euler(axes, degrees, degrees=True)
    assert ours.is_close(Transform.from_scipy(theirs), 1e-9)
    assert Transform().angle(ours) == pytest.approx(theirs.magnitude(), abs=1e-9)
    assert np.allclose(ours.quat_wxyz, np.roll(ours.as_scipy_rotation().as_quat(), 1))


@pytest.mark.parametrize("ratio", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("way", ["interpolate", "interpolate_screw"])
def test_a_ratio_is_finite(way, ratio):
    """Else the motion would be NaN, which no transform is."""
    for first in (Transform(), TransformArray.of([Transform()] * 2)):
        with pytest.raises(InvalidArgumentException, match=r"ratio.* finite"):
            getattr(first, way)(Transform((1.0, 2.0, 3.0)), ratio)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda one: type(one).from_euler(None, np.zeros((2, 3))), "axes must be three of|angles"),
        (lambda one: one.as_euler(None), "axes must be three of x, y, z"),
        (lambda one: type(one).from_scipy(5), "rotation: expected a Rotation .* got int"),
        (lambda one: one.is_close(one, "x"), "atol: expected a number, got str"),
        (lambda one: one.interpolate(one, "x"), "ratio: expected an? .*number"),
    ],
)
@pytest.mark.parametrize("one", [Transform(), TransformArray.of([Transform()] * 2)])
def test_arguments_of_another_type_are_named(one, call, says):
    """Of a transform as of an array of them."""
    with pytest.raises(InvalidArgumentException, match=says):
        call(one)


def test_a_zero_is_shown_without_a_sign():
    """As the inverse of the identity has them."""
    assert repr(~Transform()) == "Transform(xyz=(0, 0, 0), quat_xyzw=(0, 0, 0, 1))"


@pytest.mark.parametrize(
    ("call", "form"),
    [
        (lambda: Transform.from_rpy((0.1, 0.2, 0.3)), "(roll, pitch, yaw, (x, y, z))"),
        (lambda: Transform.from_rpy([0.1, 0.2, 0.3], (1, 2, 3)), "Transform.from_rpy(*rpy)"),
        (lambda: Transform.from_rpy(0.1, 0.2, 0.3, 1, 2, 3), "(roll, pitch, yaw, (x, y, z))"),
        (lambda: Transform.from_quat_wxyz(1, 0, 0, 0), "((w, x, y, z), (x, y, z))"),
        (lambda: Transform.from_rotvec(0, 0, 1), "((rx, ry, rz), (x, y, z))"),
    ],
)
def test_numbers_where_a_tuple_belongs_name_the_right_form(call: Any, form: str) -> None:
    """And a tuple where numbers belong."""
    with pytest.raises(TypeError) as raised:
        call()
    assert "as in Transform.from_" in str(raised.value)
    assert form in str(raised.value)


def test_a_stamped_transform_without_its_stamp_names_the_order() -> None:
    """As ROS's names come first in the head of some; a lookup does not say so of its stamp."""
    with pytest.raises(InvalidArgumentException, match=r"'world'; .*stamp comes first"):
        TransformStamped("world", "robot", Transform())
    with pytest.raises(InvalidArgumentException, match=r"not 'cam'$"):
        check_stamp("cam")


def test_numbers_where_a_transform_belongs_say_what_makes_one() -> None:
    """A tuple is none."""
    with pytest.raises(InvalidArgumentException, match=r"got tuple; Transform\(\(x, y, z\)"):
        TransformStamped(1, "world", "robot", (1, 2, 3))
