"""The file of a mesh, by its name in a URDF; never outside of its package."""

from __future__ import annotations

import os
import posixpath
import re
import sys
import sysconfig
from collections.abc import Iterator, Sequence, Set
from pathlib import Path
from urllib.parse import unquote

# Gazebo's word for the same.
_PACKAGE = ("package://", "model://")
# Formats of meshes. A file of another kind is none, wherever it is: the files that a stranger's
# URDF names are sent to anyone who asks for the robot's meshes.
_FORMATS = frozenset(
    (
        *(".3ds", ".3mf", ".ac", ".dae", ".fbx", ".glb", ".gltf", ".iv", ".mesh", ".msh", ".obj"),
        *(".off", ".ply", ".stl", ".stlb", ".usd", ".usda", ".usdc", ".usdz", ".wrl", ".x3d"),
    )
)
# The files that a mesh may read besides its own: materials, buffers and pictures.
BESIDE = frozenset(
    (
        *(".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif"),
        ".webp",
    )
)
# Files by which a folder is a package: of ROS, a repository of such, of Python.
_OF_ROS, _REPOSITORY = "package.xml", ".git"
_MARKS = (_OF_ROS, _REPOSITORY, "pyproject.toml", "__init__.py")
# Where packages without a mark have their URDFs, beside the folder of meshes.
_OF_URDFS = frozenset(("urdf", "urdfs", "xacro", "robot", "robots", "model", "models"))


class MeshPathError(ValueError):
    """A name of a mesh that leads out of its package; the message has the name and the remedy."""


def parts_of(name: str) -> tuple[str, str]:
    """The package in a name of a URDF, "" if it has none, and the path in it."""
    for scheme in _PACKAGE:
        if name.startswith(scheme):
            package, _, path = name.removeprefix(scheme).partition("/")
            return package, path
    return "", name.removeprefix("file://")


def package_folder(name: str, file: Path) -> Path | None:
    """The folder of the package of a mesh, by its name and its file; None if it has none."""
    package, path = parts_of(name)
    return file.parents[posixpath.normpath(path).count("/")] if package else None


def file_beside(mesh: str, file: Path, name: str) -> Path | None:
    """The file of another name that is written as the name `mesh` of the mesh `file` is.

    None if there is none, if a mesh does not read such files, also by a link, or if it is
    outside of the package, without one outside of the mesh's folder.
    """
    package, path = parts_of(name)
    own_package, own = parts_of(mesh)
    if package != own_package or "\0" in name:
        return None
    way = posixpath.relpath(path, posixpath.dirname(posixpath.normpath(own)) or ".")
    beside = Path(posixpath.normpath(file.parent / way))
    folder = package_folder(mesh, file) or file.parent
    return beside if beside.is_relative_to(folder) and _is_one_of(BESIDE, beside) else None


def folder_of_source(source: str, package_path: Sequence[Path]) -> tuple[Path, Path] | None:
    """The folder of a URDF that a description of the bus or of a recording says it is from, and the
    folder of `package_path` that holds it.

    None if no such folder does: a stranger may name any path, and only paths count that the user
    of this machine has named.
    """
    if not os.path.isabs(source) or "\0" in source:
        return None
    file = Path(os.path.realpath(source))
    for given in map(os.path.realpath, package_path):
        if file.is_relative_to(given) and file.is_file():
            return file.parent, Path(given)
    return None


def file_below(name: str, folders: Sequence[Path]) -> tuple[Path, Path] | None:
    """The file of a mesh that a stranger names by `file://` or an absolute path, and the one of
    these folders that holds it, both without links; None if it is outside of all of them, or no
    mesh.
    """
    _, path = parts_of(name)
    if not os.path.isabs(path) or "\0" in path:
        return None
    # A path with spaces is written with %20 in an address.
    for each in dict.fromkeys((path, unquote(path))):
        file = Path(os.path.realpath(each))
        for given in map(os.path.realpath, folders):
            if file.is_relative_to(given) and _is_one_of(_FORMATS, file):
                return file, Path(given)
    return None


class MeshFiles:
    """Finds the files of the meshes of a URDF.

    `folder` is the URDF's: paths without `package://` begin there. None for a URDF that is
    not a file here. The packages are searched in `package_path`, in ROS's folders
    (AMENT_PREFIX_PATH, ROS_PACKAGE_PATH), in the URDF's own package, beside it if there are
    packages of ROS, then in `share` of this Python and of the system. Of the folders above `within`
    none is searched.
    """

    def __init__(
        self, folder: Path | None, package_path: Sequence[Path] = (), within: Path | None = None
    ) -> None:
        self._folder = None if folder is None else Path(os.path.abspath(folder))
        self._named = [Path(os.path.abspath(place)) for place in package_path]
        above = [] if self._folder is None else [self._folder, *self._folder.parents]
        if within is not None:
            above = [each for each in above if each.is_relative_to(within)]
        count = _size_of_package(above)
        # The folders from the URDF's up to its package, and further ones with packages beside it.
        self._above = above[:count]
        self._beside = above[count : count + _repository(above[count:])]
        self._packages: dict[str, list[Path]] = {}

    @property
    def package_path(self) -> tuple[Path, ...]:
        """The folders that were given."""
        return tuple(self._named)

    def find(self, name: str) -> Path | None:
        """The file of a mesh; the first place where it should be if there is none.

        None if the name is an address, an absolute path outside of all packages, or a relative
        one and there is no folder; and if it, or the file that it is a link to, does not end as
        a mesh does. Raises MeshPathError if it climbs out of its package.
        """
        file = self._find(name)
        if file is None or file.suffix.lower() not in _FORMATS:
            return None
        return file if _is_one_of(_FORMATS, file) or not file.exists() else None

    def _find(self, name: str) -> Path | None:
        if name.startswith(_PACKAGE):
            return self._in_package(*parts_of(name))
        _, path = parts_of(name)
        if "://" in path or self._folder is None or "\0" in path:
            return None
        file = Path(os.path.normpath(self._folder / path))
        if any(file.is_relative_to(place) for place in self._allowed()):
            return file
        if os.path.isabs(path) or not self._above:
            return None
        raise MeshPathError(
            f"leads out of the robot's folder {self._above[-1]}; --package-path (in Python "
            "package_path) allows another"
        )

    def package(self, name: str) -> Path | None:
        """The folder of a package; None if it is not found."""
        for folder in self._folders(name):
            if folder.is_dir() and (folder.name == name or _is_package(folder, name)):
                return folder
        return None

    def _in_package(self, package: str, path: str) -> Path | None:
        parts = Path(os.path.normpath(path)).parts
        if package in (".", "..") or parts[:1] == ("..",) or path.startswith("/"):
            raise MeshPathError(f"leads out of package {package!r}")
        if not package or "\0" in package + path:
            return None
        candidates = [folder.joinpath(*parts) for folder in self._folders(package)]
        return next((file for file in candidates if file.is_file()), next(iter(candidates), None))

    def _folders(self, package: str) -> list[Path]:
        """The folders that can be that package, the likeliest first."""
        if package not in self._packages:
            beside = [place / package for place in self._beside]
            self._packages[package] = [
                *(place / package for place in (*self._named, *_installed())),
                *(folder for folder in reversed(beside) if (folder / _OF_ROS).is_file()),
                *(place / package for place in (*reversed(self._above), *_shared())),
                # A package may lie in a folder of another name.
                *self._named,
                *self._above,
            ]
        return self._packages[package]

    def _allowed(self) -> Iterator[Path]:
        """The folders in which paths without `package://` may lie."""
        yield from self._above[-1:]
        yield from self._named
        yield from _installed()
        yield from _shared()


def _size_of_package(above: Sequence[Path]) -> int:
    """How many of the folders from a URDF's upwards are in its package: up to the nearest one that
    is a package or a repository. Without one that is the folder of the URDF, or the one above it,
    as of `urdf` beside `meshes`.

    The root of the disk and the home folder are no package, whatever they hold: of a URDF in one of
    them none is.
    """
    never = (Path("/"), Path(os.path.expanduser("~")))
    if above and above[0] in never:
        return 0
    for count, folder in enumerate(above, 1):
        is_marked = folder.parent.name == "share" or any(
            (folder / each).exists() for each in _MARKS
        )
        if is_marked and folder not in never:
            return count
    has_above = len(above) > 1 and above[0].name.lower() in _OF_URDFS and above[1] not in never
    return 2 if has_above else min(1, len(above))


def _repository(above: Sequence[Path]) -> int:
    """How many of the folders above a package may hold others beside it: all up to its repository,
    and at least the next one.
    """
    below_root = above[:-1]
    for count, folder in enumerate(below_root, 1):
        if (folder / _REPOSITORY).exists():
            return count
    return min(1, len(below_root))


def _is_one_of(suffixes: Set[str], file: Path) -> bool:
    """Whether a file is there and has one of these suffixes, and the target of a link likewise."""
    real = Path(os.path.realpath(file))
    return {file.suffix.lower(), real.suffix.lower()} <= suffixes and real.is_file()


def _is_package(folder: Path, name: str) -> bool:
    """Whether its package.xml says that it is this package."""
    try:
        said = re.search(r"<name>\s*(.*?)\s*</name>", (folder / "package.xml").read_text())
    except (OSError, ValueError):
        return False
    return said is not None and said[1] == name


def _installed() -> Iterator[Path]:
    """The folders in which ROS has packages installed."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix, "share")
    for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if place:
            yield Path(place)


def _shared() -> Iterator[Path]:
    """The folders in which pip and the system install the data of packages."""
    packages = Path(sysconfig.get_path("purelib"))
    yield packages
    # Where the packages of cmeel, such as example-robot-data, have theirs.
    yield packages / "cmeel.prefix" / "share"
    yield Path(sys.prefix, "share")
    yield Path("/usr/share")
