"""A program in a simulated process: its arguments, environment, input, output and exit code."""

import io
import os
import re
import sys
import traceback
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from signal import SIGINT
from typing import TYPE_CHECKING, Any

from tfbus.base.wording import did_you_mean
from tfbus.testing.tasks import SimulationError, SimulationOver

if TYPE_CHECKING:
    from tfbus.testing.network import Network
    from tfbus.testing.processes import Process, ProcessTable

# How often the output of a program is looked at.
_LOOK_EVERY_S = 0.01


class Program:
    """A program that `Network.program` has started."""

    def __init__(
        self,
        network: "Network",
        table: "ProcessTable",
        process: "Process",
        main: Callable[[], object],
        arguments: tuple[str, ...],
        env: Mapping[str, str],
        stdin: str,
        *,
        is_terminal: bool,
        is_merged: bool = False,
    ) -> None:
        self.process = process
        self._network, self._table = network, table
        self._main, self._arguments = main, arguments
        module = sys.modules[module_of(main)]
        self._out = _WrittenOutput(is_terminal)
        self._err = self._out if is_terminal or is_merged else _WrittenOutput(is_terminal)
        encoding = env.get("PYTHONIOENCODING", "utf-8")
        # Python has these once: stdin, stdout, stderr, arguments, environment, `__main__`.
        self._own: tuple[Any, ...] = (
            io.TextIOWrapper(_TypedInput(stdin.encode(), is_terminal), "utf-8"),
            io.TextIOWrapper(self._out, encoding, newline="\n", write_through=True),
            io.TextIOWrapper(self._err, encoding, newline="\n", write_through=True),
            [str(module.__file__), *arguments],
            dict(env),
            module,
        )
        self._of_others: tuple[Any, ...] = ()

    @property
    def pid(self) -> int:
        """Its number on its host."""
        return self.process.pid

    @property
    def stdout(self) -> str:
        """All that it has written to its standard output; merged or in a terminal with its
        errors.
        """
        return self._out.text

    @property
    def stderr(self) -> str:
        """All that it has written as errors."""
        return self._err.text

    @property
    def out(self) -> list[str]:
        """The lines of `stdout` that are complete."""
        return self._out.lines

    @property
    def err(self) -> list[str]:
        """The lines of `stderr` that are complete."""
        return self._err.lines

    @property
    def exit_code(self) -> int | None:
        """How it has ended, negative for a signal; None while it runs."""
        return self.process.exit_code

    def wait_for_line(self, pattern: str, *, timeout_s: float = 60.0) -> str:
        """Let the network run until a line of its output or errors has the pattern in it: that
        line. Raises SimulationError if it has ended without, or after `timeout_s`.
        """
        found: list[str] = []
        sought = re.compile(pattern)

        def is_there() -> bool:
            # In this order: lines printed at its end count.
            has_ended = self.exit_code is not None
            found[:] = [line for line in (*self.out, *self.err) if sought.search(line)][:1]
            if has_ended and not found:
                raise self._error(f"has ended without {pattern!r}")
            return bool(found)

        try:
            self._network.run(until=is_there, timeout_s=timeout_s)
        except SimulationError as error:
            if found or self.exit_code is not None:
                raise
            raise self._error(f"has not printed {pattern!r} within {timeout_s:g} s") from error
        return found[0]

    def signal(self, number: int) -> None:
        """Send it a signal."""
        self._network.signal(self.process, number)

    def stop(self, number: int = SIGINT) -> int:
        """Send it a signal and let the network run until it has ended: its exit code."""
        if self.exit_code is None:
            self.signal(number)
        return self.wait()

    def kill(self) -> None:
        """End it at once, as SIGKILL does."""
        self._network.kill(self.process)

    def wait(self, *, timeout_s: float = 60.0) -> int:
        """Let the network run until it has ended: its exit code."""
        if self.exit_code is None:
            self.process.ended.wait(f"the end of {self}", timeout_s)
        if self.exit_code is None:
            raise self._error(f"has not ended within {timeout_s:g} s")
        return self.exit_code

    def _error(self, what: str) -> SimulationError:
        return SimulationError(f"{self} {what}\nstdout: {self.stdout}\nstderr: {self.stderr}")

    def __str__(self) -> str:
        return " ".join([self.process.name, *self._arguments])

    # In its process

    def run(self) -> None:
        """Run it to its end, as Python runs a program."""
        code = 0
        try:
            self._main()
        except SystemExit as end:
            code = _exit_code(end.code)
        except SimulationOver:
            raise
        except BaseException as error:
            traceback.print_exc()
            code = -SIGINT if isinstance(error, KeyboardInterrupt) else 1
        self._table.finish(self.process)
        self.process.exit_code = code

    def enter(self) -> None:
        """From here on Python's own files, arguments and environment are this program's."""
        self._of_others, own = _of_python(), self._own
        _set_of_python(*own)

    def leave(self) -> None:
        """Python's own files, arguments and environment are others' again."""
        self._own = _of_python()
        _set_of_python(*self._of_others)


def module_of(main: Callable[..., object]) -> str:
    """The module of a main function, or of the function that a command of click calls."""
    return str(getattr(main, "callback", main).__module__)


def main_of_command(command: str) -> Callable[[], object]:
    """The main function of an installed command. Raises SimulationError if there is none."""
    commands = entry_points(group="console_scripts")
    if command not in commands.names:
        raise SimulationError(
            f"there is no command {command!r} of an installed Python package: give one, or a main "
            f"function{did_you_mean(command, commands.names)}"
        )
    main: Callable[[], object] = commands[command].load()
    return main


def _of_python() -> tuple[Any, ...]:
    return sys.stdin, sys.stdout, sys.stderr, sys.argv, os.environ, sys.modules["__main__"]


def _set_of_python(
    stdin: Any, stdout: Any, stderr: Any, argv: Any, environ: Any, main: Any
) -> None:
    sys.stdin, sys.stdout, sys.stderr = stdin, stdout, stderr
    sys.argv, os.environ, sys.modules["__main__"] = argv, environ, main


def _exit_code(said: Any) -> int:
    if said is None:
        return 0
    if isinstance(said, int):
        return said
    print(said, file=sys.stderr)
    return 1


class _WrittenOutput(io.RawIOBase):
    """The output of a program, as a text and as lines."""

    name = "<stdout>"

    def __init__(self, is_terminal: bool) -> None:
        self._is_terminal = is_terminal
        self._data = bytearray()
        self._lines_end = 0
        self.lines: list[str] = []

    @property
    def text(self) -> str:
        return self._data.decode(errors="replace")

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._is_terminal

    def write(self, data: Any) -> int:
        self._data += data
        end = self._data.rfind(b"\n") + 1
        if end > self._lines_end:
            fresh = self._data[self._lines_end : end - 1].decode(errors="replace")
            self.lines += fresh.split("\n")
            self._lines_end = end
        return len(data)


class _TypedInput(io.BytesIO):
    """The input of a program."""

    name = "<stdin>"

    def __init__(self, data: bytes, is_terminal: bool) -> None:
        super().__init__(data)
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal
