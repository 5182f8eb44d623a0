"""`tfbus robot_state` against ROS's own robot_state_publisher, both as processes."""

import json
import os
import random
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from tests import needs
from tests.buses import eventually
from tests.live_bus import Bus
from tests.tf2 import ros_robot_frames
from tfbus import Buffer, TransformListener
from tfbus.messages import JointState

pytestmark = pytest.mark.real

ROBOT = """
<robot name="all_kinds">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <link name="e"/><link name="f"/><link name="g"/>
  <joint name="turns" type="revolute">
    <parent link="base"/><child link="a"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="spins" type="continuous">
    <parent link="a"/><child link="b"/>
    <origin xyz="0.2 0 0" rpy="0 0 1.5"/><axis xyz="1 2 3"/>
  </joint>
  <joint name="slides" type="prismatic">
    <parent link="b"/><child link="c"/>
    <origin xyz="0 0 1" rpy="3.0 0 0"/><axis xyz="0 3 -4"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="mirrors" type="prismatic">
    <parent link="b"/><child link="d"/>
    <axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
    <mimic joint="slides" multiplier="-0.5" offset="0.001"/>
  </joint>
  <joint name="bolted" type="fixed">
    <parent link="d"/><child link="e"/><origin xyz="0 0.1 0" rpy="0.1 0.2 0.3"/>
  </joint>
  <joint name="default_axis" type="revolute">
    <parent link="e"/><child link="f"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="fixed_too" type="fixed"><parent link="base"/><child link="g"/></joint>
</robot>
"""
JOINTS = ("turns", "spins", "slides", "default_axis")


def states() -> list[JointState]:
    """Random positions 0.1 s apart, up to now; unknown joints among them."""
    source = random.Random(7)
    now_ns = time.time_ns()
    found = []
    for count in range(30):
        names = (*JOINTS, "of_another_robot") if count % 3 else JOINTS[:2]
        positions = tuple(source.uniform(-2, 2) for _ in names)
        found.append(JointState(now_ns - (30 - count) * 100_000_000, names, positions))
    return found


def of_ros(given: list[JointState]) -> dict[str, Any]:
    """The transforms of ROS's robot_state_publisher."""
    python = needs.python_of_tf2(messages=True)
    if not Path(ros_robot_frames.PUBLISHER).exists():
        needs.skip("robot_state_publisher", "apt-get install ros-robot-state-publisher")
    needs.program("rosmaster")
    asked = {
        "urdf": ROBOT,
        "states": [
            {"stamp_ns": each.stamp_ns, "names": each.name, "positions": each.position}
            for each in given
        ],
    }
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [python, ros_robot_frames.__file__],
        input=json.dumps(asked),
        env=env,
        capture_output=True,
        text=True,
        timeout=180,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_it_publishes_the_same_transforms(bus: Bus, tmp_path: Path) -> None:
    """For the same robot and joint states both publish the same transforms, static and dynamic."""
    given = states()
    theirs = of_ros(given)
    path = tmp_path / "robot.urdf"
    path.write_text(ROBOT)
    bus.start("robot_state", str(path)).wait_for_line("Publishing all_kinds")
    node = bus.node("asks")
    buffer = Buffer(cache_time_s=60.0)
    TransformListener(buffer, node)
    publisher = node.create_publisher(JointState, "joint_states")
    expected = {
        (child, int(stamp)): (parent, numbers)
        for stamp, rows in theirs["dynamic"].items()
        for parent, child, *numbers in rows
    }
    assert {child for child, _ in expected} == {"a", "b", "c", "d", "f"}

    def has_first() -> bool:
        publisher.publish(given[0])
        return buffer.can_transform("base", "a", given[0].stamp_ns)

    eventually(has_first)
    for state in given[1:]:
        publisher.publish(state)
        last = "f" if "slides" in state.name else "b"
        parent = expected[last, state.stamp_ns][0]
        eventually(
            lambda parent=parent, last=last, state=state: buffer.can_transform(
                parent, last, state.stamp_ns
            )
        )
    for (child, stamp_ns), (parent, numbers) in expected.items():
        ours = buffer.lookup_transform(parent, child, stamp_ns).transform
        assert close([*ours.xyz, *ours.quat_xyzw], numbers), (child, stamp_ns)
    for parent, child, *numbers in theirs["static"]:
        ours = buffer.lookup_transform(parent, child, 0).transform
        assert close([*ours.xyz, *ours.quat_xyzw], numbers), child


def close(ours: list[float], theirs: list[float]) -> bool:
    """Whether two poses are the same; both signs of a quaternion are."""
    signs = (1.0, -1.0)
    return any(
        all(
            abs(a - (b if at < 3 else sign * b)) < 1e-9
            for at, (a, b) in enumerate(zip(ours, theirs, strict=True))
        )
        for sign in signs
    )
