"""A reader who follows a section of a page, and compares what it prints with what the page says."""

import json
import os
import pty
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import zenoh

from tests.docs.pages import CONFIGURATIONS, Block, Command, Section, commands
from tests.live_bus import DEADLINE_S, Bus, Process, eventually, free_port
from tests.recordings import write_robot
from tests.simulated_bus import Bus as SimulatedBus
from tfbus.testing.programs import Program

# Finds the command `tfbus` of this environment, activated or not.
PATH = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

# The recording of a minute of a robot that the pages look into.
RECORDING = "run.mcap"

# The router's port in the docs; a free port stands in for it.
ROUTER_PORT = "7447"

_DIFFERS = [
    (re.compile(r"\b\d{10}\.\d{9}\b|\b\d{19}\b"), "STAMP"),
    (re.compile(r"\b([Pp]id:? \[?)\d+"), r"\1PID"),
    (re.compile(r"(Host: ).+"), r"\1HOST"),
    (re.compile(r"\b\d{4}-\d\d-\d\d \d\d:\d\d(?=:\d\d\.\d{3}\b)"), "WALL"),
    (re.compile(r"(Up: )\d+ s"), r"\1TIME"),
    (re.compile(r"\b[0-9a-f]{32}\b|(?<=_)[0-9a-f]{8}\b"), "ID"),
]

_KEYS = {"up": b"\x1b[A", "down": b"\x1b[B", "right": b"\x1b[C", "left": b"\x1b[D"}
_NUMBER = re.compile(r"-?\d+\.\d+")


class Reader:
    """Does what a section says, in a folder and on a bus."""

    def __init__(self, bus: Bus, folder: Path):
        self._bus = bus
        self._folder = folder
        self._port = str(free_port())
        self._env = bus.env | {
            "PATH": PATH,
            "ZENOH_CONFIG": str(_for_plain_zenoh(bus, folder / "zenoh.json5")),
        }
        self._going_on: list[Process] = []
        copy_configurations(folder / "configs")

    def follow(self, block: Block) -> None:
        """Do what one block says."""
        recording = self._folder / RECORDING
        if RECORDING in block.text and "bag record" not in block.text and not recording.exists():
            write_robot(recording)
        text = block.text.replace(ROUTER_PORT, self._port)
        if block.rule == "file:":
            path = self._folder / block.rule_value
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        elif block.language == "python":
            self._run_block(text)
        elif block.language == "yaml":
            (self._folder / "block.yaml").write_text(text)
            self._run_line("tfbus launch ./block.yaml --dry-run")
        elif block.language == "console":
            *others, last = commands(block)
            for command in others:
                self._do(command)
            if block.rule == "goes on":
                self._going_on.append(self._start(last))
            elif block.rule == "typed:":
                self._type(last, block.rule_value.split())
            else:
                self._do(last, exit_code=int(block.rule_value or 0))

    def end(self) -> None:
        """Press Ctrl-C in every terminal where a command still runs, the last one first."""
        for process in reversed(self._going_on):
            assert process.stop() == 0, f"{process.command}: {process.err}"

    def _do(self, command: Command, exit_code: int = 0) -> None:
        if command.interrupted:
            assert self._start(command).stop() == exit_code
            return
        printed = self._run_line(self._here(command.line), exit_code)
        # On a slow machine a tool says so after a second, and goes on.
        lines = [line for line in printed.splitlines() if "]: Waiting for transform" not in line]
        assert _matches(
            [same(line, command.numbers_differ) for line in lines],
            [same(self._here(line), command.numbers_differ) for line in command.output],
        ), f"$ {command.line}\nprinted:\n{printed}"

    def _type(self, command: Command, keys: list[str]) -> None:
        keyboard, terminal = pty.openpty()
        at_terminal = f"exec {command.line} <{os.ttyname(terminal)}"
        process = self._start(replace(command, line=at_terminal))
        for key in keys:
            os.write(keyboard, _KEYS.get(key, key.encode()))
        assert process.wait() == 0
        os.close(keyboard)
        os.close(terminal)

    def _start(self, command: Command) -> Process:
        process = self._start_line(self._here(command.line))
        differ = command.numbers_differ
        shown = {same(self._here(line), differ) for line in command.output} - {"..."}

        def missing() -> set[str]:
            return shown - {same(line, differ) for line in [*process.out, *process.err]}

        try:
            eventually(lambda: not missing())
        except AssertionError:
            raise AssertionError(
                f"$ {command.line}\ndid not print: {sorted(missing())}\n"
                f"but: {process.out}\n{process.err}"
            ) from None
        return process

    def _run_block(self, text: str) -> None:
        self._run([sys.executable, "-c", text])

    def _run_line(self, line: str, exit_code: int = 0) -> str:
        return self._run(["bash", "-c", line], exit_code)

    def _start_line(self, line: str) -> Process:
        return self._bus.start_command(["bash", "-c", line], env=self._env, cwd=self._folder)

    def _run(self, command: list[str], exit_code: int = 0) -> str:
        done = subprocess.run(
            command,
            env=self._env,
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=3 * DEADLINE_S,
        )
        assert done.returncode == exit_code, (
            f"{command} ended with {done.returncode}: {done.stdout}"
        )
        return done.stdout

    def _here(self, line: str) -> str:
        return line.replace(ROUTER_PORT, self._port)


# Commands that start processes, or serve pages.
_REAL_COMMANDS = {"foxglove", "launch", "router", "ros1", "ros2", "teleop", "top", "view"}

# Programs that speak to Zenoh, or serve a page.
_REAL_PROGRAM = re.compile(r"^import zenoh|\bshow\(|^import http", re.M)


def can_be_simulated(section: Section) -> bool:
    """Whether all that a section runs is commands of tfbus, and programs of Python's."""
    blocks = [block for block in section.blocks if block.is_run]
    lines = [
        command.line
        for block in blocks
        if block.language == "console" and block.rule != "file:"
        for command in commands(block)
    ]
    is_real = any(block.rule == "typed:" or _REAL_PROGRAM.search(block.text) for block in blocks)
    return not is_real and all(
        re.match(r"(tfbus|python3?) ", line)
        and not re.search(r"[|;&<>$`*]", line)
        and line.split()[1] not in _REAL_COMMANDS
        for line in lines
    )


class SimulatedReader(Reader):
    """A reader whose commands run on a simulated network, in the current folder."""

    def __init__(self, bus: SimulatedBus, folder: Path):
        self._bus: Any = bus
        self._folder = folder
        self._port = ROUTER_PORT
        self._going_on = []

    def _run_block(self, text: str) -> None:
        self._ended(self._begin(text, "-c"), 0)

    def _run_line(self, line: str, exit_code: int = 0) -> str:
        return self._ended(self._start_line(line), exit_code)

    def _ended(self, program: Program, exit_code: int) -> str:
        code = program.wait(timeout_s=3 * DEADLINE_S)
        assert code == exit_code, f"{program} ended with {code}: {program.stdout}"
        return program.stdout

    def _start_line(self, line: str) -> Any:
        python, *words = shlex.split(line, comments=True)
        if python == "tfbus":
            return self._bus.start(*words, joins_errors=True)
        if words[0] == "-m":
            return self._bus.start_python(*words[1:], joins_errors=True)
        return self._begin(Path(words[0]).read_text(), *words)

    def _begin(self, text: str, path: str, *arguments: str) -> Program:
        self._forget_modules()
        program: Program = self._bus.start_text(text, Path(path), *arguments, joins_errors=True)
        return program

    def _forget_modules(self) -> None:
        """Each program imports those of the folder anew."""
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", "")).startswith(str(self._folder)):
                del sys.modules[name]

    def end(self) -> None:
        super().end()
        self._forget_modules()


def same(line: str, numbers_differ: bool = False) -> str:
    """The line without what differs between two runs."""
    if numbers_differ:
        line = _NUMBER.sub("0", line)
    for pattern, stands_for in _DIFFERS:
        line = pattern.sub(stands_for, line)
    return line.rstrip()


def _matches(printed: list[str], shown: list[str]) -> bool:
    """Whether the lines are those shown, where `...` stands for any number of lines."""
    if not shown:
        return not printed
    if shown[0] == "...":
        return any(_matches(printed[at:], shown[1:]) for at in range(len(printed) + 1))
    return bool(printed) and printed[0] == shown[0] and _matches(printed[1:], shown[1:])


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
