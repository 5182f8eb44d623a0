"""Expands a xacro file into a URDF."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tfbus.errors import UrdfError
from tfbus.robot.mesh_files import MeshFiles
from tfbus.wording import printable

# xacro keeps what it reads in its module.
_LOCK = threading.Lock()


class Expanded(NamedTuple):
    """What a xacro file stands for, the files that it includes, and what xacro warns of."""

    text: str
    included: tuple[Path, ...]
    warnings: tuple[str, ...]


def expand(path: Path, arguments: Mapping[str, str], files: MeshFiles) -> Expanded:
    """The URDF that a xacro file stands for.

    `$(find package)` looks where meshes are searched. Raises UrdfError where xacro is not
    installed, or cannot expand the file.
    """
    try:
        import xacro
        from xacro import substitution_args
    except ImportError:
        raise UrdfError(f"{path} needs xacro: pip install 'xacro>=2.1'") from None

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
        _LOCK,
        _patched(substitution_args, "_eval_find", find),
        # It would print them.
        _patched(xacro, "warning", warn),
    ):
        xacro.all_includes.clear()
        try:
            document = xacro.process_file(str(path), mappings=dict(arguments))
            text = document.toprettyxml(indent="  ")
        except UrdfError as error:
            raise UrdfError(f"{path}: {error}") from None
        # It raises all kinds of errors, of what it evaluates too.
        except Exception as error:
            raise UrdfError(_mistake(xacro, path, error)) from None
        included = tuple(Path(os.path.abspath(each)) for each in dict.fromkeys(xacro.all_includes))
    return Expanded(text, included, tuple(warnings))


@contextlib.contextmanager
def _patched(module: Any, name: str, value: Any) -> Iterator[None]:
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


def _mistake(xacro: Any, path: Path, error: Exception) -> str:
    """What xacro could not do, and in which file and macro."""
    reason = " ".join(str(error).split()) or type(error).__name__
    stack = [each for each in (xacro.filestack or []) if each and each != str(path)]
    inside = f" (in {stack[-1]})" if stack else ""
    return f"{path}{inside}: xacro cannot expand it: {printable(reason, 300)}"
