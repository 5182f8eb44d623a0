"""The files that a mesh file names: materials, pictures, buffers; never outside its package."""

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from trimesh.resolvers import Resolver

from tfbus.robot.mesh_files import BESIDE
from tfbus.view.meshes.limits import MOST_BYTES


class References(Resolver):
    """The files beside a mesh file: those that came `beside` it, by their names, or those in its
    `folder` and inside of `root`.

    `refused` says of each file that cannot be had why, by its name.
    """

    def __init__(
        self,
        folder: Path | None = None,
        root: Path | None = None,
        beside: Mapping[str, bytes] | None = None,
    ) -> None:
        self.refused: dict[str, str] = {}
        self._folder = folder
        self._root = root
        self._beside = beside or {}

    def get(self, key: str) -> bytes:
        """The content of a file. Raises FileNotFoundError if it cannot be had."""
        name = unquote(str(key)).removeprefix("file://").removeprefix("./").replace("\\", "/")
        if name in self._beside:
            return self._beside[name]
        try:
            return self._read(name)
        except OSError as error:
            why = error.strerror or str(error)
            self.refused.setdefault(name, why)
            raise FileNotFoundError(why) from error

    def _read(self, name: str) -> bytes:
        if self._folder is None or self._root is None:
            raise FileNotFoundError("it did not come with the mesh")
        file = (self._folder / name).resolve()
        if not file.is_relative_to(self._root.resolve()):
            raise FileNotFoundError("it is outside of the mesh's package")
        if file.suffix.lower() not in BESIDE:
            raise FileNotFoundError("it is no picture, material or buffer")
        if not file.is_file():
            raise FileNotFoundError("no such file")
        if file.stat().st_size > MOST_BYTES:
            raise FileNotFoundError(f"it has more than {MOST_BYTES // 10**6} MB")
        return file.read_bytes()

    def write(self, name: str, data: object) -> None:
        """Nothing is written."""
        raise PermissionError(name)

    def namespaced(self, namespace: str) -> "References":
        """The same."""
        return self

    def keys(self) -> list[str]:
        """None are known in advance."""
        return []
