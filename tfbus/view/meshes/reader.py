"""The page's end of the process that reads mesh files."""

import os
import subprocess
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from tfbus.runtime.limited_process import command_of
from tfbus.view.meshes.child import receive, send
from tfbus.view.meshes.guard import MeshError
from tfbus.view.meshes.limits import LONGEST_S
from tfbus.view.meshes.part import Part
from tfbus.view.meshes.request import MeshRequest


@dataclass(frozen=True)
class ReadMesh:
    """The parts of a mesh file; `refused` says of the files that it names and that could not be had
    why.
    """

    parts: tuple[Part, ...]
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
        return ReadMesh(tuple(map(Part.from_map, answer["parts"])), answer["refused"])

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
                command_of("tfbus.view.meshes.child"),
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
            with suppress(OSError):  # what was not yet written
                pipe.close()
    process.wait()
