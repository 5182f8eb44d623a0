"""Messages moved into another frame, against formulas that share no code with the buffer."""

import math
from typing import Any

import numpy as np
import pytest

from tfbus import Buffer, Transform, TransformStamped, messages
from tfbus.base.errors import FutureExtrapolationException, InvalidArgumentException

S = 1_000_000_000
MOUNT = Transform.from_rpy(0.4, -0.7, 2.1, xyz=(1.0, -2.0, 0.5))


def still() -> Buffer:
    """A buffer in which `lidar` is mounted on `base` at all times."""
    buffer = Buffer()
    buffer.set_transform(TransformStamped(0, "base", "lidar", MOUNT), static=True)
    return buffer


def driving() -> Buffer:
    """The base drives along x at 2 m/s, and turns at 0.5 rad/s, from 100 s on."""
    buffer = still()
    for at in range(201):
        pose = Transform.from_rpy(0.0, 0.0, 0.005 * at, xyz=(0.02 * at, 0.0, 0.0))
        buffer.set_transform(TransformStamped(100 * S + at * S // 100, "odom", "base", pose))
    return buffer


def matrix(pose: messages.Pose3D) -> Any:
    """The pose as a matrix (4, 4), by the formula of Rodrigues."""
    x, y, z, w = (getattr(pose.orientation, name) for name in "xyzw")
    angle, axis = 2.0 * math.atan2(math.hypot(x, y, z), w), np.array((x, y, z))
    axis = axis / (np.linalg.norm(axis) or 1.0)
    skew = np.cross(np.eye(3), axis)
    made = np.eye(4)
    made[:3, :3] += math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew
    made[:3, 3] = pose.position.x, pose.position.y, pose.position.z
    return made


POSE = messages.Pose3D(messages.Vector3(3.0, 4.0, -1.0), messages.Quaternion(0.5, -0.5, 0.5, 0.5))


def test_a_cloud_keeps_its_other_columns() -> None:
    """Points are moved, normals turned, and all else stays, of a cloud in rows with gaps too."""
    rng = np.random.default_rng(1)
    array = np.zeros((3, 4), [*((name, "f4") for name in "xyz"), ("ring", "u2"), ("rgb", "u4")])
    for name in "xyz":
        array[name] = rng.normal(size=(3, 4))
    array["ring"] = np.arange(12).reshape(3, 4)
    whole = messages.PointCloud.from_array(7 * S, "lidar", array)
    rows = np.zeros((3, whole.row_step + 5), np.uint8)
    rows[:, :-5] = whole.data.reshape(3, -1)
    padded = messages.PointCloud(
        7 * S,
        "lidar",
        3,
        4,
        whole.fields,
        False,
        whole.point_step,
        whole.row_step + 5,
        rows.ravel(),
    )
    expected = whole.xyz() @ MOUNT.as_matrix()[:3, :3].T + MOUNT.as_matrix()[:3, 3]
    for cloud in (whole, padded):
        moved = still().transform(cloud, "base")
        assert (moved.frame_id, moved.stamp_ns, moved.height) == ("base", 7 * S, 3)
        np.testing.assert_allclose(moved.xyz(), expected, atol=1e-6)
        np.testing.assert_array_equal(moved["ring"], np.arange(12))


def test_normals_are_turned_and_not_moved() -> None:
    """They stay of length 1."""
    normals = {"normal_x": np.array([1.0]), "normal_y": np.zeros(1), "normal_z": np.zeros(1)}
    cloud = messages.PointCloud.from_xyz(S, "lidar", np.zeros((1, 3)), **normals)
    moved = still().transform(cloud, "base")
    turned = [moved[name][0] for name in normals]
    np.testing.assert_allclose(turned, MOUNT.as_matrix()[:3, 0], atol=1e-12)


def test_a_scan_of_a_driving_robot_shows_a_straight_wall() -> None:
    """Each range is placed by the pose of the robot when it was measured."""
    buffer, stamp_ns, count = driving(), 100 * S + S // 2, 200
    wall_x, increment_s = 20.0, 0.001
    angles = -0.5 + np.arange(count) / count
    ranges = []
    for at, angle in enumerate(angles):
        pose = 0.5 + increment_s * at
        heading, x = 0.5 * pose + angle, 2.0 * pose
        ranges.append((wall_x - x) / math.cos(heading))
    scan = messages.LaserScan(
        stamp_ns,
        "base",
        angle_min=-0.5,
        angle_increment=1.0 / count,
        time_increment=increment_s,
        range_max=100.0,
        ranges=np.array(ranges, np.float32),
    )
    np.testing.assert_allclose(buffer.transform(scan, "odom").xyz()[:, 0], wall_x, atol=1e-4)
    frozen = messages.LaserScan(
        stamp_ns, "base", -0.5, 0.0, 1.0 / count, range_max=100.0, ranges=scan.ranges
    )
    assert np.ptp(buffer.transform(frozen, "odom").xyz()[:, 0]) > 0.5


def test_ranges_without_a_measurement_are_no_points() -> None:
    """Among them those of range_max and of 0, which drivers write for nothing seen."""
    ranges = np.array([0.0, 0.1, 0.12, 5.0, 29.8, 29.9, 30.0, np.inf, np.nan, -1.0], np.float32)
    for range_min, points in ((0.12, [0.12, 5.0, 29.8]), (0.0, [0.1, 0.12, 5.0, 29.8])):
        scan = messages.LaserScan(0, "laser", range_min=range_min, range_max=29.9, ranges=ranges)
        x = scan.xyz()[:, 0]
        np.testing.assert_allclose(x[np.isfinite(x)], points, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("t", np.arange(5, dtype=np.uint32) * 10_000_000),
        ("time", np.arange(5, dtype=np.float32) / 100),
        ("timestamp", 100.5 + np.arange(5) / 100 + 1e9),
        ("timestamp", 1e18 + 100.5e9 + np.arange(5) * 1e7),
    ],
)
def test_points_with_times_are_each_moved_at_their_own(name: str, times: Any) -> None:
    """Whatever unit a driver writes them in; afterwards they are as of the stamp."""
    epoch_ns = 0 if name != "timestamp" else 10**18
    buffer = still()
    for at in range(201):
        stamp_ns = epoch_ns + 100 * S + at * S // 100
        pose = Transform((0.02 * at, 0.0, 0.0))
        buffer.set_transform(TransformStamped(stamp_ns, "odom", "base", pose))
    stamp_ns = epoch_ns + 100 * S + S // 2
    cloud = messages.PointCloud.from_xyz(stamp_ns, "base", np.zeros((5, 3)), **{name: times})
    moved = buffer.transform(cloud, "odom")
    np.testing.assert_allclose(moved.xyz()[:, 0], 1.0 + 0.02 * np.arange(5), atol=1e-6)
    stamps = moved.stamps_ns()
    assert stamps is not None and (abs(stamps - stamp_ns) < 300).all()
    in_base = buffer.transform(cloud, "base", fixed_frame="odom")
    np.testing.assert_allclose(in_base.xyz()[:, 0], 0.02 * np.arange(5), atol=1e-6)


def test_points_with_times_are_turned_as_the_frame_was_then() -> None:
    """About whatever axis."""
    buffer, times = Buffer(), np.arange(5)
    tilted = [Transform.from_rpy(0.3 * at, 0.5 - 0.2 * at, 0.1 * at) for at in times]
    for at, pose in zip(times.tolist(), tilted, strict=True):
        buffer.set_transform(TransformStamped((1 + at) * S, "odom", "base", pose))
    points = np.linspace(-1.0, 3.0, 15).reshape(5, 3)
    cloud = messages.PointCloud.from_xyz(S, "base", points, time=times.astype(np.float32))
    expected = [pose.apply(point) for pose, point in zip(tilted, points, strict=True)]
    np.testing.assert_allclose(buffer.transform(cloud, "odom").xyz(), expected, atol=1e-5)


def test_a_time_that_is_not_finite_makes_no_other_one_of_another_unit() -> None:
    """Seconds stay seconds beside one that is not known, which is that of the stamp."""
    columns = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", "f4")]
    rows = np.array([(1.0, 0.0, 0.0, 0.25), (2.0, 0.0, 0.0, np.inf)], columns)
    stamps = messages.PointCloud.from_array(S, "lidar", rows).stamps_ns()
    assert stamps is not None and stamps.tolist() == [S + S // 4, S]


def test_deletions_of_markers_need_no_frame() -> None:
    """They are as they were, beside markers that are moved."""
    gone = messages.Marker(0, "", action=messages.Marker.DELETEALL)
    moved = still().transform(
        messages.MarkerArray((gone, messages.Marker(S, "lidar", pose=POSE))), "base"
    )
    assert moved.markers[0] == gone
    assert moved.markers[1].frame_id == "base"


def test_poses_are_those_of_the_product_of_matrices() -> None:
    """Of every message with a pose, or with many."""
    expected = MOUNT.as_matrix() @ matrix(POSE)
    row = [3.0, 4.0, -1.0, 0.5, -0.5, 0.5, 0.5]
    with_covariance = messages.PoseWithCovariance(POSE)
    grid = messages.OccupancyGrid.from_cells(S, "lidar", np.zeros((2, 3), np.int8), 0.1, POSE)
    path = messages.Path(S, "lidar", (messages.PoseStamped(2 * S, "", POSE),))
    buffer = still()
    assert buffer.transform(path, "base").poses[0].stamp_ns == 2 * S
    found = (
        buffer.transform(messages.PoseStamped(S, "lidar", POSE), "base").pose,
        buffer.transform(messages.Marker(S, "lidar", pose=POSE), "base").pose,
        buffer.transform(messages.MarkerArray((messages.Marker(S, "lidar", pose=POSE),)), "base")
        .markers[0]
        .pose,
        buffer.transform(
            messages.PoseWithCovarianceStamped(S, "lidar", with_covariance), "base"
        ).pose.pose,
        buffer.transform(messages.Odometry(S, "lidar", "x", with_covariance), "base").pose.pose,
        buffer.transform(grid, "base").info.origin,
        buffer.transform(path, "base").poses[0].pose,
    )
    for pose in found:
        np.testing.assert_allclose(matrix(pose), expected, atol=1e-12)
    point = buffer.transform(messages.PointStamped(S, "lidar", POSE.position), "base").point
    np.testing.assert_allclose((point.x, point.y, point.z), expected[:3, 3], atol=1e-12)
    corners = messages.Polygon(np.array([row[:3]], np.float32))
    area = buffer.transform(messages.PolygonStamped(S, "lidar", corners), "base").polygon
    np.testing.assert_allclose(area.points, [expected[:3, 3]], atol=1e-6)
    moved = buffer.transform(messages.PoseArray(S, "lidar", np.array([row, row])), "base").poses
    for x, y, z, *turn in moved.tolist():
        pose = messages.Pose3D(messages.Vector3(x, y, z), messages.Quaternion(*turn))
        np.testing.assert_allclose(matrix(pose), expected, atol=1e-12)


def test_a_covariance_is_that_of_poses_that_were_drawn_by_it() -> None:
    """Drawn about the pose, moved, and measured: x, y, z and rotations about the fixed axes of the
    frame; no seed and no formula of the adjoint has a part in it.
    """
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T
    draws = rng.multivariate_normal(np.zeros(6), covariance, 50_000)
    move, mean = MOUNT.as_matrix(), matrix(POSE)
    moved_mean = move @ mean
    # A small rotation about fixed axes comes before the mean's; its vector is read off the matrix.
    positions = (mean[:3, 3] + draws[:, :3]) @ move[:3, :3].T + move[:3, 3] - moved_mean[:3, 3]
    skews = np.cross(np.eye(3)[None], draws[:, 3:][:, None, :])
    turned = move[:3, :3] @ (np.eye(3) + skews) @ mean[:3, :3] @ moved_mean[:3, :3].T
    turns = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    measured = np.cov(np.hstack((positions, turns)).T)
    message = messages.PoseWithCovarianceStamped(
        S, "lidar", messages.PoseWithCovariance(POSE, tuple(covariance.ravel()))
    )
    found = np.reshape(still().transform(message, "base").pose.covariance, (6, 6))
    np.testing.assert_allclose(found, measured, atol=0.02 * abs(covariance).max())
    np.testing.assert_allclose(np.linalg.eigvalsh(found), np.linalg.eigvalsh(covariance))


def test_an_unknown_covariance_stays_unknown() -> None:
    """All 0 stays 0, and a first -1 of an IMU stays -1, with the value that it goes with."""
    pose = messages.PoseWithCovarianceStamped(S, "lidar", messages.PoseWithCovariance(POSE))
    assert still().transform(pose, "base").pose.covariance == (0.0,) * 36
    unknown = (-1.0, *[0.0] * 8)
    imu = messages.Imu(
        S,
        "lidar",
        messages.Quaternion(0.0, 0.0, 0.0, 0.0),
        unknown,
        messages.Vector3(1.0),
        (1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0),
        messages.Vector3(z=9.81),
        unknown,
    )
    moved = still().transform(imu, "base")
    assert moved.orientation == imu.orientation
    assert moved.orientation_covariance == moved.linear_acceleration_covariance == unknown
    turn = MOUNT.as_matrix()[:3, :3]
    rate = moved.angular_velocity
    np.testing.assert_allclose((rate.x, rate.y, rate.z), turn[:, 0])
    np.testing.assert_allclose(
        np.reshape(moved.angular_velocity_covariance, (3, 3)), turn @ np.diag((1, 2, 3)) @ turn.T
    )


def test_an_imu_turns_with_its_frame() -> None:
    """Gravity in the world is the same, seen from the sensor or from the base."""
    imu = messages.Imu(S, "lidar", POSE.orientation, linear_acceleration=messages.Vector3(1, 2, 3))
    moved = still().transform(imu, "base")
    in_world = []
    for each in (imu, moved):
        turn = matrix(messages.Pose3D(orientation=each.orientation))[:3, :3]
        acceleration = each.linear_acceleration
        in_world.append(turn @ (acceleration.x, acceleration.y, acceleration.z))
    np.testing.assert_allclose(*in_world)


def test_what_cannot_be_moved_says_why() -> None:
    """A type without a place, a message without a frame, and a time that is not known."""
    with pytest.raises(InvalidArgumentException, match="a Log cannot be"):
        still().transform(messages.Log(S), "base")
    with pytest.raises(InvalidArgumentException, match="no frame_id"):
        still().transform(messages.PoseStamped(S, ""), "base")
    cloud = messages.PointCloud.from_xyz(
        102 * S, "base", np.zeros((2, 3)), time=np.array([-1.0, 0.5])
    )
    with pytest.raises(FutureExtrapolationException):
        driving().transform(cloud, "odom")
    no_points = messages.PointCloud(S, "base", fields=(messages.PointField("x"),), point_step=4)
    with pytest.raises(InvalidArgumentException, match="lacks y, z"):
        driving().transform(no_points, "base")


def test_a_stamp_of_0_is_the_latest_time() -> None:
    """As in ROS; the answer says which that was."""
    moved = driving().transform(messages.PoseStamped(0, "base"), "odom")
    assert moved.stamp_ns == 102 * S
    assert moved.pose.position.x == pytest.approx(4.0)
