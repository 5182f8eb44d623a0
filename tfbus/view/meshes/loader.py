"""Loads mesh files on a thread, each once, while the page goes on."""

import threading
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

from tfbus.errors import TfbusError
from tfbus.view.meshes.guard import MeshError
from tfbus.view.meshes.limits import KINDS, MOST_BYTES
from tfbus.view.meshes.reader import MeshReader, ReadMesh
from tfbus.view.meshes.request import MeshRequest

# A mesh of another machine may bring this many materials and pictures.
_MOST_BESIDE = 16

# Why a file is not there that a mesh in memory names.
_ABSENT = "it did not come with the mesh"

# `fetch(name)` is the content of a mesh of another machine; it raises TfbusError.
Fetch = Callable[[str], bytes]


@dataclass(frozen=True)
class MeshSource:
    """A mesh file: its `name` in the URDF, and its `path` on this machine, inside of `root`, or
    None where it is fetched from its robot's namespace `origin`. `version` differs where the
    content may. `texture` is the name of the picture that the URDF gives it, "" for none, which is
    at `texture_path` if the mesh is on this machine.
    """

    name: str
    path: Path | None = None
    root: Path | None = None
    origin: str = ""
    version: str = ""
    texture: str = ""
    texture_path: Path | None = None

    @property
    def kind(self) -> str:
        """Its suffix, such as "stl"."""
        return self.name.rpartition(".")[2].lower()


class MeshLoader:
    """Loads mesh files in the order in which they are asked for, until `close`; from any thread.

    `fetch(origin, name)` gets those of other machines.
    """

    def __init__(self, fetch: Callable[[str, str], bytes] | None = None) -> None:
        self._fetch = fetch
        self._reader = MeshReader()
        self._lock = threading.Lock()
        self._waiting: deque[MeshSource] = deque()
        self._known: dict[MeshSource, ReadMesh | str | None] = {}
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def load(self, source: MeshSource) -> None:
        """Ask for a file; again is fine."""
        with self._lock:
            if source in self._known or self._is_closed:
                return
            self._known[source] = None
            self._waiting.append(source)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="meshes", daemon=True)
                self._thread.start()

    def found(self, source: MeshSource) -> ReadMesh | str | None:
        """The mesh, or why there is none; None while it is not known."""
        with self._lock:
            return self._known.get(source)

    def keep(self, sources: Collection[MeshSource]) -> None:
        """Forget all others."""
        with self._lock:
            self._known = {key: value for key, value in self._known.items() if key in sources}
            self._waiting = deque(source for source in self._waiting if source in sources)

    def close(self) -> None:
        """End it, also in the middle of a file. Twice is fine."""
        with self._lock:
            self._is_closed = True
            self._waiting.clear()
        self._reader.close()

    def _run(self) -> None:
        while (source := self._next()) is not None:
            try:
                mesh: ReadMesh | str = self._read(source)
            except TfbusError as error:
                mesh = str(error)
            except OSError as error:
                mesh = f"it cannot be read: {error.strerror or error}"
            with self._lock:
                if source in self._known:
                    self._known[source] = mesh

    def _next(self) -> MeshSource | None:
        with self._lock:
            if self._waiting:
                return self._waiting.popleft()
            self._thread = None
            # Memory that a robot of many meshes took is given back.
            self._reader.rest()
            return None

    def _read(self, source: MeshSource) -> ReadMesh:
        if not source.texture:
            return self._read_with(source, None)
        try:
            texture = self._texture(source)
        except (TfbusError, OSError) as error:
            read = self._read_with(source, None)
            why = getattr(error, "strerror", None) or str(error)
            return replace(read, refused={**read.refused, source.texture: why})
        return self._read_with(source, (source.texture, texture))

    def _texture(self, source: MeshSource) -> bytes:
        if source.path is None and self._fetch is not None:
            return self._fetch(source.origin, source.texture)
        path = source.texture_path
        if path is None:
            raise MeshError("there is no such picture in the mesh's package")
        if path.stat().st_size > MOST_BYTES:
            raise MeshError(f"it has more than {MOST_BYTES // 10**6} MB")
        return path.read_bytes()

    def _read_with(self, source: MeshSource, texture: tuple[str, bytes] | None) -> ReadMesh:
        if source.kind not in KINDS:
            raise MeshError(f"no reader for .{source.kind}: convert it to STL, DAE, OBJ or GLB")
        if source.path is not None:
            return self._reader.read(
                MeshRequest(source.kind, source.path, source.root, texture=texture)
            )
        fetch = self._fetch
        if fetch is None:
            raise MeshError("it is not on this machine")
        request = MeshRequest(source.kind, data=fetch(source.origin, source.name), texture=texture)
        read = self._reader.read(request)
        beside = self._beside(lambda name: fetch(source.origin, name), source.name, read)
        return self._reader.read(replace(request, beside=beside)) if beside else read

    def _beside(self, fetch: Fetch, name: str, read: ReadMesh) -> dict[str, bytes]:
        """The files that a fetched mesh names, those that its robot has."""
        folder = name.rpartition("/")[0]
        found: dict[str, bytes] = {}
        for each, why in list(read.refused.items())[:_MOST_BESIDE]:
            if why == _ABSENT and not each.startswith("/") and ":" not in each:
                try:
                    found[each] = fetch(f"{folder}/{each}" if folder else each)
                except TfbusError:
                    continue
        return found
