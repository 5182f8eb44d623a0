"""Where a mesh's file is, by its name in a URDF; never outside of its package."""

from __future__ import annotations

import os
import posixpath
import re
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path

# Gazebo's word for the same.
_PACKAGE = ("package://", "model://")
# Formats of meshes. A file of another kind is none, wherever it is: what a URDF of a stranger names
# is sent to those who ask for the robot's meshes.
_FORMATS = frozenset(
    (
        *(".3ds", ".3mf", ".ac", ".dae", ".fbx", ".glb", ".gltf", ".iv", ".mesh", ".msh", ".obj"),
        *(".off", ".ply", ".stl", ".stlb", ".usd", ".usda", ".usdc", ".usdz", ".wrl", ".x3d"),
    )
)
# What a mesh may read besides its own file: materials, buffers and pictures.
BESIDE = frozenset(
    (
        *(".mtl", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif"),
        ".webp",
    )
)
# What the folder of a package has in it: one of ROS, of Python, or a repository.
_MARKS = ("package.xml", "pyproject.toml", "__init__.py", ".git")


class MeshPathError(ValueError):
    """A name of a mesh that leads out of its package; the message says which and what to do."""


def parts_of(name: str) -> tuple[str, str]:
    """The package in a name of a URDF, "" where it has none, and the path in it."""
    for scheme in _PACKAGE:
        if name.startswith(scheme):
            package, _, path = name.removeprefix(scheme).partition("/")
            return package, path
    return "", name.removeprefix("file://")


def package_folder(name: str, file: Path) -> Path | None:
    """The folder of the package of a mesh, by its name and its file; None where it has none."""
    package, path = parts_of(name)
    return file.parents[posixpath.normpath(path).count("/")] if package else None


def file_beside(mesh: str, file: Path, name: str) -> Path | None:
    """The file of another name that is written as the name `mesh` of the mesh `file` is.

    None where there is none, where a mesh does not read such files, or where it is outside of the
    package, without one outside of the mesh's folder.
    """
    package, path = parts_of(name)
    own_package, own = parts_of(mesh)
    if Path(name).suffix.lower() not in BESIDE or package != own_package or "\0" in name:
        return None
    way = posixpath.relpath(path, posixpath.dirname(posixpath.normpath(own)) or ".")
    beside = Path(posixpath.normpath(file.parent / way))
    folder = package_folder(mesh, file) or file.parent
    return beside if beside.is_relative_to(folder) and beside.is_file() else None


class MeshFiles:
    """Finds the files of the meshes of a URDF.

    `folder` is that of the URDF: paths without `package://` begin there. None for a URDF that is
    not a file here. The packages are searched in `package_path`, in what ROS has installed
    (AMENT_PREFIX_PATH, ROS_PACKAGE_PATH), in `share` of this Python and of the system, then in the
    folders above the URDF.
    """

    def __init__(self, folder: Path | None, package_path: Sequence[Path] = ()) -> None:
        self._folder = None if folder is None else Path(os.path.abspath(folder))
        self._named = [Path(os.path.abspath(place)) for place in package_path]
        self._above = [] if self._folder is None else [self._folder, *self._folder.parents]
        self._places = [*self._named, *_installed(), *reversed(self._above), *_shared()]
        self._packages: dict[str, list[Path]] = {}

    def find(self, name: str) -> Path | None:
        """The file of a mesh; the first place where it should be if there is none.

        None where the name is an address, an absolute path outside of all packages, or a relative
        one and there is no folder; and where it does not end as a mesh does. Raises MeshPathError
        where it climbs out of its package.
        """
        file = self._find(name)
        return file if file is not None and file.suffix.lower() in _FORMATS else None

    def _find(self, name: str) -> Path | None:
        if name.startswith(_PACKAGE):
            return self._in_package(*parts_of(name))
        _, path = parts_of(name)
        if "://" in path or self._folder is None or "\0" in path:
            return None
        file = Path(os.path.normpath(self._folder / path))
        if any(file.is_relative_to(place) for place in self._allowed()):
            return file
        if os.path.isabs(path):
            return None
        raise MeshPathError(
            f"leads out of the robot's folder {self._own_package}; --package-path (in Python "
            "package_path) allows another"
        )

    def package(self, name: str) -> Path | None:
        """The folder of a package; None where it is not found."""
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
            # A package may lie in a folder of another name.
            self._packages[package] = [
                *(place / package for place in self._places),
                *self._named,
                *self._above,
            ]
        return self._packages[package]

    def _allowed(self) -> Iterator[Path]:
        """The folders in which paths without `package://` may lie."""
        if self._own_package is not None:
            yield self._own_package
        yield from self._named
        yield from _installed()
        yield from _shared()

    @cached_property
    def _own_package(self) -> Path | None:
        """The nearest folder above the URDF that is a package or a repository; without one the
        folder above it, as of `urdf` beside `meshes`.
        """
        for folder in self._above:
            if any((folder / mark).exists() for mark in _MARKS):
                return folder
        return next(iter(self._above[1:2]), None)


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
    """The folders in which pip and the system install what belongs to packages."""
    packages = Path(sysconfig.get_path("purelib"))
    yield packages
    # Where the packages of cmeel, such as example-robot-data, have theirs.
    yield packages / "cmeel.prefix" / "share"
    yield Path(sys.prefix, "share")
    yield Path("/usr/share")
