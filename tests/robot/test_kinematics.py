"""The poses of links: laws of forward kinematics, chains, Jacobians and many configurations."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import transforms
from tests.robot.robots import ARM, HOVERCRAFT, random_positions, row
from tfbus import InvalidArgumentException, Joint, Robot, Transform, TransformArray

ROBOTS = {"arm": Robot.from_text(ARM), "hovercraft": Robot.from_text(HOVERCRAFT)}
BOTH = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
ANGLES = st.floats(-7, 7)


def urdf_of(origins: list[Transform]) -> str:
    """A chain of fixed joints with these origins, from link 0."""
    joints = []
    for number, origin in enumerate(origins):
        xyz, rpy = (" ".join(map(repr, each)) for each in (origin.xyz.tolist(), origin.as_rpy()))
        joints.append(
            f"<link name='{number + 1}'/><joint name='{number}' type='fixed'>"
            f"<parent link='{number}'/><child link='{number + 1}'/>"
            f"<origin xyz='{xyz}' rpy='{rpy}'/></joint>"
        )
    return f"<robot name='chain'><link name='0'/>{''.join(joints)}</robot>"


@given(st.lists(transforms(), min_size=1, max_size=5))
@settings(deadline=None)
def test_a_fixed_chain_is_the_product_of_its_origins(origins: list[Transform]) -> None:
    """Each link is where the origins before it, one after the other, bring it."""
    poses = Robot.from_text(urdf_of(origins)).fk()
    pose = Transform.identity()
    for number, origin in enumerate(origins):
        pose = pose @ origin
        assert poses[str(number + 1)].is_close(pose)


def test_joints_move_their_links_as_their_types_say() -> None:
    """A continuous joint turns about its axis, a prismatic one slides along it, made a unit."""
    robot = ROBOTS["arm"]
    poses = robot.fk({"shoulder": 0.5, "elbow": 0.7, "lift": 0.2})
    axis = np.array((1, 2, 3)) / math.sqrt(14)
    shoulder = robot.joints["shoulder"].origin @ Transform.from_rotvec(0.5 * axis)
    assert poses["upper"].is_close(shoulder)
    elbow = shoulder @ robot.joints["elbow"].origin @ Transform.from_rpy(0, 0.7, 0)
    assert poses["lower"].is_close(elbow)
    assert poses["slide"].is_close(elbow @ Transform((0.4, 0, 0.2)))
    assert poses["left"].is_close(poses["tool"] @ Transform((0, 0.01 * 0.7 + 0.02, 0)))
    assert poses["right"].is_close(poses["tool"] @ Transform((0, -0.01 * 0.7 - 0.02, 0)))


def test_a_planar_joint_moves_in_its_plane_and_a_floating_one_freely() -> None:
    """x, y and the angle about the normal; a floating joint's position is a transform."""
    robot = ROBOTS["hovercraft"]
    boom = Transform.from_rpy(0.1, 0.2, 0.3, (4, 5, 6))
    poses = robot.fk({"over_ground": (1, 2, 0.5), "ball": boom})
    hull = robot.joints["over_ground"].origin @ Transform.from_rpy(0, 0, 0.5, (1, 2, 0))
    assert poses["hull"].is_close(hull)
    assert poses["boom"].is_close(hull @ robot.joints["ball"].origin @ boom)


@pytest.mark.parametrize("normal", ["1 0 0", "0 -1 0", "0 0 -1", "1 2 -3"])
def test_a_planar_joint_stays_in_the_plane_across_its_axis(normal: str) -> None:
    """In whatever direction the normal points."""
    text = HOVERCRAFT.replace('<axis xyz="0 0 1"/>', f'<axis xyz="{normal}"/>', 1)
    robot = Robot.from_text(text.replace('xyz="1 2 3" rpy="0.3 0.2 0.1"', ""))
    axis = np.array([float(each) for each in normal.split()])
    pose = robot.fk({"over_ground": (3, 4, 0.5)})["hull"]
    assert pose.xyz @ axis == pytest.approx(0)
    assert np.linalg.norm(pose.xyz) == pytest.approx(5)
    assert pose.rotate(axis) == pytest.approx(axis)


@BOTH
def test_many_configurations_are_each_as_one(robot: Robot) -> None:
    """Row by row, by names and as an array; one link alone is as among all."""
    positions = random_positions(robot, 50)
    many = robot.fk_many(positions)
    array = np.column_stack([positions[joint.name] for joint in robot.free_joints])
    tip = list(robot.links)[-1]
    for number in range(50):
        one = robot.fk(row(positions, number))
        assert all(many[link][number].is_close(one[link], 1e-12) for link in robot.links)
        assert robot.fk(array[number], links=[tip])[tip].is_close(one[tip], 1e-12)
    assert robot.fk_many(array, links=[tip])[tip] == many[tip]


def test_more_configurations_than_are_worked_on_at_once_are_all_there() -> None:
    """No row is lost between two blocks; none at all is no mistake."""
    robot = ROBOTS["arm"]
    angles = np.linspace(-3, 3, 5000)
    many = robot.fk_many({"elbow": angles})["lower"]
    assert len(many) == 5000
    for number in (0, 2047, 2048, 4999):
        one = robot.fk({"elbow": angles[number]})["lower"]
        assert many[number].is_close(one, 1e-12)
    assert len(robot.fk_many({"elbow": []})["lower"]) == 0


@BOTH
def test_a_transform_between_links_is_that_of_their_poses(robot: Robot) -> None:
    """And it is the inverse of the transform the other way."""
    positions = row(random_positions(robot, 1), 0)
    poses = robot.fk(positions)
    for a in robot.links:
        for b in robot.links:
            found = robot.transform(a, b, positions)
            assert found.is_close(~poses[a] @ poses[b])
            assert found.is_close(~robot.transform(b, a, positions))


def test_a_chain_is_the_joints_on_the_way() -> None:
    """Up from one link to what carries both, then down to the other."""
    robot = ROBOTS["arm"]
    assert [joint.name for joint in robot.chain("left", "right")] == ["finger", "other_finger"]
    assert [joint.name for joint in robot.chain("base", "slide")] == ["shoulder", "elbow", "lift"]
    assert [joint.name for joint in robot.chain("slide", "base")] == ["lift", "elbow", "shoulder"]
    assert robot.chain("tool", "tool") == ()


def moved_by(robot: Robot, positions: dict[str, Any], column: int, step: float) -> dict[str, Any]:
    """The positions a small step further in the direction of one column of the Jacobian."""
    moved = dict(positions)
    for joint in robot.free_joints:
        size = min(joint.position_size, 6)
        if 0 <= column < size:
            velocity = np.eye(size)[column] * step
            if joint.type == "floating":
                before = Transform.from_pose(positions[joint.name])
                turn = Transform.from_rotvec(velocity[3:]).quat_xyzw
                turned = Transform((0, 0, 0), turn) @ Transform((0, 0, 0), before.quat_xyzw)
                moved[joint.name] = Transform(before.xyz + velocity[:3], turned.quat_xyzw)
            else:
                moved[joint.name] = (np.array(positions[joint.name]) + velocity).squeeze()
        column -= size
    return moved


@BOTH
def test_the_jacobian_is_the_difference_of_poses(robot: Robot) -> None:
    """Of each link, for each free joint, to the sixth digit; mimics count for their source."""
    positions, step = row(random_positions(robot, 1), 0), 1e-6
    for link in robot.links:
        jacobian = robot.jacobian(link, positions)
        assert jacobian.shape == (6, robot.dof)
        for column in range(robot.dof):
            before, after = (
                robot.fk(moved_by(robot, positions, column, side * step))[link] for side in (-1, 1)
            )
            turn = Transform((0, 0, 0), after.quat_xyzw) @ ~Transform((0, 0, 0), before.quat_xyzw)
            velocity = np.concatenate((after.xyz - before.xyz, turn.as_rotvec())) / (2 * step)
            assert jacobian[:, column] == pytest.approx(velocity, abs=1e-6)


def test_a_joint_rests_at_zero_or_in_the_middle_of_its_limits() -> None:
    """The middle where zero is outside of them; what is not given is there."""
    robot = ROBOTS["arm"]
    assert robot.zeros() == {"shoulder": 0.0, "elbow": 0.0, "lift": 0.2}
    assert robot.fk() == robot.fk(robot.zeros()) == robot.fk({"lift": 0.2})
    hovercraft = ROBOTS["hovercraft"]
    assert hovercraft.fk() == hovercraft.fk(hovercraft.zeros())


def lift_of(limits: str, kind: str = "prismatic") -> Joint:
    """A joint with these elements in it."""
    return Robot.from_text(
        "<robot name='r'><link name='a'/><link name='b'/>"
        f"<joint name='lift' type='{kind}'><parent link='a'/><child link='b'/>"
        f"<axis xyz='0 0 1'/>{limits}</joint></robot>"
    ).joints["lift"]


@pytest.mark.parametrize(
    ("lower", "upper", "zero", "reach"),
    [
        ("-1", "2", 0.0, (-1.0, 2.0)),
        ("1", "2", 1.5, (1.0, 2.0)),
        ("1", "inf", 1.0, (1.0, 2.0)),
        ("-0.5", "inf", 0.0, (-0.5, 1.0)),
        ("-inf", "-3", -3.0, (-4.0, -3.0)),
        ("inf", "inf", 0.0, (-1.0, 1.0)),
        ("-inf", "-inf", 0.0, (-1.0, 1.0)),
        ("1e308", "1.5e308", 1.25e308, (1e308, 1.5e308)),
        ("-1.5e308", "1.5e308", 0.0, (-1.0, 1.0)),
        ("2", "1", 0.0, (-1.0, 1.0)),
    ],
)
def test_an_infinite_limit_is_none(
    lower: str, upper: str, zero: float, reach: tuple[float, float]
) -> None:
    """Where a joint rests and how far a program moves it are finite all the same."""
    lift = lift_of(f"<limit lower='{lower}' upper='{upper}'/>")
    assert (lift.zero, lift.reach) == (zero, reach)
    turn = lift_of(f"<limit lower='{lower}' upper='{upper}'/>", "revolute")
    assert turn.zero == zero and turn.reach[0] <= turn.reach[1]


@pytest.mark.parametrize(
    ("soft", "reach"),
    [((0.5, 9.0), (0.5, 2.0)), ((-9.0, 1.5), (0.0, 1.5)), ((3.0, 4.0), (0.0, 2.0))],
)
def test_soft_limits_narrow_the_reach(
    soft: tuple[float, float], reach: tuple[float, float]
) -> None:
    """Soft limits outside of the limits are ignored."""
    lower, upper = soft
    lift = lift_of(
        "<limit lower='0' upper='2'/>"
        f"<safety_controller soft_lower_limit='{lower}' soft_upper_limit='{upper}'/>"
    )
    assert lift.reach == reach
    assert lift_of("", "continuous").reach == (-math.pi, math.pi)


def test_a_pose_that_is_no_number_is_refused() -> None:
    """Positions and origins are finite, but their sum may not be."""
    robot = Robot.from_text(
        "<robot name='r'><link name='a'/><link name='b'/>"
        "<joint name='lift' type='prismatic'><parent link='a'/><child link='b'/>"
        "<origin xyz='0 0 1e308'/><axis xyz='0 0 1'/></joint></robot>"
    )
    with pytest.raises(InvalidArgumentException, match=r"joint 'lift' at 1\.7e\+308 .*link 'b'"):
        robot.joint_transforms({"lift": 1.7e308})


def test_what_is_published_of_joints_is_the_given_ones_and_their_mimics() -> None:
    """With a prefix before the names; a mimic that is named itself does not follow."""
    robot = ROBOTS["arm"]
    edges = robot.joint_transforms({"elbow": 1.0}, "left/")
    assert [(parent, child) for parent, child, _ in edges] == [
        ("left/upper", "left/lower"),
        ("left/tool", "left/left"),
        ("left/tool", "left/right"),
    ]
    poses = robot.fk({"elbow": 1.0})
    assert all(
        (~poses[parent[5:]] @ poses[child[5:]]).is_close(pose) for parent, child, pose in edges
    )
    _, _, (_, _, finger), (_, _, other) = robot.joint_transforms(
        {"elbow": 1.0, "shoulder": 1.0, "finger": 0.04}
    )
    assert (finger.y, other.y) == pytest.approx((0.04, -0.04))
    assert robot.joint_transforms({}) == []
    assert robot.static_transforms("a/") == [("a/slide", "a/tool", robot.joints["flange"].origin)]


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        ({"shouldr": 1.0}, "the robot has no joint 'shouldr'; did you mean 'shoulder'?"),
        ({"flange": 1.0}, "joint 'flange' is fixed: it has no position"),
        ({"elbow": math.nan}, "the position of continuous joint 'elbow' must be 1 finite number"),
        ({"elbow": "1"}, "the position of continuous joint 'elbow' must be 1 finite number"),
        ({"elbow": [1.0, 2.0]}, "the position of continuous joint 'elbow' must be 1 finite number"),
        ([1.0, 2.0], "positions: expected shape (3,), got (2,)"),
        ([1.0, 2.0, math.inf], "positions must be finite"),
    ],
)
def test_positions_that_no_joint_can_have_are_refused(positions: Any, said: str) -> None:
    """With the joint, and what is allowed."""
    with pytest.raises(InvalidArgumentException) as caught:
        ROBOTS["arm"].fk(positions)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        ({"elbow": [1.0, 2.0], "lift": [0.0]}, "positions must be of one length, got 'elbow' 2"),
        ({"elbow": [[1.0]]}, "positions of joint 'elbow': expected shape (N,), got (1, 1)"),
        ({"elbow": [math.nan]}, "positions of joint 'elbow' must be finite"),
        ([[1.0, 2.0]], "positions: expected shape (N, 3), got (1, 2)"),
        ({"x": [1.0]}, "the robot has no joint 'x'; available: elbow, finger"),
    ],
)
def test_many_positions_that_do_not_fit_are_refused(positions: Any, said: str) -> None:
    """By their shapes."""
    with pytest.raises(InvalidArgumentException) as caught:
        ROBOTS["arm"].fk_many(positions)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize("ask", ["fk", "chain", "transform", "jacobian"])
def test_a_link_that_is_not_there_is_named(ask: str) -> None:
    """With the nearest name."""
    robot = ROBOTS["arm"]
    with pytest.raises(InvalidArgumentException, match=r"no link 'tol'.*'tool'"):
        if ask == "fk":
            robot.fk(links=["tol"])
        else:
            getattr(robot, ask)(*["tol"] if ask == "jacobian" else ["base", "tol"])


def test_a_number_of_numpy_is_a_position() -> None:
    """As it comes out of an array."""
    robot = ROBOTS["arm"]
    assert (
        robot.fk({"elbow": np.float32(0.5)})
        == robot.fk({"elbow": 0.5})
        == robot.fk({"elbow": np.array(0.5)})
    )
    assert robot.fk({"elbow": 1}) == robot.fk({"elbow": 1.0})


def test_a_mimic_that_would_be_infinitely_far_is_refused() -> None:
    """Its joint is where it can be, and the multiplier too large."""
    robot = Robot.from_text(ARM.replace('multiplier="0.01"', 'multiplier="1e308"'))
    said = "'finger' mimics 'elbow' .*not finite"
    with pytest.raises(InvalidArgumentException, match=said):
        robot.fk({"elbow": 3.0})
    with pytest.raises(InvalidArgumentException, match=said), np.errstate(over="ignore"):
        robot.fk_many({"elbow": [0.0, 3.0]})


def test_a_floating_joint_takes_many_transforms() -> None:
    """Or one for all; their quaternions are checked as those of any transform."""
    robot = ROBOTS["hovercraft"]
    many = TransformArray.from_rpy([(0, 0, 0.1), (0, 0, 0.2)], (1, 2, 3))
    booms = robot.fk_many({"ball": many})["boom"]
    assert booms[1].is_close(robot.fk({"ball": many[1]})["boom"])
    assert robot.fk_many({"ball": many[1], "swivel": [0, 0]})["boom"][0].is_close(booms[1])
    with pytest.raises(InvalidArgumentException, match=r"row 1: .* norm 0"):
        robot.fk_many({"ball": [(0, 0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 0, 0, 0)]})
