"""Joint states become transforms: which, when, and of which joints."""

from typing import Any

import pytest

from tests.nodes.robots import ARM, arm
from tfbus import InvalidArgumentException, Robot, UrdfError
from tfbus.messages import JointState
from tfbus.nodes.robot.joint_frames import JointFrames

S = 1_000_000_000
MS = 1_000_000


def state(*names: str, position: float = 0.5) -> JointState:
    return JointState(0, names, tuple(position for _ in names))


def children(frames: JointFrames, given: JointState, stamp_ns: int, **how: Any) -> list[str]:
    taken = frames.take(given, stamp_ns, **how)
    assert {each.stamp_ns for each in taken} <= {stamp_ns}
    return [each.child_frame_id for each in taken]


def test_a_state_moves_its_joints_and_their_mimics() -> None:
    """The frames of the joints that a state names, and of those that mimic them, at its stamp."""
    frames = JointFrames(arm(), "left_")
    [left, right] = frames.take(state("grip", position=0.2), 7 * S)
    assert (left.frame_id, left.child_frame_id, left.stamp_ns) == ("left_lower", "left_left", 7 * S)
    assert left.transform.xyz == pytest.approx((0, 0.2, 0))
    assert right.child_frame_id == "left_right"
    assert right.transform.xyz == pytest.approx((0, 0.3, 0))


def test_a_mimic_that_is_given_has_its_own_position() -> None:
    """A position of a mimic joint itself counts, as in robot_state_publisher."""
    given = JointState(0, ("grip", "grip_right"), (0.2, 0.7))
    taken = {each.child_frame_id: each for each in JointFrames(arm()).take(given, S)}
    assert taken["right"].transform.xyz == pytest.approx((0, 0.7, 0))


def test_a_prefix_makes_frames_of_all_links() -> None:
    """Links that are too long with the prefix are refused, whichever of their joints are fixed."""
    assert JointFrames(arm(), "p" * 200).static(S)
    with pytest.raises(UrdfError, match=r"link 'base' .*prefix 'ppp"):
        JointFrames(arm(), "p" * 252)


def test_fixed_joints_are_the_static_ones() -> None:
    """Fixed joints are in the static set, and a state cannot move them."""
    frames = JointFrames(arm())
    assert [each.child_frame_id for each in frames.static(S)] == ["tool"]
    assert children(frames, state("mount"), S) == []
    assert not frames.unknown


def test_names_of_no_joint_are_ignored_and_kept() -> None:
    """Unknown names do not hinder the others, and are known afterwards."""
    frames = JointFrames(arm())
    assert children(frames, state("nose", "elbow"), S) == ["lower"]
    assert frames.unknown == {"nose"}


def test_missing_joints_are_those_that_never_came() -> None:
    """What is missing gets less with each state; mimics and fixed joints never are."""
    frames = JointFrames(arm())
    assert frames.missing == ["shoulder", "elbow", "grip"]
    frames.take(state("elbow"), S)
    assert frames.missing == ["shoulder", "grip"]


def test_the_rate_is_an_upper_limit() -> None:
    """A joint is sent again once its period has passed, by the stamps of the states."""
    frames = JointFrames(arm())
    times = [0, 30, 50, 99, 100, 149, 151]
    sent = [at for at in times if children(frames, state("elbow"), S + at * MS, period_ns=50 * MS)]
    assert sent == [0, 50, 100, 151]


def test_one_joint_that_is_due_takes_the_others_along() -> None:
    """A state is sent where one of its joints is due, so that two publishers share the rate."""
    frames = JointFrames(arm())
    period_ns = 50 * MS
    assert children(frames, state("elbow"), S, period_ns=period_ns)
    assert children(frames, state("elbow", "shoulder"), S + MS, period_ns=period_ns)
    assert not children(frames, state("elbow", "shoulder"), S + 2 * MS, period_ns=period_ns)


def test_a_state_older_than_the_last_is_left_out() -> None:
    """States that overtake each other do not move the robot back, unless stamps are ignored."""
    frames = JointFrames(arm())
    assert children(frames, state("elbow"), 5 * S)
    assert not children(frames, state("elbow"), 5 * S - 10 * MS)
    assert children(frames, state("elbow"), 5 * S - 10 * MS, ignore_stamps=True)


def test_a_time_that_begins_again_is_followed() -> None:
    """Stamps that are more than a second older are of a reset or a loop: it goes on with them."""
    frames = JointFrames(arm())
    children(frames, state("elbow"), 100 * S)
    assert children(frames, state("elbow"), 3 * S)
    assert children(frames, state("elbow"), 4 * S)
    assert frames.restarts == 1


def test_publishers_of_different_clocks_do_not_disturb_each_other() -> None:
    """The joints of two publishers whose stamps are far apart all move."""
    frames = JointFrames(arm())
    for count in range(3):
        assert children(frames, state("elbow"), 1000 * S + count * MS)
        assert children(frames, state("shoulder"), 5 * S + count * MS)
    assert frames.restarts == 0


def test_joints_without_one_number_are_named() -> None:
    """Planar and floating joints cannot come in a joint state."""
    robot = Robot.from_text(ARM.replace('type="continuous"', 'type="floating"'))
    frames = JointFrames(robot)
    assert frames.unsupported == ["elbow"]
    assert children(frames, state("elbow", "shoulder"), S) == ["upper"]


def test_a_pose_that_is_no_number_is_refused_and_the_next_state_moves_the_joint() -> None:
    """The position is finite, and so is where the joint begins, but not their sum."""
    lift = ARM.replace(
        '<parent link="lower"/><child link="left"/>',
        '<parent link="lower"/><child link="left"/><origin xyz="0 1e308 0"/>',
    )
    frames = JointFrames(Robot.from_text(lift))
    with pytest.raises(InvalidArgumentException, match="'left' further away"):
        frames.take(state("grip", position=1.7e308), S)
    assert "grip" in frames.missing
    assert children(frames, state("grip"), S) == ["left", "right"]
