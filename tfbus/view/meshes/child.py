"""The process that reads mesh files.

A file of a stranger can make a reader take all memory, or for ever: that ends this process, and not
the page. It also leaves the page's own thread free. Requests come on standard input, answers go to
standard output; each is its length in 4 bytes, and msgpack.
"""

import os
import struct
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import IO, Any

import msgpack

from tfbus.runtime.limited_process import limit_this_process
from tfbus.view.meshes.mesh import MOST_BYTES, MOST_MEMORY, MeshError, MeshRequest

HEADER = struct.Struct(">I")


def send(pipe: IO[bytes], values: dict[str, Any]) -> None:
    """Write a message."""
    payload = msgpack.packb(values)
    pipe.write(HEADER.pack(len(payload)))
    pipe.write(payload)
    pipe.flush()


def receive(pipe: IO[bytes]) -> dict[str, Any] | None:
    """Read a message; None at the end."""
    header = pipe.read(HEADER.size)
    if len(header) < HEADER.size:
        return None
    (length,) = HEADER.unpack(header)
    payload = pipe.read(length)
    if len(payload) < length:
        return None
    values: dict[str, Any] = msgpack.unpackb(payload, strict_map_key=False)
    return values


def answer(values: dict[str, Any]) -> dict[str, Any]:
    """The triangles of a request for a mesh, or `error` with a sentence."""
    from tfbus.view.meshes.read import References, read_mesh

    request = MeshRequest.from_map(values)
    try:
        folder = None if request.path is None else request.path.parent
        references = References(folder, request.root, request.beside)
        data = request.data if request.path is None else _content(request.path)
        parts = read_mesh(request.kind, data, references, request.texture, request.heeds_up_axis)
    except (MeshError, OSError) as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "it needs too much memory"}
    # Mesh readers raise all kinds of errors, ImportError among them.
    except Exception as error:
        return {
            "error": f"it is not a valid .{request.kind} file ({error or type(error).__name__})"
        }
    return {"parts": [part.as_map() for part in parts], "refused": references.refused}


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise MeshError("no such file")
    if (size := path.stat().st_size) > MOST_BYTES:
        raise MeshError(f"it has {size / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} are read")
    return path.read_bytes()


def main() -> None:
    """Answer until standard input ends."""
    # Readers may print; that must not be taken for an answer.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    limit_this_process(memory_bytes=MOST_MEMORY)
    with suppress(ImportError):  # said of each file
        import_module("tfbus.view.meshes.read")
    send(answers, {"ready": True})
    while (values := receive(sys.stdin.buffer)) is not None:
        send(answers, answer(values))
