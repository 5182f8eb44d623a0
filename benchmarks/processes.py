"""The peers as processes: each starts once, is asked many times, and says why where it cannot."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

HERE = Path(__file__).parent
_DEBIANS_PYTHON = "/usr/bin/python3"


class Unavailable(Exception):
    """A peer cannot be measured, or not in this."""


class Process:
    """A peer that speaks the protocol of worker.py."""

    # What the commands of all processes are put behind, such as a profiler's.
    under: ClassVar[list[str]] = []
    # What their environment has besides ours.
    more_env: ClassVar[dict[str, str]] = {}

    def __init__(self, command: list[str], folder: Path):
        # A peer sees what is installed for its Python, and `folder`; never the tree of sources.
        env = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
        self._popen = subprocess.Popen(
            [*self.under, *command],
            cwd=folder,
            env=env | self.more_env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, request: str) -> str:
        """The answer to one line. Raises Unavailable with the reason."""
        assert self._popen.stdin and self._popen.stdout
        with suppress(BrokenPipeError):  # it has said why
            print(request, file=self._popen.stdin, flush=True)
        answer = self._popen.stdout.readline().strip()
        if not answer or answer.startswith("unavailable: "):
            raise Unavailable(answer.removeprefix("unavailable: ") or "its process has ended")
        return answer

    def measure(self, request: str) -> float:
        """The answer, which is a number."""
        return float(self.ask(request))

    def close(self) -> None:
        """End it."""
        self._popen.communicate()


def start(peer: str, folder: Path) -> Process:
    """A process of a peer, in an empty folder of its own. Raises Unavailable where it cannot be."""
    (folder / "benchmarks").symlink_to(HERE)
    return PEERS[peer](folder)


def start_worker(module: str, folder: Path) -> Process:
    """A process of one module of benchmarks.peers, in an empty folder of its own."""
    (folder / "benchmarks").symlink_to(HERE)
    return _worker(module)(folder)


def _worker(module: str) -> Callable[[Path], Process]:
    return lambda folder: Process([sys.executable, "-m", "benchmarks.worker", module], folder)


def _interpreted(folder: Path) -> Process:
    """tfbus from a copy of its Python files, without the compiled modules."""
    shutil.copytree(
        HERE.parent / "tfbus",
        folder / "tfbus",
        ignore=shutil.ignore_patterns("*.so", "*.pyd", "__pycache__"),
    )
    return _worker("tfbus")(folder)


def _tf2_cpp(folder: Path) -> Process:
    program = str(folder / "tf2_cpp")
    source = str(HERE / "peers" / "tf2_cpp.cpp")
    libraries = ["-ltf2", "-lrostime", "-lconsole_bridge"]
    try:
        subprocess.run(
            ["g++", "-std=c++17", "-O2", "-o", program, source, *libraries],
            check=True,
            capture_output=True,
        )
    except FileNotFoundError:
        raise Unavailable("there is no g++") from None
    except subprocess.CalledProcessError:
        raise Unavailable("it does not compile: apt-get install libtf2-dev") from None
    return Process([program], folder)


def _tf2_py(folder: Path) -> Process:
    if not Path(_DEBIANS_PYTHON).exists():
        raise Unavailable(f"there is no {_DEBIANS_PYTHON}")
    return Process([_DEBIANS_PYTHON, "-m", "benchmarks.worker", "tf2_py"], folder)


TFBUS = "tfbus"
INTERPRETED = "tfbus interpreted"
# No process: a number to stay within, which is what it is asked.
LIMIT = "a limit"

PEERS: dict[str, Callable[[Path], Process]] = {
    TFBUS: _worker("tfbus"),
    INTERPRETED: _interpreted,
    "tf2 from C++": _tf2_cpp,
    "tf2_py": _tf2_py,
    "schiebung": _worker("schiebung"),
    "transform-tree": _worker("transform_tree"),
    "pytransform3d": _worker("pytransform3d"),
}
