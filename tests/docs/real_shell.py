"""The commands of a page as a reader's shell runs them: in real processes."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import zenoh

from tests.buses import DEADLINE_S
from tests.docs.pages import CONFIGURATIONS
from tests.live_bus import Bus, Process, free_port

# Finds the command `tfbus` of this environment, activated or not.
PATH = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

# The router's port in the docs; a free port stands in for it.
_ROUTER_PORT = "7447"

_KEYS = {"up": b"\x1b[A", "down": b"\x1b[B", "right": b"\x1b[C", "left": b"\x1b[D"}


class RealShell:
    """Bash in a folder, whose commands are on a bus."""

    def __init__(self, bus: Bus, folder: Path):
        self.folder = folder
        self._bus = bus
        self._port = str(free_port())
        self._env = bus.env | {
            "PATH": PATH,
            "ZENOH_CONFIG": str(_for_plain_zenoh(bus, folder / "zenoh.json5")),
        }
        copy_configurations(folder / "configs")

    def here(self, text: str) -> str:
        """The text of a page, with the ports that are free here."""
        return text.replace(_ROUTER_PORT, self._port)

    def run(self, line: str, exit_code: int = 0) -> str:
        """The output of a command that ends by itself, with this exit code."""
        return self._run(["bash", "-c", line], exit_code)

    def run_python(self, text: str) -> None:
        """Run a program to its end."""
        self._run([sys.executable, "-c", text])

    def start(self, line: str) -> Process:
        """A command that goes on."""
        return self._bus.start_command(["bash", "-c", line], env=self._env, cwd=self.folder)

    def terminal(self, keys: list[str]) -> tuple[str, "Terminal"]:
        """A stack in which a command reads from a terminal, and that terminal."""
        terminal = Terminal(keys)
        return f"exec {{}} <{terminal.name}", terminal

    def _run(self, command: list[str], exit_code: int = 0) -> str:
        done = subprocess.run(
            command,
            env=self._env,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=DEADLINE_S,
        )
        assert done.returncode == exit_code, (
            f"{command} ended with {done.returncode}: {done.stdout}"
        )
        return done.stdout


class Terminal:
    """A terminal, and the keys that are typed there."""

    def __init__(self, keys: list[str]):
        self._keys = keys
        self._keyboard, self._terminal = pty.openpty()
        self.name = os.ttyname(self._terminal)

    def type(self) -> None:
        """Type them."""
        for key in self._keys:
            os.write(self._keyboard, _KEYS.get(key, key.encode()))

    def close(self) -> None:
        """Close its window."""
        os.close(self._keyboard)
        os.close(self._terminal)


def copy_configurations(folder: Path) -> None:
    """Write configs/*.json5 without multicast, which would reach other buses than the test's."""
    folder.mkdir()
    for path in CONFIGURATIONS:
        config = zenoh.Config.from_file(path)
        config.insert_json5("scouting/multicast/enabled", "false")
        (folder / path.name).write_text(str(config))


def _for_plain_zenoh(bus: Bus, path: Path) -> Path:
    """Write a configuration for programs that do not know tfbus's own settings."""
    config = zenoh.Config.from_file(bus.config)
    config.insert_json5("connect/endpoints", json.dumps([bus.endpoint]))
    path.write_text(str(config))
    return path
