"""The commands of a page on a simulated bus: tfbus, Python, and the little else that is needed."""

import re
import runpy
import shlex
import sys
import time
from pathlib import Path

import tfbus.__main__
from tests.buses import DEADLINE_S
from tests.docs.pages import Block, Section, commands
from tests.simulated_bus import Bus
from tfbus.testing.programs import Program

# Tools with a window, a page, files of their own or routers, and programs that see the network.
_REAL_TOOLS = re.compile(r"tfbus (view|foxglove|router|create|completion|keys|ros1|ros2)\b|view:=")
_REAL_PROGRAMS = re.compile(r"^\s*(import|from) (zenoh|http|subprocess|tfbus\.view)\b", re.M)
# A setting of tfbus in front of a command, and a file behind it that takes the output.
_COMMAND = re.compile(r"(?P<env>(TFBUS_\w+=\S+ )*)(?P<command>[^|<>&;]+)(> (?P<file>[\w.]+))?")
_PROGRAMS = ("tfbus", "python", "sleep", "cat", "head")


def can_follow(section: Section) -> bool:
    """Whether all that a section does can be simulated."""
    return all(_can_do(block) for block in section.blocks if block.is_run)


def _can_do(block: Block) -> bool:
    if _REAL_PROGRAMS.search(block.text) or block.rule == "typed:":
        return False
    if block.language != "console" or block.rule == "file:":
        return True
    return not _REAL_TOOLS.search(block.text) and all(
        _COMMAND.fullmatch(command.line) and command.line.split()[0] in _PROGRAMS
        for command in commands(block)
    )


class SimulatedShell:
    """A shell in a folder, which is the current one, whose commands are on a simulated bus."""

    def __init__(self, bus: Bus, folder: Path):
        self.folder = folder
        self._bus = bus
        self._former_modules = set(sys.modules)

    def here(self, text: str) -> str:
        """The text of a page."""
        return text

    def run(self, line: str, exit_code: int = 0) -> str:
        """The output of a command that ends by itself, with this exit code."""
        parts = _COMMAND.fullmatch(line)
        assert parts
        name, *arguments = shlex.split(parts["command"])
        if name == "sleep":
            time.sleep(float(arguments[0]))
            return ""
        if name == "cat":
            return Path(arguments[0]).read_text()
        if name == "head":
            count, path = arguments
            return "".join(Path(path).read_text().splitlines(keepends=True)[: -int(count)])
        env = dict(each.split("=") for each in parts["env"].split())
        program = self._start(name, arguments, env, is_merged=parts["file"] is None)
        code = program.wait(timeout_s=DEADLINE_S)
        assert code == exit_code, f"{line} ended with {code}: {program.stdout}{program.stderr}"
        if parts["file"] is None:
            # As the installed command calls itself.
            return program.stdout.replace("python -m tfbus", "tfbus")
        Path(parts["file"]).write_text(program.stdout)
        return program.stderr

    def run_python(self, text: str) -> None:
        """Run a program to its end."""
        (self.folder / "block.py").write_text(text)
        self.run("python block.py")

    def start(self, line: str) -> "Program | Launched":
        """A command that goes on."""
        name, *arguments = shlex.split(line, comments=True)
        if arguments[0] != "launch":
            return self._start(name, arguments, {}, is_merged=False)
        return Launched(self, self.run(f"{line} --dry-run"))

    def forget_modules(self) -> None:
        """Let the next program import its own modules of the folder, as a process does."""
        for name in sys.modules.keys() - self._former_modules:
            file = getattr(sys.modules[name], "__file__", None)
            if (file or "").startswith(str(self.folder)):
                del sys.modules[name]

    def _start(
        self, name: str, arguments: list[str], env: dict[str, str], *, is_merged: bool
    ) -> Program:
        if name == "python":
            self.forget_modules()
            return start_script(
                self._bus, self.folder / arguments.pop(0), *arguments, is_merged=is_merged
            )
        return self._bus.network.program(
            "outside",
            tfbus.__main__.main,
            *arguments,
            name=name,
            env={**self._bus.env, **env},
            is_merged=is_merged,
        )


def start_script(bus: Bus, path: Path, *arguments: str, is_merged: bool = False) -> Program:
    """`python PATH ARGUMENTS` on the bus."""

    def main() -> None:
        runpy.run_path(str(path), run_name="__main__")

    return bus.network.program(
        "outside", main, *arguments, name=path.stem, env=bus.env, is_merged=is_merged
    )


class Launched:
    """The nodes of a launch file, each as `tfbus launch` starts it, which starts real processes."""

    def __init__(self, shell: SimulatedShell, dry: str) -> None:
        self._nodes: dict[str, Program] = {}
        for row in dry.splitlines():
            found = re.fullmatch(r"\[([^\]]+)\] env (\S+=\S+ )*\S*python\S* -P -m (tfbus .*)", row)
            assert found, f"not a node of tfbus: {row}"
            program = shell.start(found[3])
            assert isinstance(program, Program)
            self._nodes[found[1]] = program

    @property
    def out(self) -> list[str]:
        """The lines of all, each with the name of its node."""
        return [
            f"[{name}] {line}"
            for name, program in self._nodes.items()
            for line in (*program.out, *program.err)
        ]

    err: tuple[str, ...] = ()

    def stop(self) -> int:
        """Ctrl-C for each: the highest exit code."""
        return max(program.stop() for program in self._nodes.values())
