"""This installation of tfbus: its version, its clone, and whether it is complete and compiled."""

import os
import sys
from contextlib import suppress
from functools import cache

# Without pathlib, which a node needs for nothing else: 0.4 MB, and 2 ms of its start.
_HERE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_CLONE = os.path.dirname(_HERE)

_NAME, _END = "tfbus-", ".dist-info"


@cache
def installed_version() -> str:
    """As pip knows it; read at the first call."""
    # importlib.metadata would import as much as the rest of a node, for the name of a folder.
    for folder in sys.path:
        with suppress(OSError):
            for name in os.listdir(folder or "."):
                if name.startswith(_NAME) and name.endswith(_END):
                    return name[len(_NAME) : -len(_END)]
    from importlib.metadata import version

    return version("tfbus")


def version_and_origin() -> str:
    """For people, as in "0.1.0 (clone at 1a2b3c4, changed)"; asks git if there is a clone."""
    origin = commit_of_clone()
    return installed_version() + (f" ({origin})" if origin else "")


_SHOWN = 7
_GIT_WITHIN_S = 5.0


def commit_of_clone(clone: str = _CLONE) -> str:
    """As in "clone at 1a2b3c4, changed"; "" if tfbus is installed, and not run from a clone.

    "clone" alone if git is not there to say more.
    """
    if not all(os.path.exists(os.path.join(clone, name)) for name in (".git", "pyproject.toml")):
        return ""
    import subprocess  # 8 ms

    # In a hook of git these name the repository of the hook.
    environment = {name: value for name, value in os.environ.items() if name[:4] != "GIT_"}
    command = ["git", "--no-optional-locks", "status", "--porcelain=v2", "--branch", "-uno"]
    try:
        lines = subprocess.run(
            command,
            cwd=clone,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_GIT_WITHIN_S,
            text=True,
            errors="replace",
            check=True,
        ).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return "clone"
    commit = "".join(line.split()[2] for line in lines if line.startswith("# branch.oid "))
    at = f" at {commit[:_SHOWN]}" if commit.isalnum() else ""  # not "(initial)"
    is_changed = any(not line.startswith("#") for line in lines)
    return f"clone{at}{', changed' if is_changed else ''}"


# setup.py writes it beside the modules that it could not compile; pip hides its output.
_REASON = os.path.join(_HERE, "not_compiled.txt")

SLOWER = "lookups take about 70 times as long"


class InterpretedWarning(RuntimeWarning):
    """tfbus was to be compiled, and is not."""


def why_interpreted() -> str:
    """Why the compiler failed, as a sentence and the way out; "" if that was not tried.

    Of interest if the buffer is interpreted: the reason stays if it was compiled later.
    """
    try:
        with open(_REASON, encoding="utf-8") as file:
            reason = file.read().strip()
    except OSError:
        return ""
    return (
        f"tfbus runs without its compiled kernel, and {SLOWER}: {reason}. Install a C compiler and "
        f"the headers of Python, then: {compile_command()}"
    )


def compile_command(clone: str = _CLONE) -> str:
    """The command line that compiles this installation, once there is a C compiler: make's in the
    environment that it has made.
    """
    from shlex import quote  # each node imports this module

    if _is_clone(clone):
        has_makefile = os.path.exists(os.path.join(clone, "Makefile"))
        if has_makefile and sys.prefix == os.path.join(clone, ".venv"):
            return f"make -C {quote(clone)} kernel"
        return f"{_pip()} install --force-reinstall --no-deps --editable {quote(clone)}"
    return f"{_pip()} install --force-reinstall --no-deps --no-cache-dir --no-binary tfbus tfbus"


def install_command(extra: str, clone: str = _CLONE) -> str:
    """The command line that installs an extra: `pip install 'tfbus[bag]'`.

    pip needs no index for tfbus itself if it is installed, from a wheel or editable. If `pip` on
    PATH is not this Python's, it begins with this Python. Sources that are not installed are
    named by their folder.
    """
    from importlib import metadata
    from shlex import quote

    try:
        metadata.distribution("tfbus")
    except metadata.PackageNotFoundError:
        return f"{_pip()} install --editable {quote(f'{clone}[{extra}]')}"
    return f"{_pip()} install 'tfbus[{extra}]'"


def _is_clone(folder: str) -> bool:
    return all(
        os.path.exists(os.path.join(folder, name)) for name in ("setup.py", "pyproject.toml")
    )


def _pip() -> str:
    from shutil import which  # imports bz2 and lzma

    pip = which("pip")
    is_ours = pip is not None and os.path.dirname(pip) == os.path.dirname(sys.executable)
    return "pip" if is_ours else f"{sys.executable} -m pip"


def why_not_installed() -> str:
    """The missing part, and the remedy, as a sentence; "" if tfbus is installed.

    Python imports first from the folder it is started in. In a clone these are sources:
    they are not compiled, and the nodes lie elsewhere.
    """
    from importlib.util import find_spec

    if find_spec("tfbus.nodes") is not None:
        return ""
    return (
        f"Python has imported tfbus from the sources in {_CLONE}, where it is neither compiled nor "
        "complete: start Python in another folder to use the installed one, or install the sources "
        "in place with: pip install --editable ."
    )
