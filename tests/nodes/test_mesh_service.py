"""Meshes for other machines: the files that are sent, in parts, and refused ones."""

from pathlib import Path

import pytest

from tfbus import Robot, ServiceError
from tfbus.messages import RobotMesh
from tfbus.nodes.robot.mesh_service import PART_BYTES, serve_mesh

SKINS = ("textures/skin.png", "textures/skin.gif", "textures/skin.webp")
HAND = "package://arm/meshes/hand.dae"


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    """A robot with a mesh in a package; files lie in it and beside it."""
    package = tmp_path / "arm"
    for name in ("meshes/hand.dae", "meshes/hand.png", "secret.txt", *SKINS):
        file = package / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(name.encode())
    (tmp_path / "outside.png").write_bytes(b"outside")
    (package / "meshes/big.stl").write_bytes(bytes(range(256)) * 10_000)
    meshes = "".join(
        f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
        for name in (HAND, "package://arm/meshes/big.stl", "package://arm/meshes/gone.stl")
    )
    text = f'<robot name="r"><link name="a">{meshes}</link></robot>'
    return Robot.from_text(text, package_path=[tmp_path])


def read(robot: Robot, name: str) -> bytes:
    """The whole file, as a viewer reads it."""
    data = b""
    while True:
        part = serve_mesh(robot, RobotMesh.Request(name, len(data)))
        assert len(part.data) <= PART_BYTES
        data += part.data
        if len(data) >= part.size:
            return data


def test_a_mesh_comes_whole(robot: Robot) -> None:
    """A large mesh comes in parts that make the file."""
    assert read(robot, HAND) == b"meshes/hand.dae"
    assert read(robot, "package://arm/meshes/big.stl") == bytes(range(256)) * 10_000


@pytest.mark.parametrize(
    "name",
    [
        "package://arm/meshes/hand.png",
        "package://arm/textures/skin.png",
        "package://arm/textures/skin.webp",
        "model://arm/textures/skin.gif",
    ],
)
def test_what_belongs_to_a_mesh_comes_too(robot: Robot, name: str) -> None:
    """Textures and materials in the package of a mesh are sent."""
    assert read(robot, name).decode() in name


@pytest.mark.parametrize(
    "name",
    [
        "package://arm/secret.txt",
        "package://arm/../outside.png",
        "package://arm/meshes/../../outside.png",
        "../outside.png",
        "/etc/passwd",
        "file:///etc/passwd",
        "package://other/meshes/hand.png",
        "package://arm/meshes/none.png",
        "model://arm/../outside.png",
        "",
        "\0.png",
    ],
)
def test_nothing_else_does(robot: Robot, name: str) -> None:
    """A file that the description does not name, or outside of its package, is refused."""
    with pytest.raises(ServiceError, match="'r' names no mesh"):
        serve_mesh(robot, RobotMesh.Request(name))


def test_a_file_that_is_gone_says_so(robot: Robot) -> None:
    """A mesh without its file is refused with the reason."""
    with pytest.raises(ServiceError, match=r"mesh .*gone\.stl'; .* --pack"):
        serve_mesh(robot, RobotMesh.Request("package://arm/meshes/gone.stl"))


def test_a_change_has_another_version(robot: Robot, tmp_path: Path) -> None:
    """A mesh that is written again between two parts is noticed."""
    before = serve_mesh(robot, RobotMesh.Request(HAND)).version
    (tmp_path / "arm/meshes/hand.dae").write_bytes(b"another")
    assert serve_mesh(robot, RobotMesh.Request(HAND)).version != before
