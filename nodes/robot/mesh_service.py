"""The meshes of a robot for viewers on other machines: only files that its description names, and
the textures and materials beside them.
"""

from pathlib import Path
from typing import Any

from tfbus import Robot, ServiceError
from tfbus.messages import RobotMesh
from tfbus.wording import printable

MOST_BYTES = 100_000_000
PART_BYTES = 1_000_000


def serve_mesh(robot: Robot, request: RobotMesh.Request) -> RobotMesh.Response:
    """A part of a mesh. Raises ServiceError for a name that the robot does not have, a file that
    cannot be read, or one of more than 100 MB.
    """
    shown = printable(request.mesh, 120)
    file = _file_of(robot, request.mesh)
    if file is None:
        raise ServiceError(f"the description of {robot.name!r} names no mesh '{shown}'")
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


def _file_of(robot: Robot, name: str) -> Path | None:
    """The file of a mesh of the robot, or of what one of them reads."""
    shapes: list[Any] = [each.shape for each in robot.visuals]
    shapes += [each.shape for each in robot.collisions]
    meshes = {shape.name: shape for shape in shapes if hasattr(shape, "file")}
    if name in meshes:
        file: Path | None = meshes[name].file
        return file
    return next(filter(None, (mesh.beside(name) for mesh in meshes.values())), None)
