"""URDF files as `tfbus view --urdf` reads them."""

from pathlib import Path

import pytest

from tfbus.nodes.viewer.urdf import Box, Cylinder, Mesh, Sphere, UrdfError, read_urdf

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
  <link name="nothing"/>
  <link name="tool">
    <visual><geometry><sphere radius="0.2"/></geometry></visual>
    <visual><geometry>
      <mesh filename="package://robot/meshes/tool.stl" scale="2 2 2"/>
    </geometry></visual>
  </link>
</robot>
"""


def read(tmp_path: Path, text: str) -> list[object]:
    """The shapes of a file with this text."""
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return [visual.shape for visual in read_urdf(path)]


def test_boxes_cylinders_spheres_and_meshes_are_read(tmp_path: Path) -> None:
    """Each with its measures in metres; a package's mesh is found below the folders above."""
    mesh = tmp_path / "robot" / "meshes" / "tool.stl"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    assert read(tmp_path, ROBOT) == [
        Box((1.0, 2.0, 3.0)),
        Cylinder(0.1, 0.5),
        Sphere(0.2),
        Mesh(mesh, (2.0, 2.0, 2.0)),
    ]


def test_a_visual_has_its_link_its_place_and_its_colour(tmp_path: Path) -> None:
    """Colours may be named at the top, and are grey where there is none."""
    (tmp_path / "robot.urdf").write_text(ROBOT)
    box, cylinder, *_ = read_urdf(tmp_path / "robot.urdf")
    assert (box.link, box.color, box.opacity) == ("base", (255, 0, 0), 0.5)
    assert box.origin.xyz.tolist() == [0.0, 0.0, 0.1]
    assert box.origin.as_rpy()[2] == pytest.approx(1.5707963)
    assert (cylinder.color, cylinder.opacity) == ((160, 160, 165), 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<robot>", "is not XML"),
        ("<sdf/>", "is no URDF: its first element is <sdf>, not <robot>"),
        (
            "<robot><link name='a'><visual><geometry><box size='1 2'/></geometry></visual></link>"
            "</robot>",
            "size of <box> is '1 2'; 3 numbers are wanted",
        ),
        (
            "<robot><link name='a'><visual/></link></robot>",
            "link 'a' has a visual without a box, cylinder, sphere or mesh",
        ),
    ],
)
def test_what_is_no_urdf_is_refused_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    """With the place of the mistake."""
    with pytest.raises(UrdfError) as caught:
        read(tmp_path, text)
    assert said in str(caught.value)


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    """By its name."""
    with pytest.raises(UrdfError, match=r"none\.urdf cannot be read: No such file"):
        read_urdf(tmp_path / "none.urdf")
