"""Loads mesh files on two threads, each file once, while the page goes on."""

import math
import threading
import time
from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass, replace
from pathlib import Path

from tfbus.errors import TfbusError
from tfbus.view.meshes.fair_turns import FairTurns
from tfbus.view.meshes.guard import MeshError
from tfbus.view.meshes.limits import KINDS, LONGEST_S, MOST_BYTES
from tfbus.view.meshes.reader import MeshReader, ReadMesh
from tfbus.view.meshes.request import MeshRequest

# A mesh of another machine may bring this many materials and pictures.
_MOST_BESIDE = 16

# A file that takes longer makes way for others: nearly all take less than a second.
_MAKES_WAY_S = 10.0

# Why a file is not there that a mesh in memory names.
_ABSENT = "it did not come with the mesh"

# `fetch(origin, name, within_s)` is the content of a mesh of another machine, and `beside(name)` of
# a file beside it; they raise TfbusError.
Fetch = Callable[[str, str, float], bytes]
FetchBeside = Callable[[str], bytes]


@dataclass(frozen=True)
class MeshSource:
    """A mesh file: its `name` in the URDF, and its `path` on this machine, inside of `root`, or
    None if it is fetched from its robot's namespace `origin`. `version` differs if the
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
    """Loads mesh files until `close`; from any thread.

    Senders take turns, by the time that their files have taken. A file that takes more than 10 s
    makes way, and is read once more beside the others, for at most 60 s: so a stranger's file holds
    up those of others for a moment only. `fetch` gets those of other machines. With
    `heeds_up_axis` a DAE is turned by the up axis that it states; RViz does not.
    """

    def __init__(self, fetch: Fetch | None = None, *, heeds_up_axis: bool = False) -> None:
        self._fetch = fetch
        self._heeds_up_axis = heeds_up_axis
        self._lock = threading.Lock()
        self._known: dict[MeshSource, ReadMesh | str | None] = {}
        self._is_closed = False
        slow = _Lane("slow meshes", LONGEST_S, self._load, None)
        self._lanes = (_Lane("meshes", _MAKES_WAY_S, self._load, slow), slow)

    def load(self, source: MeshSource, sender: Hashable = "") -> None:
        """Ask for a file that a sender wants; again is fine."""
        with self._lock:
            if source in self._known or self._is_closed:
                return
            self._known[source] = None
        self._lanes[0].add(sender, source)

    def found(self, source: MeshSource) -> ReadMesh | str | None:
        """The mesh, or why there is none; None while it is not known."""
        with self._lock:
            return self._known.get(source)

    def keep(self, sources: Collection[MeshSource]) -> None:
        """Forget all others."""
        with self._lock:
            self._known = {key: value for key, value in self._known.items() if key in sources}
        for lane in self._lanes:
            lane.keep(sources)

    def close(self) -> None:
        """End it, also in the middle of a file. Twice is fine."""
        with self._lock:
            self._is_closed = True
        for lane in self._lanes:
            lane.close()

    def _load(self, source: MeshSource, reader: MeshReader, within_s: float) -> bool:
        """Load a file; False if that takes longer."""
        deadline_s = math.inf
        try:
            # That it starts is not the file's doing.
            reader.start()
            deadline_s = time.monotonic() + within_s
            task = _Task(source, reader, deadline_s, self._fetch, heeds_up_axis=self._heeds_up_axis)
            mesh: ReadMesh | str = task.read()
        except TfbusError as error:
            if time.monotonic() >= deadline_s and within_s < LONGEST_S:
                return False
            mesh = str(error)
        except OSError as error:
            mesh = f"it cannot be read: {error.strerror or error}"
        with self._lock:
            if source in self._known:
                self._known[source] = mesh
        return True


class _Lane:
    """A thread that reads files, each for at most `most_s`; one that is late goes to `slower`.

    `load(source, reader, within_s)` says whether it was done in time.
    """

    def __init__(
        self,
        name: str,
        most_s: float,
        load: Callable[[MeshSource, MeshReader, float], bool],
        slower: "_Lane | None",
    ) -> None:
        self._name = name
        self._most_s = most_s
        self._load = load
        self._slower = slower
        self._reader = MeshReader()
        self._lock = threading.Lock()
        self._turns: FairTurns[MeshSource] = FairTurns()
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def add(self, sender: Hashable, source: MeshSource) -> None:
        with self._lock:
            if self._is_closed:
                return
            self._turns.add(sender, source)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()

    def keep(self, sources: Collection[MeshSource]) -> None:
        with self._lock:
            self._turns.keep(lambda source: source in sources)

    def close(self) -> None:
        with self._lock:
            self._is_closed = True
            self._turns.clear()
        self._reader.close()

    def _run(self) -> None:
        while (following := self._next()) is not None:
            sender, source = following
            began_s = time.monotonic()
            is_done = self._load(source, self._reader, self._most_s)
            with self._lock:
                self._turns.use(sender, time.monotonic() - began_s)
            if not is_done and self._slower is not None:
                self._slower.add(sender, source)

    def _next(self) -> tuple[Hashable, MeshSource] | None:
        with self._lock:
            following = self._turns.next()
            if following is None:
                self._thread = None
                # Memory that a robot of many meshes took is given back.
                self._reader.rest()
            return following


class _Task:
    """Reads one file until `deadline_s`."""

    def __init__(
        self,
        source: MeshSource,
        reader: MeshReader,
        deadline_s: float,
        fetch: Fetch | None,
        *,
        heeds_up_axis: bool,
    ) -> None:
        self._source = source
        self._heeds_up_axis = heeds_up_axis
        self._reader = reader
        self._deadline_s = deadline_s
        self._from_elsewhere = fetch

    @property
    def _left_s(self) -> float:
        return max(0.0, self._deadline_s - time.monotonic())

    def read(self) -> ReadMesh:
        """Read it. Raises TfbusError and OSError."""
        source = self._source
        if not source.texture:
            return self._read_with(source, None)
        try:
            texture = self._texture(source)
        except (TfbusError, OSError) as error:
            read = self._read_with(source, None)
            why = getattr(error, "strerror", None) or str(error)
            return replace(read, refused={**read.refused, source.texture: why})
        return self._read_with(source, (source.texture, texture))

    def _fetch(self, origin: str, name: str) -> bytes:
        if self._from_elsewhere is None:
            raise MeshError("it is not on this machine")
        return self._from_elsewhere(origin, name, self._left_s)

    def _texture(self, source: MeshSource) -> bytes:
        if source.path is None and self._from_elsewhere is not None:
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
        request = MeshRequest(
            source.kind,
            source.path,
            source.root,
            texture=texture,
            heeds_up_axis=self._heeds_up_axis,
        )
        if source.path is not None:
            return self._reader.read(request, self._left_s)
        data = self._fetch(source.origin, source.name)
        request = replace(request, root=None, data=data)
        read = self._reader.read(request, self._left_s)
        beside = self._beside(lambda name: self._fetch(source.origin, name), source.name, read)
        if not beside:
            return read
        return self._reader.read(replace(request, beside=beside), self._left_s)

    def _beside(self, fetch: FetchBeside, name: str, read: ReadMesh) -> dict[str, bytes]:
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
