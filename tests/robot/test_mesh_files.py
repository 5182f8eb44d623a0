"""Where meshes are: in packages, beside the URDF, and nowhere else."""

from pathlib import Path

import pytest

from tfbus.robot.mesh_files import MeshFiles, MeshPathError


@pytest.fixture
def urdf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a URDF in a package of ROS."""
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "work" / "arm" / "urdf"
    folder.mkdir(parents=True)
    (folder.parent / "package.xml").touch()
    return folder


def made(file: Path) -> Path:
    """The file, which is there afterwards."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    return file


def test_packages_are_searched_in_given_folders_then_by_ros_then_above_the_urdf(
    tmp_path: Path, urdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder with the package's name."""
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros1"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros2"))
    inside = Path("hand", "meshes", "tool.stl")
    above, given = tmp_path / inside, tmp_path / "given" / inside
    by_ros_1, by_ros_2 = tmp_path / "ros1" / inside, tmp_path / "ros2" / "share" / inside
    for file in (above, by_ros_1, by_ros_2, given):
        made(file)
        files = MeshFiles(urdf, [tmp_path / "given"])
        assert files.find(f"package://{inside}") == file
        assert files.find(f"model://{inside}") == file
        assert files.package("hand") == file.parents[1]


def test_a_package_may_lie_in_a_folder_of_another_name(tmp_path: Path, urdf: Path) -> None:
    """A given one, or that of the URDF, such as a clone of its repository."""
    own = made(urdf.parent / "meshes" / "a.stl")
    assert MeshFiles(urdf).find("package://arm_description/meshes/a.stl") == own
    given = made(tmp_path / "given" / "meshes" / "a.stl")
    files = MeshFiles(urdf, [tmp_path / "given"])
    assert files.find("package://hand/meshes/a.stl") == given


def test_paths_begin_at_the_urdf(urdf: Path) -> None:
    """With or without `file://`, within its package, whether they exist or not."""
    mesh = urdf.parent / "meshes" / "a.stl"
    files = MeshFiles(urdf)
    for name in ("../meshes/a.stl", "file://../meshes/a.stl", str(mesh), f"file://{mesh}"):
        assert files.find(name) == mesh


@pytest.mark.parametrize(
    "name",
    [
        "../../secret.stl",
        "file://../../secret.stl",
        "meshes/../../../secret.stl",
        "package://arm/../secret.stl",
        "package://arm/meshes/../../secret.stl",
        "package://../secret.stl",
        "package://arm//etc/passwd",
        "model://arm/../secret.stl",
    ],
)
def test_a_name_that_leads_out_of_its_package_is_refused(urdf: Path, name: str) -> None:
    """Though the file is there."""
    made(urdf.parents[1] / "secret.stl")
    with pytest.raises(MeshPathError, match="leads out of"):
        MeshFiles(urdf).find(name)


@pytest.mark.parametrize(
    "name",
    ["/etc/passwd", "file:///etc/passwd", "https://example.org/a.stl", "package:///a", "a\0b"],
)
def test_what_is_outside_of_all_packages_has_no_file(urdf: Path, name: str) -> None:
    """A path of another machine, an address."""
    assert MeshFiles(urdf).find(name) is None


def test_a_text_without_a_folder_has_files_only_in_packages(tmp_path: Path) -> None:
    """As a description has that came over the network."""
    mesh = made(tmp_path / "hand" / "a.stl")
    files = MeshFiles(None, [tmp_path])
    assert files.find("package://hand/a.stl") == mesh
    assert files.find("hand/a.stl") is None and files.find(str(mesh)) is None


def test_without_a_package_the_folder_above_is_its_own(tmp_path: Path) -> None:
    """`urdf` stands beside `meshes`."""
    urdf = tmp_path / "download" / "arm" / "urdf"
    urdf.mkdir(parents=True)
    assert MeshFiles(urdf).find("../meshes/a.stl") == urdf.parent / "meshes" / "a.stl"
    with pytest.raises(MeshPathError):
        MeshFiles(urdf).find("../../a.stl")


def test_a_given_folder_allows_what_is_in_it(tmp_path: Path, urdf: Path) -> None:
    """Also to paths that lead out of the robot's own."""
    shared = tmp_path / "work" / "shared" / "a.stl"
    assert MeshFiles(urdf, [tmp_path / "work" / "shared"]).find("../../shared/a.stl") == shared


def test_only_what_ends_as_a_mesh_does_has_a_file(urdf: Path) -> None:
    """A URDF of a stranger cannot name the keys of the one who shows it."""
    made(urdf.parent / "id_rsa")
    assert MeshFiles(urdf).find("../id_rsa") is None
    assert MeshFiles(urdf).find("package://etc/shadow") is None
    made(urdf.parent / "A.STL")
    assert MeshFiles(urdf).find("../A.STL") == urdf.parent / "A.STL"


def test_packages_that_pip_has_installed_are_found(
    tmp_path: Path, urdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As example-robot-data, which has the layout of cmeel."""
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path / "site"))
    mesh = made(tmp_path / "site" / "cmeel.prefix" / "share" / "some-robots" / "a.dae")
    assert MeshFiles(urdf).find("package://some-robots/a.dae") == mesh
