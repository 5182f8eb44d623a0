"""Loads mesh files on two threads, each file once, in processes of their own."""

import math
import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Hashable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from tfbus.base.errors import TfbusError
from tfbus.base.limited_process import command_of
from tfbus.view.meshes.mesh import (
    KINDS,
    LONGEST_S,
    MOST_BYTES,
    MeshError,
    MeshPart,
    MeshRequest,
    receive,
    send,
)

T = TypeVar("T")

_MOST_REMEMBERED = 1_000


class FairTurns(Generic[T]):
    """Items that wait, each of a sender: the next is of the sender that has used the least time.

    A sender that comes anew, or again, begins where the last turn was: neither is past idleness a
    credit, nor does another name make one younger. Not safe from several threads at once.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, deque[T]] = {}
        self._used_s: dict[Hashable, float] = {}
        self._turn_s = 0.0

    def add(self, sender: Hashable, item: T) -> None:
        """Add an item at the end of its sender's."""
        if sender not in self._waiting:
            self._waiting[sender] = deque()
            self._used_s[sender] = max(self._used_s.get(sender, 0.0), self._turn_s)
        self._waiting[sender].append(item)

    def next(self) -> tuple[Hashable, T] | None:
        """Take the next item, with its sender; None if none waits."""
        if not self._waiting:
            return None
        sender = min(self._waiting, key=self._used_s.__getitem__)
        self._turn_s = self._used_s[sender]
        items = self._waiting[sender]
        item = items.popleft()
        if not items:
            del self._waiting[sender]
        return sender, item

    def use(self, sender: Hashable, seconds: float) -> None:
        """A sender has used this time."""
        self._used_s[sender] = max(self._used_s.get(sender, 0.0), self._turn_s) + seconds
        if len(self._used_s) > _MOST_REMEMBERED:
            self._used_s = {
                each: used
                for each, used in self._used_s.items()
                if each in self._waiting or used > self._turn_s
            }

    def keep(self, is_wanted: Callable[[T], bool]) -> None:
        """Forget the other items."""
        kept = {each: deque(filter(is_wanted, items)) for each, items in self._waiting.items()}
        self._waiting = {each: items for each, items in kept.items() if items}

    def clear(self) -> None:
        """Forget all items."""
        self._waiting.clear()


@dataclass(frozen=True)
class ReadMesh:
    """The parts of a mesh file; `refused` says of the files that it names and that could not be had
    why.
    """

    parts: tuple[MeshPart, ...]
    refused: dict[str, str] = field(default_factory=dict)


class MeshReader:
    """Reads mesh files in a process that starts with the first one, until `close`.

    For one thread; `close` is for any.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_closed = False

    def read(self, request: MeshRequest, within_s: float = LONGEST_S) -> ReadMesh:
        """Read a file. Raises MeshError, also if it takes longer."""
        answer = self._answer(self._process_now(), request, within_s)
        if answer is None:
            raise MeshError(f"reading it took more than {within_s:.0f} s, or too much memory")
        if "error" in answer:
            raise MeshError(answer["error"])
        return ReadMesh(tuple(map(MeshPart.from_map, answer["parts"])), answer["refused"])

    def start(self) -> None:
        """Start the process, and wait until it can read. Raises MeshError if it cannot."""
        self._process_now()

    def _answer(
        self, process: "subprocess.Popen[bytes]", request: MeshRequest | None, within_s: float
    ) -> dict[str, Any] | None:
        """The answer of the process, without a request that it is ready; None if it does not, and
        is ended.
        """
        late = threading.Timer(within_s, process.kill)
        late.daemon = True
        late.start()
        answer: dict[str, Any] | None
        try:
            assert process.stdin is not None and process.stdout is not None
            if request is not None:
                send(process.stdin, request.as_map())
            answer = receive(process.stdout)
        except (OSError, ValueError):  # the pipes of a process that `close` has ended
            answer = None
        finally:
            late.cancel()
        if answer is None:
            self.rest()
            if self._is_closed:
                raise MeshError("the page has ended")
        return answer

    def rest(self) -> None:
        """End the process; a later file starts another."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            _end(process)

    def close(self) -> None:
        """End the process, also in the middle of a file. Twice is fine."""
        self._is_closed = True
        self.rest()

    def _process_now(self) -> "subprocess.Popen[bytes]":
        with self._lock:
            if self._is_closed:
                raise MeshError("the page has ended")
            if self._process is not None:
                return self._process
            process = self._process = subprocess.Popen(
                command_of("tfbus.view.meshes.read"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                # Threads for matrices would count as memory.
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                # Ctrl-C ends it by its input.
                start_new_session=True,
            )
        if self._answer(process, None, LONGEST_S) is None:
            raise MeshError("the process that reads meshes does not start")
        return process


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):  # of bytes not yet written
                pipe.close()
    process.wait()


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
    up other senders' for a moment only. `fetch` gets the files of other machines. With
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
        """The files that a fetched mesh names, as far as its robot has them."""
        folder = name.rpartition("/")[0]
        found: dict[str, bytes] = {}
        for each, why in list(read.refused.items())[:_MOST_BESIDE]:
            if why == _ABSENT and not each.startswith("/") and ":" not in each:
                try:
                    found[each] = fetch(f"{folder}/{each}" if folder else each)
                except TfbusError:
                    continue
        return found
