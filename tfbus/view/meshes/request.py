"""A mesh file to read: on this machine, or in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class MeshRequest:
    """A mesh file at `path`, which may name files inside of `root`; or with `data`, as it came from
    another machine, and files that came `beside` it. `kind` is its suffix, such as "stl".
    """

    kind: str
    path: Path | None = None
    root: Path | None = None
    data: bytes = b""
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def as_map(self) -> dict[str, Any]:
        """It as msgpack can have it."""
        return {
            "kind": self.kind,
            "path": None if self.path is None else str(self.path),
            "root": None if self.root is None else str(self.root),
            "data": self.data,
            "beside": dict(self.beside),
        }

    @staticmethod
    def from_map(values: Mapping[str, Any]) -> "MeshRequest":
        """It again."""
        path, root = values["path"], values["root"]
        return MeshRequest(
            values["kind"],
            None if path is None else Path(path),
            None if root is None else Path(root),
            values["data"],
            values["beside"],
        )
