"""A mesh file to read: on this machine, or in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class MeshRequest:
    """A mesh file at `path`, which may name files inside of `root`; or with `data`, as it came from
    another machine, and files that came `beside` it. `kind` is its suffix, such as "stl".

    `texture` is the picture that the URDF gives it, by its name, for triangles without a look of
    their own. With `heeds_up_axis` a DAE is turned by the up axis that it states.
    """

    kind: str
    path: Path | None = None
    root: Path | None = None
    data: bytes = b""
    beside: Mapping[str, bytes] = field(default_factory=dict)
    texture: tuple[str, bytes] | None = None
    heeds_up_axis: bool = False

    def as_map(self) -> dict[str, Any]:
        """It as msgpack can have it."""
        return {
            "kind": self.kind,
            "path": None if self.path is None else str(self.path),
            "root": None if self.root is None else str(self.root),
            "data": self.data,
            "beside": dict(self.beside),
            "texture": self.texture,
            "heeds_up_axis": self.heeds_up_axis,
        }

    @staticmethod
    def from_map(values: Mapping[str, Any]) -> "MeshRequest":
        """It again."""
        path, root, texture = values["path"], values["root"], values["texture"]
        return MeshRequest(
            values["kind"],
            None if path is None else Path(path),
            None if root is None else Path(root),
            values["data"],
            values["beside"],
            None if texture is None else (texture[0], texture[1]),
            values["heeds_up_axis"],
        )
