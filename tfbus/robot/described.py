"""A robot as a message describes it, of a bus or of a recording: from anyone."""

from collections.abc import Sequence
from pathlib import Path

from tfbus.robot.mesh_files import MeshFiles, folder_of_source
from tfbus.robot.robot import Robot
from tfbus.robot.urdf import read_model
from tfbus.wording import printable


def read_described(urdf: str, source: str, package_path: Sequence[Path], called: str) -> Robot:
    """The robot of a description; if it has no `source`, mistakes call it `called`.

    Files of this machine are only in `package_path` and in what is installed: a `source` counts
    if it lies in one of those folders. Raises UrdfError.
    """
    folder, within = folder_of_source(source, package_path) or (None, None)
    files = MeshFiles(folder, package_path, within)
    return Robot(read_model(urdf, printable(source or called), files), urdf)


def remedy_of_missing(package: str) -> str:
    """The stand-in of a described mesh, of this package or "" for none, that is not on this
    machine.
    """
    if package:
        return f"--package-path names the folder with package {printable(package, 60)!r}"
    return "--package-path names a folder around its URDF, --urdf shows the robot of a file"
