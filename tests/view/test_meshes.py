"""The meshes that a URDF names, as `tfbus view` reads them."""

from pathlib import Path

import pytest

from tfbus import UrdfError
from tfbus.robot.mesh_files import MeshFiles
from tfbus.robot.model import Mesh

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
        robot_scene.load_mesh(Mesh(name, MeshFiles(tmp_path).find(name), (1.0, 1.0, 1.0)))
