"""Finds where a camera sits on a robot's arm, and publishes it as a static frame (hand-eye).

    python examples/hand_eye.py

The arm holds still at 15 places. At each, its joints give the pose of the hand, and the camera
sees a marker that stays where it is. Here both are simulated, with the noise of a good detector;
marker_in_world.py shows how a real camera finds a marker. `tfbus echo hand camera_found` prints
the result as long as the program runs; beside `tfbus launch robot view:=false`, which is an arm,
`tfbus view` shows it. Ctrl-C ends it.

Source: F. C. Park and B. J. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean
group", IEEE Transactions on Robotics and Automation 10 (5), 1994.
"""

from importlib.resources import files
from itertools import combinations

import numpy as np

from tfbus import Node, Robot, StaticTransformBroadcaster, Transform, TransformStamped


def solve(hands: list[Transform], markers: list[Transform]) -> Transform:
    """Where the camera is in the hand, of poses of the hand in the base, and of the marker in the
    camera. It takes three or more, turned about axes that are not parallel.
    """
    # The marker stays: hand_i X marker_i = hand_j X marker_j. So A X = X B for each pair.
    pairs = list(combinations(range(len(hands)), 2))
    a = [hands[j].inverse() @ hands[i] for i, j in pairs]
    b = [markers[j] @ markers[i].inverse() for i, j in pairs]
    # X turns the axis of each B onto that of its A: the nearest rotation, by an SVD.
    turns_a = np.array([x.as_rotvec() for x in a])
    turns_b = np.array([x.as_rotvec() for x in b])
    u, _, vt = np.linalg.svd(turns_b.T @ turns_a)
    handed = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    turn = Transform.from_matrix(vt.T @ handed @ u.T)
    # (R_A - 1) t_X = R_X t_B - t_A, in least squares.
    left = np.concatenate([x.as_matrix()[:3, :3] - np.eye(3) for x in a])
    right = np.concatenate([turn.apply(y.xyz) - x.xyz for x, y in zip(a, b, strict=True)])
    return Transform(np.linalg.lstsq(left, right)[0], turn.quat_xyzw)


def measure(robot: Robot, camera: Transform) -> tuple[list[Transform], list[Transform]]:
    """Poses of the hand in the base, and of the marker in the camera: 1 mm and 0.1 degrees off."""
    random = np.random.default_rng(7)
    base_from_marker = Transform.from_rpy(0.1, 0.2, 0.3, xyz=(0.7, 0.1, 0.2))
    hands, markers = [], []
    for _ in range(15):
        joints = np.array([0.0, 0.4, 1.2, 0.6, 0.0, 0.0]) + random.uniform(-0.5, 0.5, 6)
        hands.append(robot.transform("base_link", "hand", joints))
        noise = Transform.from_rotvec(random.normal(0, 0.0017, 3), xyz=random.normal(0, 0.001, 3))
        markers.append((hands[-1] @ camera).inverse() @ base_from_marker @ noise)
    return hands, markers


def main() -> None:
    robot = Robot.from_text(files("tfbus.configs").joinpath("arm.urdf").read_text())
    drawn = robot.transform("hand", "camera")
    true = drawn @ Transform.from_rpy(2, -3, 4, degrees=True, xyz=(0.004, -0.003, 0.006))
    hands, markers = measure(robot, true)
    found = solve(hands, markers)

    seen = np.array([(h @ found @ m).xyz for h, m in zip(hands, markers, strict=True)])
    print(f"seen from the base, the marker stays within {1000 * np.ptp(seen, axis=0).max():.1f} mm")
    for name, camera in (("of the URDF", drawn), ("found", found)):
        away_mm = 1000 * camera.distance(true)
        print(f"{name}: {away_mm:.1f} mm and {camera.angle(true, degrees=True):.2f} degrees off")

    with Node.from_args("hand_eye") as node:
        mount = TransformStamped(node.now_ns(), "hand", "camera_found", found)
        StaticTransformBroadcaster(node).send_transform(mount)
        node.spin()


if __name__ == "__main__":
    main()
