"""A reader who follows a section of a page, and compares the output with the page's."""

import re
from contextlib import suppress
from dataclasses import replace

from tests.buses import eventually
from tests.docs.pages import Block, Command, commands
from tests.docs.real_shell import RealShell
from tests.docs.simulated_shell import Launched, SimulatedShell
from tests.live_bus import Process
from tests.recordings import write_robot
from tfbus.testing.programs import Program

# The recording of a minute of a robot that the pages look into.
RECORDING = "run.mcap"

_DIFFERS = [
    (re.compile(r"\b\d{10}\.\d{9}\b|\b\d{19}\b"), "STAMP"),
    (re.compile(r"\b([Pp]id:? \[?)\d+"), r"\1PID"),
    (re.compile(r"(Host: ).+"), r"\1HOST"),
    (re.compile(r"\b\d{4}-\d\d-\d\d \d\d:\d\d(?=:\d\d\.\d{3}\b)"), "WALL"),
    (re.compile(r"(Up: )\d+ s"), r"\1TIME"),
    # The next free one, if another program has it.
    (re.compile(r"(\b(?:https?|ws)(?:://|%3A%2F%2F)[\w.]+(?::|%3A))\d+"), r"\1PORT"),
    (re.compile(r"\b[0-9a-f]{32}\b|(?<=_)[0-9a-f]{8}\b"), "ID"),
]

_NUMBER = re.compile(r"-?\d+\.\d+")


class Reader:
    """Does what a section says, in a shell."""

    def __init__(self, shell: RealShell | SimulatedShell):
        self._shell = shell
        self._going_on: list[Process | Program | Launched] = []

    def follow(self, block: Block) -> None:
        """Do what one block says."""
        folder = self._shell.folder
        recording = folder / RECORDING
        if RECORDING in block.text and "bag record" not in block.text and not recording.exists():
            write_robot(recording)
        text = self._shell.here(block.text)
        if block.rule == "file:":
            path = folder / block.rule_value
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        elif block.language == "python":
            self._shell.run_python(text)
        elif block.language == "yaml":
            (folder / "block.yaml").write_text(text)
            self._shell.run("tfbus launch ./block.yaml --dry-run")
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
            assert process.stop() == 0, f"{process}: {process.err}"

    def _do(self, command: Command, exit_code: int = 0) -> None:
        if command.interrupted:
            assert self._start(command).stop() == exit_code
            return
        printed = self._shell.run(self._shell.here(command.line), exit_code)
        # On a slow machine a tool says so after a second, and goes on.
        lines = [line for line in printed.splitlines() if "]: Waiting for transform" not in line]
        assert _matches(
            [same(line, command.numbers_differ) for line in lines],
            [same(self._shell.here(line), command.numbers_differ) for line in command.output],
        ), f"$ {command.line}\nprinted:\n{printed}"

    def _type(self, command: Command, keys: list[str]) -> None:
        assert isinstance(self._shell, RealShell)
        at_terminal, terminal = self._shell.terminal(keys)
        process = self._start(replace(command, line=at_terminal.format(command.line)))
        terminal.type()
        assert isinstance(process, Process)
        assert process.wait() == 0
        terminal.close()

    def _start(self, command: Command) -> Process | Program | Launched:
        process = self._shell.start(self._shell.here(command.line))
        differ = command.numbers_differ
        shown = {same(self._shell.here(line), differ) for line in command.output} - {"..."}

        def missing() -> set[str]:
            return shown - {same(line, differ) for line in [*process.out, *process.err]}

        code = None
        if isinstance(process, Process):
            code = process.wait_until(lambda: not missing())
        else:
            with suppress(AssertionError):
                eventually(lambda: not missing())
        assert not missing(), (
            f"$ {command.line}\n{'goes on' if code is None else f'ended with {code}'} and did not "
            f"print: {sorted(missing())}\nbut: {process.out}\n{process.err}"
        )
        return process


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
