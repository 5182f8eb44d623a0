"""URDFs are read into links, joints and shapes."""

import pickle
from pathlib import Path

import pytest

from tfbus import Robot, UrdfError
from tfbus.robot.model import Box, Cylinder, Mesh, Sphere

ROBOT = """
<robot name="r">
  <material name="red"><color rgba="1 0 0 0.5"/></material>
  <link name="base">
    <visual>
      <origin xyz="0 0 0.1" rpy="0 0 1.5707963"/>
      <geometry><box size="1 2 3"/></geometry>
      <material name="red"/>
    </visual>
    <visual><geometry><cylinder radius="0.1" length="0.5"/></geometry></visual>
  </link>
  <link name="tool">
    <visual><geometry><sphere radius="0.2"/></geometry></visual>
    <visual><geometry>
      <mesh filename="package://robot/meshes/tool.stl" scale="2 2 2"/>
    </geometry></visual>
  </link>
  <joint name="fixed" type="fixed"><parent link="base"/><child link="tool"/></joint>
</robot>
"""


def test_boxes_cylinders_spheres_and_meshes_are_read(tmp_path: Path) -> None:
    """Each with its measures in metres; a package's mesh is found below the folders above."""
    mesh = tmp_path / "robot" / "meshes" / "tool.stl"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    (tmp_path / "robot.urdf").write_text(ROBOT)
    robot = Robot.from_urdf(tmp_path / "robot.urdf")
    assert [visual.shape for visual in robot.visuals] == [
        Box((1.0, 2.0, 3.0)),
        Cylinder(0.1, 0.5),
        Sphere(0.2),
        Mesh("package://robot/meshes/tool.stl", mesh, (2.0, 2.0, 2.0)),
    ]


def test_a_visual_has_its_link_its_place_and_its_colour() -> None:
    """Colours may be named at the top; without one, a mesh has its own."""
    box, cylinder, *_ = Robot.from_text(ROBOT).visuals
    assert (box.link, box.color, box.opacity) == ("base", (255, 0, 0), 0.5)
    assert box.origin.xyz.tolist() == [0.0, 0.0, 0.1]
    assert box.origin.as_rpy()[2] == pytest.approx(1.5707963)
    assert (cylinder.color, cylinder.opacity) == (None, 1.0)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """With the reason of the system."""
    with pytest.raises(UrdfError, match=r"none\.urdf: No such"):
        Robot.from_urdf(tmp_path / "none.urdf")


def test_a_robot_can_be_sent_to_another_process() -> None:
    """By pickle, as of multiprocessing."""
    robot = Robot.from_text(ROBOT)
    copy = pickle.loads(pickle.dumps(robot))
    assert repr(copy) == repr(robot) and repr(robot).startswith("<Robot 'r': 2 links")
    assert copy.links == robot.links and copy.joints == robot.joints and copy.fk() == robot.fk()
