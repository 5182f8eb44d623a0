"""Expands a xacro file into a URDF, in a process with limits."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from tfbus.errors import UrdfError
from tfbus.robot.mesh_files import MeshFiles
from tfbus.robot.xacro_child import MOST_CPU_S
from tfbus.runtime.limited_process import command_of

# Also of a file that waits, as a named pipe does; a busy machine takes longer than the time counts.
_LONGEST_S = 4 * MOST_CPU_S


class Expanded(NamedTuple):
    """The text of an expanded xacro file, the files that it includes, and what xacro warns of."""

    text: str
    included: tuple[Path, ...]
    warnings: tuple[str, ...]


def expand(path: Path, arguments: Mapping[str, str], files: MeshFiles) -> Expanded:
    """The URDF that a xacro file stands for.

    `$(find package)` looks where meshes are searched. Raises UrdfError if xacro is not
    installed, or cannot expand the file, or not within 30 s of CPU and 2 GB of memory.
    """
    if find_spec("xacro") is None:
        raise UrdfError(f"{path} needs xacro: pip install 'xacro>=2.1'")
    request = {
        "path": str(path),
        "arguments": dict(arguments),
        "package_path": [str(each) for each in files.package_path],
    }
    try:
        done = subprocess.run(
            command_of("tfbus.robot.xacro_child"),
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
