"""The meshes of a robot for viewers on other machines: only files that its description names, and
the textures and materials beside them.
"""

import posixpath
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tfbus import Robot, ServiceError
from tfbus.messages import RobotMesh
from tfbus.wording import counted, listed, printable

MOST_BYTES = 100_000_000
PART_BYTES = 1_000_000

# What a mesh may read besides its own file.
_BESIDE = frozenset((".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".bin"))

_PACKAGE = "package://"


def serve_mesh(robot: Robot, request: RobotMesh.Request) -> RobotMesh.Response:
    """A part of a mesh. Raises ServiceError for a name that the robot does not have, a file that
    cannot be read, or one of more than 100 MB.
    """
    shown = printable(request.mesh, 120)
    file = _file_of(robot, request.mesh)
    if file is None and request.mesh not in _meshes(robot):
        raise ServiceError(f"the description of {robot.name!r} names no mesh '{shown}'")
    if file is None or not file.exists():
        raise ServiceError(f"robot_state does not find mesh '{shown}'{_remedy([request.mesh])}")
    try:
        with file.open("rb") as opened:
            size = opened.seek(0, 2)
            changed_ns = file.stat().st_mtime_ns
            if size > MOST_BYTES:
                raise ServiceError(
                    f"mesh '{shown}' has {size:,} bytes: at most {MOST_BYTES:,} are sent"
                )
            opened.seek(min(request.offset, size))
            data = opened.read(PART_BYTES)
    except OSError as error:
        raise ServiceError(f"mesh '{shown}' cannot be read: {error.strerror}") from error
    return RobotMesh.Response(data, size, f"{changed_ns:x}-{size:x}")


def what_is_missing(robot: Robot) -> str:
    """A sentence on the meshes of which there is no file, "" if all are there."""
    missing = [name for name, file in _meshes(robot).items() if file is None or not file.is_file()]
    if not missing:
        return ""
    names = listed([f"'{printable(name, 120)}'" for name in missing])
    return f"Did not find {counted(len(missing), 'mesh file')}: {names}{_remedy(missing)}"


def _remedy(names: Sequence[str]) -> str:
    packages = sorted({package for name in names if (package := _package(name))})
    if not packages:
        return ""
    quoted = listed([f"'{printable(package, 60)}'" for package in packages])
    return f"; start robot_state with --package-path and the folder with {quoted}"


def _file_of(robot: Robot, name: str) -> Path | None:
    meshes = _meshes(robot)
    if name in meshes:
        return meshes[name]
    if Path(name).suffix.lower() not in _BESIDE:
        return None
    path = _plain(name)
    for mesh, file in meshes.items():
        if file is None or _package(mesh) != _package(name):
            continue
        way = posixpath.relpath(path, posixpath.dirname(_plain(mesh)) or ".")
        beside = Path(posixpath.normpath(file.parent / way))
        if beside.is_relative_to(_root(mesh, file)) and beside.is_file():
            return beside
    return None


def _meshes(robot: Robot) -> dict[str, Path | None]:
    """The files of all meshes by their names in the description."""
    shapes: list[Any] = [each.shape for each in robot.visuals]
    shapes += [each.shape for each in robot.collisions]
    return {shape.name: shape.file for shape in shapes if hasattr(shape, "file")}


def _package(name: str) -> str:
    """The package of a mesh's name, "" where it has none."""
    return name.removeprefix(_PACKAGE).partition("/")[0] if name.startswith(_PACKAGE) else ""


def _plain(name: str) -> str:
    """The path in a name, within its package where it has one."""
    if name.startswith(_PACKAGE):
        name = name.removeprefix(_PACKAGE).partition("/")[2]
    return posixpath.normpath(name.removeprefix("file://"))


def _root(mesh: str, file: Path) -> Path:
    """The folder that files beside a mesh are in: its package, or its own folder."""
    depth = _plain(mesh).count("/") if _package(mesh) else 0
    return file.parents[depth]
