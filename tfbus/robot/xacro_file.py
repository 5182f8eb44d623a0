"""Expands a xacro file into a URDF, in a process with limits.

Expressions and macros can take for ever. The request of that process, which runs `main`, comes on
standard input, its answer goes to standard output, both in JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tfbus.base.errors import UrdfError
from tfbus.base.installation import install_command
from tfbus.base.limited_process import command_of, limit_this_process
from tfbus.base.wording import printable
from tfbus.robot.mesh_files import MeshFiles

# A robot of a thousand links takes 3 s and 0.2 GB.
MOST_CPU_S = 30.0
MOST_MEMORY = 2_000_000_000


def main() -> None:
    """Expand one file."""
    # xacro and the expressions in a file may print; that must not be taken for an answer.
    answer = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    request = json.load(sys.stdin)
    limit_this_process(memory_bytes=MOST_MEMORY, cpu_s=MOST_CPU_S)
    path = request["path"]
    files = MeshFiles(Path(path).parent, [Path(each) for each in request["package_path"]])
    try:
        values = _expand(path, request["arguments"], files)
    except UrdfError as error:
        values = {"error": str(error)}
    except MemoryError:
        values = {"error": f"{path}: xacro needs more than {MOST_MEMORY // 10**9} GB to expand it"}
    with answer:
        json.dump(values, answer)


def _expand(path: str, arguments: Mapping[str, str], files: MeshFiles) -> dict[str, Any]:
    import xacro
    from xacro import substitution_args

    def find(package: str) -> str:
        folder = files.package(package)
        if folder is None:
            raise UrdfError(
                f"no package '{printable(package, 60)}' for $(find ...); --package-path (in Python "
                "package_path) names the folder that it is in"
            )
        return str(folder)

    warnings: list[str] = []

    def warn(*words: object, **_: object) -> None:
        said = " ".join(" ".join(map(str, words)).split())
        warnings.append(f"{path}: xacro: {printable(said, 300)}")

    with (
        _patched(substitution_args, "_eval_find", find),
        # It would print them.
        _patched(xacro, "warning", warn),
    ):
        try:
            document = xacro.process_file(path, mappings=dict(arguments))
            text = document.toprettyxml(indent="  ")
        except UrdfError as error:
            raise UrdfError(f"{path}: {error}") from None
        except MemoryError:
            raise
        # It raises all kinds of errors, of evaluated expressions too.
        except Exception as error:
            raise UrdfError(_mistake(xacro, path, error)) from None
    included = [os.path.abspath(each) for each in dict.fromkeys(xacro.all_includes)]
    return {"text": text, "included": included, "warnings": warnings}


@contextlib.contextmanager
def _patched(module: Any, name: str, value: Any) -> Iterator[None]:
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


def _mistake(xacro: Any, path: str, error: Exception) -> str:
    """The failure of xacro, and in which file and macro."""
    reason = " ".join(str(error).split()) or type(error).__name__
    stack = [each for each in (xacro.filestack or []) if each and each != path]
    inside = f" (in {stack[-1]})" if stack else ""
    return f"{path}{inside}: xacro cannot expand it: {printable(reason, 300)}"


# Also of a file that waits, as a named pipe does; a busy machine takes longer than the time counts.
_LONGEST_S = 4 * MOST_CPU_S


@dataclass(frozen=True)
class Expanded:
    """The text of an expanded xacro file, the files that it includes, and xacro's warnings."""

    text: str
    included: tuple[Path, ...]
    warnings: tuple[str, ...]


def expand(path: Path, arguments: Mapping[str, str], files: MeshFiles) -> Expanded:
    """The URDF that a xacro file stands for.

    `$(find package)` looks where meshes are searched. Raises UrdfError if xacro is not
    installed, or cannot expand the file, or not within 30 s of CPU and 2 GB of memory.
    """
    if find_spec("xacro") is None:
        raise UrdfError(f"{path} needs xacro: {install_command('robot')}")
    request = {
        "path": str(path),
        "arguments": dict(arguments),
        "package_path": [str(each) for each in files.package_path],
    }
    try:
        done = subprocess.run(
            command_of("tfbus.robot.xacro_file"),
            input=json.dumps(request).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_LONGEST_S,
        )
        answer = json.loads(done.stdout)
    except OSError as error:
        raise UrdfError(f"{path}: xacro cannot be started: {error.strerror or error}") from None
    except subprocess.TimeoutExpired:
        raise _too_slow(path) from None
    except ValueError:
        raise _ended(path, done.returncode) from None
    if "error" in answer:
        raise UrdfError(answer["error"])
    included = tuple(map(Path, answer["included"]))
    return Expanded(answer["text"], included, tuple(answer["warnings"]))


def _ended(path: Path, code: int) -> UrdfError:
    """The error of a process that gave no answer, by its exit code."""
    if -code in (getattr(signal, "SIGXCPU", 0), getattr(signal, "SIGKILL", 0)):
        return _too_slow(path)
    try:
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
    except ValueError:
        how = f"by signal {-code}"
    return UrdfError(
        f"{path}: the process that expands it crashed, {how}: `python -m xacro {path}` shows more"
    )


def _too_slow(path: Path) -> UrdfError:
    return UrdfError(
        f"{path}: xacro has not expanded it within {MOST_CPU_S:g} s of CPU: look for an expression "
        "that grows, or macros that call macros many times"
    )
