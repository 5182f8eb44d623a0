"""The source of a robot's description: a file that may change, or a text."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tfbus import Robot

# The endings of files that a xacro file may read besides the ones that it includes.
_ENDINGS = (".urdf", ".xacro", ".xml", ".yaml", ".yml")

# A folder with more is not a robot's own: only the files that were read are watched then.
_MOST_BESIDE = 500

_Signature = tuple[tuple[str, int, int], ...]


class DescriptionFile:
    """A URDF or xacro file, which can be read again once it has changed; for one thread.

    `package_path` and `xacro_args` are as of `Robot.from_urdf`.
    """

    def __init__(
        self, path: Path, package_path: Sequence[Path] = (), xacro_args: Mapping[str, str] = {}
    ) -> None:
        self.path = path
        self._package_path = tuple(package_path)
        self._xacro_args = dict(xacro_args)
        self._files: tuple[Path, ...] = (path,)
        self._read: _Signature = ()
        self._seen: _Signature = ()

    def load(self) -> Robot:
        """Read it. Raises UrdfError, with the line."""
        # Before it is read: a file that changes meanwhile is read again.
        self._read = self._seen = self._signature()
        robot = Robot.from_urdf(
            self.path, package_path=self._package_path, xacro_args=self._xacro_args
        )
        if set(robot.files) != set(self._files):
            self._files = robot.files
            self._read = self._seen = self._signature()
        return robot

    def has_changed(self) -> bool:
        """Whether it, or a file that belongs to it, has changed since it was read, and not since
        the last call: a file that is being written is left alone.
        """
        now = self._signature()
        is_settled = now == self._seen
        self._seen = now
        return is_settled and now != self._read

    def _signature(self) -> _Signature:
        files = {str(file) for file in self._files}
        for folder in {file.parent for file in self._files}:
            try:
                beside = [str(each) for each in folder.iterdir() if each.suffix in _ENDINGS]
            except OSError:
                continue
            files.update(beside if len(beside) <= _MOST_BESIDE else ())
        found = []
        for file in sorted(files):
            try:
                status = Path(file).stat()
            except OSError:
                continue
            found.append((file, status.st_mtime_ns, status.st_size))
        return tuple(found)


def xacro_arguments(given: Sequence[str]) -> dict[str, str]:
    """The arguments of a xacro file, each `name:=value`. Raises ValueError with a sentence."""
    arguments = {}
    for text in given:
        name, found, value = text.partition(":=")
        if not found or not name:
            raise ValueError(f"{text!r} is not of the form name:=value")
        arguments[name] = value
    return arguments
