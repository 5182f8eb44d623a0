"""Robots for tests: small ones as text, and robots that others published, in the folder that
TFBUS_ROBOTS names. Not a test itself.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests import needs
from tfbus import Robot

# An arm with each kind of joint that a JointState can give, and a chain of mimics.
ARM = """
<robot name="arm">
  <link name="base"/> <link name="upper"/> <link name="lower"/> <link name="slide"/>
  <link name="tool"/> <link name="left"/> <link name="right"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/> <axis xyz="1 2 3"/>
    <limit lower="-1" upper="2" velocity="3" effort="50"/>
    <safety_controller soft_lower_limit="-0.9" soft_upper_limit="1.9" k_velocity="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/> <child link="lower"/>
    <origin xyz="0.4 0 0.3" rpy="0.1 -0.2 0.3"/> <axis xyz="0 1 0"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="lower"/> <child link="slide"/>
    <origin xyz="0.4 0 0"/> <axis xyz="0 0 2"/> <limit lower="0.1" upper="0.3"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="slide"/> <child link="tool"/> <origin xyz="0.1 0 0" rpy="0 1.5707963 0"/>
  </joint>
  <joint name="finger" type="prismatic">
    <parent link="tool"/> <child link="left"/> <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04"/> <mimic joint="elbow" multiplier="0.01" offset="0.02"/>
  </joint>
  <joint name="other_finger" type="prismatic">
    <parent link="tool"/> <child link="right"/> <axis xyz="0 1 0"/>
    <limit lower="-0.04" upper="0"/> <mimic joint="finger" multiplier="-1"/>
  </joint>
</robot>
"""

# What the joints of a hovercraft with a boom on a ball can do.
HOVERCRAFT = """
<robot name="hovercraft">
  <link name="world"/> <link name="hull"/> <link name="boom"/> <link name="tip"/>
  <joint name="over_ground" type="planar">
    <parent link="world"/> <child link="hull"/>
    <origin xyz="1 2 3" rpy="0.3 0.2 0.1"/> <axis xyz="0 0 1"/>
  </joint>
  <joint name="ball" type="floating">
    <parent link="hull"/> <child link="boom"/> <origin xyz="0 0 1" rpy="0 0.5 0"/>
  </joint>
  <joint name="swivel" type="continuous">
    <parent link="boom"/> <child link="tip"/> <origin xyz="1 0 0"/> <axis xyz="0 0 1"/>
  </joint>
</robot>
"""


def published() -> list[Path]:
    """The URDFs in the folder that TFBUS_ROBOTS names; none where it names none."""
    folder = os.environ.get("TFBUS_ROBOTS")
    if not folder:
        return []
    return sorted(path for path in Path(folder).rglob("*.urdf") if path.is_file())


def skip_without_published() -> None:
    """Skip the test that runs, where there are no published robots."""
    needs.skip("published robots", "TFBUS_ROBOTS names no folder of them, as .ci/run does")


def python_of_pinocchio() -> str:
    """A Python that has Pinocchio: that of TFBUS_ROBOTS, where it is an environment of Python."""
    python = Path(os.environ.get("TFBUS_ROBOTS", ""), "bin", "python")
    if not python.exists():
        needs.skip("Pinocchio", "TFBUS_ROBOTS names no environment with it, as .ci/run does")
    return str(python)


def random_positions(robot: Robot, count: int, seed: int = 0) -> dict[str, NDArray[Any]]:
    """Positions of all free joints, (count,) of each or as many numbers as it has."""
    random = np.random.default_rng(seed)
    positions: dict[str, NDArray[Any]] = {}
    for joint in robot.free_joints:
        size = joint.position_size
        values = random.uniform(-3.0, 3.0, (count, size))
        if joint.type == "floating":
            values[:, 3:] = random.normal(size=(count, 4))
            values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
        positions[joint.name] = values[:, 0] if size == 1 else values
    return positions


def row(positions: Mapping[str, NDArray[Any]], number: int) -> dict[str, Any]:
    """One configuration of many."""
    return {name: values[number].tolist() for name, values in positions.items()}
