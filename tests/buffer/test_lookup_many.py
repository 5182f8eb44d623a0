"""Many stamps in one call, and velocities."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tfbus.base.errors import (
    ConnectivityException,
    FutureExtrapolationException,
    InvalidArgumentException,
    LookupException,
    NoDataException,
    TransformException,
)
from tfbus.buffer import trajectories
from tfbus.buffer.buffer import COMPILED, Buffer
from tfbus.geometry.batch_lookup import by_time
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import Transform, TransformStamped

S = 1_000_000_000


def arm(seconds: float = 2.0) -> Buffer:
    """Three dynamic edges at 100 Hz, world to hand."""
    buffer = Buffer(100.0)
    for i in range(round(seconds * 100) + 1):
        for edge, (parent, child) in enumerate(
            (("world", "robot"), ("robot", "arm"), ("arm", "hand"))
        ):
            angle = 0.03 * i * (edge + 1)
            pose = Transform.from_rpy(0.1 * edge, 0.02 * i, angle, (math.sin(angle), 0.1, 0.01 * i))
            buffer.set_transform(TransformStamped(i * S // 100, parent, child, pose))
    return buffer


def test_a_call_without_a_timeout_does_not_advise_one():
    """It says when to ask again, and of many stamps how to get those that are known."""
    buffer = arm()
    points, later = np.zeros((1, 3)), 3 * S
    for call in (
        lambda: buffer.lookup_transforms("world", "robot", [later]),
        lambda: trajectories.trajectory(buffer, "world", "robot", [later]),
        lambda: buffer.transform_points(points, "world", "robot", [later]),
        lambda: buffer.transform_points(points, "world", "robot", later),
        lambda: buffer.lookup_twist("robot", "world", later),
    ):
        with pytest.raises(FutureExtrapolationException, match="again in about 1 s") as e:
            call()
        assert "timeout_s" not in str(e.value)
    with pytest.raises(FutureExtrapolationException, match="lookup_known_transforms"):
        buffer.lookup_transforms("world", "robot", [0, later])


def test_a_time_of_the_target_needs_a_fixed_frame():
    """Without one it would have no effect."""
    with pytest.raises(InvalidArgumentException, match="needs fixed_frame"):
        arm().transform_points([[0, 0, 0]], "world", "hand", S, target_stamp_ns=2 * S)


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        ([1.5], r"got float64 of \(1,\); tfbus\.stamp_ns"),
        (np.array(["2024-01-01"], "datetime64[ns]"), r"tfbus\.stamp_ns\(\.\.\.\) converts"),
        (5, "for one stamp there is lookup_transform"),
    ],
)
def test_stamps_of_another_form_are_told_of_the_call_that_takes_them(stamps, says):
    """Seconds and times of the converter, one stamp of the lookup of one."""
    with pytest.raises(InvalidArgumentException, match=says):
        arm().lookup_transforms("world", "hand", stamps)


@pytest.mark.parametrize("ends", [("world", "hand"), ("hand", "world"), ("arm", "robot")])
def test_many_lookups_are_the_lookups_one_by_one(ends):
    """Row i is what lookup_transform answers for stamp i, in any order of the stamps."""
    buffer = arm()
    stamps = np.random.default_rng(1).integers(0, 2 * S, 700)
    many = buffer.lookup_transforms(*ends, stamps)
    for stamp, transform in zip(stamps, many, strict=True):
        one = buffer.lookup_transform(*ends, stamp).transform
        assert one.is_close(transform, 1e-14)


@pytest.mark.parametrize(
    "sampling", [Sampling(), Sampling("screw"), Sampling("nearest", tolerance_s=0.02)]
)
@pytest.mark.parametrize("most", [S, 2**62])
@pytest.mark.parametrize("is_moved", [False, True])
def test_the_order_of_many_stamps_is_of_no_account(sampling, most, is_moved):
    """Thousands of stamps in any order have the rows that they have sorted, to the last bit; also
    where a frame had another parent before.
    """
    buffer = arm(1.0)
    if is_moved:
        buffer.set_transform(TransformStamped(S, "robot", "hand", Transform((1.0, 2.0, 3.0))))
    rng = np.random.default_rng(1)
    # Some lie outside of what is known, some at the ends of time.
    stamps = np.concatenate([rng.integers(-S // 9, S + S // 9, 4_000), [-most, most, S, S]])
    order = rng.permutation(len(stamps))
    in_order = np.sort(stamps)
    many, known = buffer.lookup_known_transforms("world", "hand", in_order, sampling=sampling)
    mixed, known_mixed = buffer.lookup_known_transforms(
        "world", "hand", in_order[order], sampling=sampling
    )
    assert known_mixed.tolist() == known[order].tolist()
    assert np.array_equal(mixed.xyz, many.xyz[order], equal_nan=True)
    assert np.array_equal(mixed.quat_xyzw, many.quat_xyzw[order], equal_nan=True)


stamps_of_any_time = st.integers(-(2**63), 2**63 - 1)
stamps_of_one_double = st.integers(2**62, 2**62 + 9)


@given(
    arrays(np.int64, st.integers(1024, 3000), elements=stamps_of_any_time | stamps_of_one_double)
)
@example(np.array([2**62 + 1, 2**62] * 1000))
@example(np.array([2**63 - 1, -(2**63)] * 1000))
@example(np.array([72057594037927900] + [9905883077579894] * 1999))
def test_rows_are_put_into_about_the_order_of_their_times(stamps):
    """Each row is there once, and near times are near each other, whatever the times are."""
    rows = by_time(stamps)
    if len(rows) == 0:
        assert (stamps[1:] >= stamps[:-1]).all()
        return
    assert sorted(rows.tolist()) == list(range(len(stamps)))
    ordered = stamps[rows].astype(float)
    # With at least this many buckets none is longer than that, except for rounding.
    bucket = (ordered.max() - ordered.min()) / (len(stamps) // 8 - 1)
    assert (np.maximum.accumulate(ordered) - ordered <= bucket * 1.001 + 2048).all()


def test_the_arrays_know_matrices_inverses_and_points():
    """Each row does what its transform does alone."""
    buffer = arm()
    many = buffer.lookup_transforms("world", "hand", np.arange(0, S, S // 7))
    points = np.random.default_rng(1).normal(size=(len(many), 3))
    for i, (one, point) in enumerate(zip(many, points, strict=True)):
        assert np.allclose(many.as_matrix()[i], one.as_matrix())
        assert np.allclose(many.apply(points)[i], one.apply(point))
        assert np.allclose(many.inverse().apply(points)[i], one.inverse().apply(point))


def test_one_stamp_out_of_range_fails_all_of_them():
    """Unless the caller asks for the known ones, and a mask of which they are."""
    buffer = arm(1.0)
    stamps = np.array([0, S // 2, S + 1])
    with pytest.raises(FutureExtrapolationException) as caught:
        buffer.lookup_transforms("world", "hand", stamps)
    assert caught.value.requested_ns == S + 1
    many, known = buffer.lookup_known_transforms("world", "hand", stamps)
    assert known.tolist() == [True, True, False]
    assert np.isnan(many.xyz[2]).all() and np.isfinite(many.xyz[:2]).all()


def test_no_stamps_are_answered_with_no_rows():
    """An empty question has an empty answer; the frames are checked all the same."""
    buffer = arm(0.1)
    none = buffer.lookup_transforms("world", "hand", [])
    assert (len(none), none.xyz.shape, none.quat_xyzw.shape) == (0, (0, 3), (0, 4))
    with pytest.raises(LookupException):
        buffer.lookup_transforms("world", "nobody", [1, 2])
    buffer.set_transform(TransformStamped(1, "moon", "rover", Transform()))
    with pytest.raises(ConnectivityException):
        buffer.lookup_known_transforms("world", "rover", [1, 2])


def test_stamps_of_another_type_or_shape_are_refused():
    """Stamps are integers (N,)."""
    buffer = arm(0.1)
    for stamps in ([0.5], [[1, 2]], 3):
        with pytest.raises(InvalidArgumentException):
            buffer.lookup_transforms("world", "hand", stamps)


def test_sampling_holds_for_many_as_for_one():
    """Screw, nearest and extrapolation answer the same in a batch."""
    buffer = arm(1.0)
    for sampling, stamps in (
        (Sampling("screw"), np.arange(0, S, S // 33)),
        (Sampling("nearest", tolerance_s=0.01), np.arange(0, S, S // 33)),
        (Sampling(extrapolation_s=0.1), np.arange(S - S // 20, S + S // 20, S // 99)),
    ):
        many = buffer.lookup_transforms("world", "hand", stamps, sampling=sampling)
        for stamp, transform in zip(stamps, many, strict=True):
            one = buffer.lookup_transform("world", "hand", stamp, sampling=sampling).transform
            assert one.is_close(transform, 1e-14)


def test_a_scan_is_undistorted_in_one_call():
    """Points of a wall, each measured at its own time by a moving lidar, lie on the wall again."""
    buffer = Buffer()
    for i in range(11):
        pose = Transform.from_rpy(0, 0, 0.05 * i, (0.2 * i, 0, 0))
        buffer.set_transform(TransformStamped(i * S // 10, "odom", "lidar", pose))
    stamps = np.arange(0, S + 1, S // 10)
    wall = np.column_stack((np.full(11, 5.0), np.linspace(-3, 3, 11), np.zeros(11)))
    seen = np.array(
        [
            buffer.lookup_transform("lidar", "odom", stamp).transform.apply(point)
            for stamp, point in zip(stamps, wall, strict=True)
        ]
    )
    assert np.allclose(buffer.transform_points(seen, "odom", "lidar", stamps), wall)
    at_end = buffer.transform_points(
        seen, "lidar", "lidar", stamps, target_stamp_ns=S, fixed_frame="odom"
    )
    back = buffer.lookup_transform("lidar", "odom", S).transform
    assert np.allclose(at_end, back.apply(wall))
    one = buffer.lookup_transform("odom", "lidar", S).transform
    assert np.allclose(buffer.transform_points(seen, "odom", "lidar", S), one.apply(seen))
    with pytest.raises(InvalidArgumentException, match="10 stamps"):
        buffer.transform_points(seen, "odom", "lidar", stamps[:10])


def screw(twist: tuple[float, ...], start: Transform, rate_hz: int = 50) -> Buffer:
    """A frame that moves at a constant twist (as seen in itself) for a second."""
    buffer = Buffer()
    for i in range(rate_hz + 1):
        pose = start @ Transform.exp(np.array(twist) * i / rate_hz)
        buffer.set_transform(TransformStamped(i * S // rate_hz, "world", "robot", pose))
    return buffer


@pytest.mark.skipif(not COMPILED, reason="interpreted, pairs are reported after their answers")
@pytest.mark.parametrize(
    ("forget", "error"),
    [
        (lambda buffer: buffer.clear(), NoDataException),
        (lambda buffer: buffer.remove("robot"), LookupException),
    ],
)
def test_a_frame_that_is_forgotten_meanwhile_has_no_twist(
    forget: Any, error: type[TransformException]
):
    """As another thread may clear the buffer: it does not stand still."""
    buffer = screw((1.0, 0, 0, 0, 0, 0.5), Transform())
    # Called between the two lookups that a twist begins with.
    end = buffer.watch_questions(lambda target, source: target == source and forget(buffer))
    with pytest.raises(error):
        buffer.lookup_twist("robot", "world", S // 2)
    end()


def test_the_twist_on_a_circle():
    """At 2 m and 0.5 rad/s a frame on a circle goes at 1 m/s, at right angles to the centre."""
    start = Transform.from_rpy(0, 0, math.pi / 2, (2, 0, 0))
    buffer = screw((1.0, 0, 0, 0, 0, 0.5), start)
    for stamp in (S // 4, S // 2, S):
        twist = buffer.lookup_twist("robot", "world", stamp)
        angle = 0.5 * stamp / S
        expected = (-math.sin(angle), math.cos(angle), 0)
        assert np.allclose(twist.linear, expected, atol=1e-4)
        assert np.allclose(twist.angular, (0, 0, 0.5), atol=1e-9)
        own = buffer.lookup_twist("robot", "world", stamp, observation_frame="robot")
        assert np.allclose(own.linear, (1, 0, 0), atol=1e-9)
        assert (own.frame_id, own.child_frame_id) == ("robot", "robot")


def test_the_twist_of_a_screw_in_every_frame():
    """Along a screw the twist is exact in its own axes, at any time and after any start."""
    twist = (0.3, -0.2, 0.5, 0.4, 0.7, -0.3)
    start = Transform.from_rpy(0.4, -0.7, 2.0, (3, -1, 2))
    buffer = screw(twist, start)
    for stamp in (0, S // 2, S):
        own = buffer.lookup_twist("robot", "world", stamp, observation_frame="robot")
        assert np.allclose(np.concatenate((own.linear, own.angular)), twist, atol=1e-9)
        turn = start @ Transform.exp(np.array(twist) * stamp / S)
        outside = buffer.lookup_twist("robot", "world", stamp)
        assert np.allclose(outside.linear, turn.rotate(twist[:3]), atol=1e-9)
        assert np.allclose(outside.angular, turn.rotate(twist[3:]), atol=1e-9)


def test_a_static_frame_stands_still():
    """Its twist is zero; with one sample alone there is none."""
    buffer = Buffer()
    buffer.set_transform(TransformStamped(0, "world", "post", Transform()), static=True)
    twist = buffer.lookup_twist("post", "world")
    assert not twist.linear.any() and not twist.angular.any()
    buffer.set_transform(TransformStamped(0, "world", "robot", Transform()))
    with pytest.raises(Exception, match="velocity"):
        buffer.lookup_twist("robot", "world")
