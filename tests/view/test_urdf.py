"""URDF files as `tfbus view --urdf` reads them, and the meshes that they name."""

from pathlib import Path

import pytest

from tfbus.view.model.urdf import Box, Cylinder, Mesh, Sphere, UrdfError, mesh_file, read_urdf

# A corner of a box: a triangle 1 m wide and 2 m high.
TRIANGLE = """
solid corner
 facet normal 0 0 1
  outer loop
   vertex 0 0 0
   vertex 1 0 0
   vertex 0 2 0
  endloop
 endfacet
endsolid
"""

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
        Mesh("package://robot/meshes/tool.stl", mesh, (2.0, 2.0, 2.0)),
    ]


def test_a_visual_has_its_link_its_place_and_its_colour(tmp_path: Path) -> None:
    """Colours may be named at the top; without one, a mesh has its own."""
    (tmp_path / "robot.urdf").write_text(ROBOT)
    box, cylinder, *_ = read_urdf(tmp_path / "robot.urdf")
    assert (box.link, box.color, box.opacity) == ("base", (255, 0, 0), 0.5)
    assert box.origin.xyz.tolist() == [0.0, 0.0, 0.1]
    assert box.origin.as_rpy()[2] == pytest.approx(1.5707963)
    assert (cylinder.color, cylinder.opacity) == (None, 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<robot>", "is not XML"),
        ("<sdf/>", "is not a URDF: its root element is <sdf>, not <robot>"),
        (
            "<robot><link name='a'><visual><geometry><box size='1 2'/></geometry></visual></link>"
            "</robot>",
            "size of <box> must be 3 numbers, got '1 2'",
        ),
        (
            "<robot><link name='a'><visual/></link></robot>",
            "link 'a' has a visual without a box, cylinder, sphere or mesh",
        ),
    ],
)
def test_what_is_no_urdf_is_refused_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    """It names the place of the mistake."""
    with pytest.raises(UrdfError) as caught:
        read(tmp_path, text)
    assert said in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """With the reason of the system."""
    with pytest.raises(UrdfError, match=r"cannot read .*none\.urdf: No such file"):
        read_urdf(tmp_path / "none.urdf")


def test_packages_are_searched_in_given_folders_then_by_ros_then_above_the_urdf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder with the package's name, or in the package's folder itself."""
    places = {name: tmp_path / name for name in ("given", "ros", "above/urdf")}
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(places["ros"]))
    above = tmp_path / "above" / "arm" / "tool.stl"
    by_ros, given = places["ros"] / "arm" / "tool.stl", places["given"] / "tool.stl"

    def found() -> Path:
        return mesh_file("package://arm/tool.stl", places["above/urdf"], [places["given"]])

    for file in (above, by_ros):
        file.parent.mkdir(parents=True)
        file.touch()
        assert found() == file
    assert mesh_file("tool.stl", places["given"]) == given
    assert mesh_file(f"file://{given}", places["ros"]) == given


def test_a_mesh_is_read_and_scaled(tmp_path: Path) -> None:
    """In metres, each side by its own factor."""
    robot_scene = pytest.importorskip("tfbus.view.scene.robot", reason="needs viser")
    file = tmp_path / "corner.stl"
    file.write_text(TRIANGLE)
    mesh = robot_scene.load_mesh(Mesh("corner.stl", file, (2.0, 0.5, 1.0)))
    assert mesh.extents.tolist() == [2.0, 1.0, 0.0]


def test_a_mesh_of_collada_is_read_in_its_unit(tmp_path: Path) -> None:
    """With pycollada installed, centimetres become metres."""
    pytest.importorskip("collada", reason="needs pycollada")
    robot_scene = pytest.importorskip("tfbus.view.scene.robot", reason="needs viser")
    trimesh = pytest.importorskip("trimesh", reason="needs trimesh")
    box = trimesh.exchange.dae.export_collada(trimesh.creation.box((100.0, 200.0, 300.0)))
    file = tmp_path / "box.dae"
    file.write_bytes(box.replace(b"<asset>", b'<asset><unit name="cm" meter="0.01"/>', 1))
    mesh = robot_scene.load_mesh(Mesh("box.dae", file, (1.0, 1.0, 1.0)))
    assert mesh.extents.tolist() == pytest.approx([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.stl", r"no file .*none\.stl$"),
        ("package://arm/none.stl", "--package-path names the folder with package 'arm'"),
        ("robot.blend", "no installed package reads robot.blend"),
    ],
)
def test_a_mesh_that_cannot_be_shown_says_why(tmp_path: Path, name: str, said: str) -> None:
    """In one sentence that says what to do."""
    robot_scene = pytest.importorskip("tfbus.view.scene.robot", reason="needs viser")
    (tmp_path / "robot.blend").touch()
    with pytest.raises(UrdfError, match=said):
        robot_scene.load_mesh(Mesh(name, mesh_file(name, tmp_path), (1.0, 1.0, 1.0)))
