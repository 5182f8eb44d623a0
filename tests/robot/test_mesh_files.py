"""The places of meshes: in packages, beside the URDF, and nowhere else."""

from pathlib import Path

import pytest

from tfbus.robot.mesh_files import MeshFiles, MeshPathError, file_beside, folder_of_source


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


def test_packages_are_searched_in_given_folders_then_by_ros_then_beside_the_urdfs(
    tmp_path: Path, urdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder with the package's name; one beside the URDF's has a package.xml."""
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros1"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros2"))
    inside = Path("hand", "meshes", "tool.stl")
    beside, given = urdf.parents[1] / inside, tmp_path / "given" / inside
    by_ros_1, by_ros_2 = tmp_path / "ros1" / inside, tmp_path / "ros2" / "share" / inside
    made(beside.parents[1] / "package.xml")
    for file in (beside, by_ros_1, by_ros_2, given):
        made(file)
        files = MeshFiles(urdf, [tmp_path / "given"])
        assert files.find(f"package://{inside}") == file
        assert files.find(f"model://{inside}") == file
        assert files.package("hand") == file.parents[1]


@pytest.mark.parametrize("mark", ["package.xml", ".git", "pyproject.toml", "", "share"])
def test_what_lies_above_the_package_of_a_urdf_has_no_file(tmp_path: Path, mark: str) -> None:
    """A URDF from elsewhere gets no folder of the disk served: not by a name of its own choice, nor
    as a picture beside. A folder is a package by a file in it, below `share`, or above `urdf`.
    """
    package = tmp_path / "disk" / (mark if mark == "share" else "down") / "arm"
    if mark not in ("", "share"):
        made(package / mark)
    own = made(package / "meshes" / "a.stl")
    made(package / "meshes" / "b.png")
    files = MeshFiles(own.parents[1] / "urdf")
    assert files.find("package://arm/meshes/a.stl") == own
    for secret in ("secret", "arm/../../secret"):
        made(tmp_path / "disk" / secret / "a.stl")
        made(tmp_path / "disk" / secret / "b.png")
    for name in ("secret", "disk", "tmp", "down", "share"):
        for path in ("a.stl", "secret/a.stl", "disk/secret/a.stl"):
            file = files.find(f"package://{name}/{path}")
            assert file is None or not file.exists()
            if file is not None:
                beside = f"package://{name}/{path.replace('a.stl', 'b.png')}"
                assert file_beside(f"package://{name}/{path}", file, beside) is None


def test_the_root_of_the_disk_and_the_home_folder_are_no_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a mark lies in them, or a URDF."""
    monkeypatch.setenv("HOME", str(tmp_path))
    made(tmp_path / "package.xml")
    secret = made(tmp_path / "pictures" / "a.stl")
    from_root = secret.relative_to("/")
    for folder in (Path("/"), Path("/urdf"), tmp_path, tmp_path / "urdf"):
        files = MeshFiles(folder)
        for name in (f"package://{from_root}", "package://pictures/a.stl", str(secret)):
            assert files.find(name) != secret
    assert MeshFiles(tmp_path).find("pictures/a.stl") is None


def test_packages_of_a_repository_find_each_other(tmp_path: Path) -> None:
    """Wherever they are in it; those of another one beside it do not."""
    repository = tmp_path / "repository"
    for place in ("arms/arm", "hand", "../other"):
        made(repository / place / "package.xml")
        made(repository / place / "a.stl")
    made(repository / ".git" / "HEAD")
    files = MeshFiles(repository / "arms" / "arm" / "urdf")
    assert files.find("package://hand/a.stl") == repository / "hand" / "a.stl"
    assert files.find("package://other/a.stl") != tmp_path / "other" / "a.stl"


def test_a_link_of_a_mesh_to_another_kind_of_file_has_no_file(urdf: Path, tmp_path: Path) -> None:
    """A clone may bring links; those of `colcon build --symlink-install` are to meshes."""
    mesh, key = made(tmp_path / "build" / "a.stl"), made(tmp_path / "id_rsa")
    for name, target in (("a.stl", mesh), ("b.stl", key), ("c.png", key)):
        (urdf.parent / name).symlink_to(target)
    files = MeshFiles(urdf)
    assert files.find("../a.stl") == urdf.parent / "a.stl"
    assert files.find("../b.stl") is None
    assert file_beside("../a.stl", urdf.parent / "a.stl", "../c.png") is None


def test_the_source_of_a_description_counts_only_in_a_given_folder(tmp_path: Path) -> None:
    """A stranger may name any path, also by `..` and by a link."""
    given, other = tmp_path / "given", tmp_path / "other"
    inside, outside = made(given / "arm" / "a.urdf"), made(other / "a.urdf")
    (given / "link.urdf").symlink_to(outside)
    assert folder_of_source(str(inside), [other, given]) == (inside.parent, given)
    for source in (
        str(outside),
        "/etc/passwd",
        str(given / ".." / "other" / "a.urdf"),
        str(given / "link.urdf"),
        str(given / "missing.urdf"),
        "a.urdf",
        "",
        "/\0",
    ):
        assert folder_of_source(source, [given]) is None


def test_a_folder_that_was_given_ends_the_search_for_a_package(tmp_path: Path) -> None:
    """Of a description that came over the network."""
    made(tmp_path / "package.xml")
    urdf = tmp_path / "given" / "urdf"
    made(tmp_path / "secret" / "a.stl")
    files = MeshFiles(urdf, [], within=tmp_path / "given")
    assert files.find("a.stl") == urdf / "a.stl"
    assert files.find("../a.stl") == tmp_path / "given" / "a.stl"
    with pytest.raises(MeshPathError):
        files.find("../../secret/a.stl")


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
