"""The meshes of a robot for viewers on other machines: only files that its description names, and
the textures and materials beside them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tfbus import Robot, ServiceError
from tfbus.base.wording import counted, listed, printable
from tfbus.messages import RobotMesh

MOST_BYTES = 100_000_000
PART_BYTES = 1_000_000


def serve_mesh(robot: Robot, request: RobotMesh.Request) -> RobotMesh.Response:
    """A part of a mesh. Raises ServiceError for a name that the robot does not have, a file that
    cannot be read, or one of more than 100 MB.
    """
    shown = printable(request.mesh, 120)
    meshes = _meshes(robot)
    mesh = meshes.get(request.mesh)
    file = _beside(meshes, request.mesh) if mesh is None else mesh.file
    if mesh is None and file is None:
        raise ServiceError(f"the description of {robot.name!r} names no mesh '{shown}'")
    if file is None or not file.exists():
        raise ServiceError(
            f"robot_state does not find mesh '{shown}'{_remedy([mesh] if mesh else [])}"
        )
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
    missing = [
        mesh for mesh in _meshes(robot).values() if mesh.file is None or not mesh.file.is_file()
    ]
    if not missing:
        return ""
    names = listed([f"'{printable(mesh.name, 120)}'" for mesh in missing])
    return f"Did not find {counted(len(missing), 'mesh file')}: {names}{_remedy(missing)}"


def _remedy(missing: Sequence[Any]) -> str:
    packages = sorted({mesh.package for mesh in missing if mesh.package})
    if not packages:
        return ""
    quoted = listed([f"'{printable(package, 60)}'" for package in packages])
    return f"; start robot_state with --package-path and the folder with {quoted}"


def _meshes(robot: Robot) -> dict[str, Any]:
    """All meshes by their names in the description."""
    shapes: list[Any] = [each.shape for each in robot.visuals]
    shapes += [each.shape for each in robot.collisions]
    return {shape.name: shape for shape in shapes if hasattr(shape, "file")}


def _beside(meshes: Mapping[str, Any], name: str) -> Path | None:
    """A file that one of the meshes reads, such as a texture."""
    return next(filter(None, (mesh.beside(name) for mesh in meshes.values())), None)
