"""The supervisor of a launch, with real processes: start, output, respawn, and the end of all.

Tests wait for output, never for a time. A supervisor's timeouts never matter (`NEVER_S`), or are
over at once.
"""

import asyncio
import fcntl
import os
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import dedent

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.buses import DEADLINE_S
from tfbus.base.errors import BusError
from tfbus.launch.child import LaunchProgram, Timeouts
from tfbus.launch.console import Console, Lines, OutputStream, safe_line
from tfbus.launch.description import Respawn
from tfbus.launch.run import Debounce, adopting_orphans
from tfbus.launch.supervisor import GroupGuard, Presence, Supervisor

pytestmark = pytest.mark.real

NEVER_S = 1000.0
LONG = Timeouts(NEVER_S, NEVER_S, NEVER_S, NEVER_S)

# Ends as a good node does: at once, with exit code 0, and a word about it.
OBEDIENT = "trap 'echo bye; exit 0' INT TERM; echo ready; while :; do sleep 0.01; done"
STUBBORN = "trap '' INT TERM; echo ready $$; while :; do sleep 0.01; done"


@pytest.fixture(autouse=True)
def parent_of_orphans() -> Iterator[None]:
    """The test process plays launch."""
    with adopting_orphans():
        yield


def shell(name: str, script: str, **more: object) -> LaunchProgram:
    values = {"full_name": f"/{name}", "changes": {}, "directory": Path.cwd()} | more
    return LaunchProgram(name=name, argv=("sh", "-c", script), **values)  # test values


class Output:
    """The lines that come out of pipes, to wait for."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._came = threading.Condition()

    def collect(self, descriptor: int) -> list[str]:
        """The list that the lines of this descriptor go to, besides `lines`."""
        own: list[str] = []

        def read() -> None:
            with open(descriptor, errors="replace") as pipe, suppress(OSError):
                for line in pipe:
                    with self._came:
                        own.append(line.rstrip("\r\n"))
                        self.lines.append(own[-1])
                        self._came.notify_all()

        threading.Thread(target=read, daemon=True).start()
        return own

    def wait_for(self, text: str, times: int = 1) -> str:
        """The `times`-th line that contains the text."""
        with self._came:
            came = self._came.wait_for(lambda: len(self._with(text)) >= times, DEADLINE_S)
            assert came, f"{text!r} did not come {times} times in:\n" + "\n".join(self.lines)
            return self._with(text)[times - 1]

    def _with(self, text: str) -> list[str]:
        return [line for line in self.lines if text in line]


class Launch(Output):
    """A supervisor that runs in a thread of its own, between pipes."""

    def __init__(
        self,
        programs: Sequence[LaunchProgram],
        timeouts: Timeouts = LONG,
        presence: Presence | None = None,
        guard: GroupGuard | None = None,
    ) -> None:
        super().__init__()
        (out, self._out), (err, self._err) = os.pipe(), os.pipe()
        self.stdout, self.stderr = self.collect(out), self.collect(err)
        self._console = Console(OutputStream(self._out), OutputStream(self._err))
        self._supervisor = Supervisor(
            programs, self._console, presence=presence, guard=guard, timeouts=timeouts
        )
        self._loop = asyncio.new_event_loop()
        self._exit_code: int | BaseException = -1
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._supervisor.stop, "enough")

    def hurry(self) -> None:
        self._loop.call_soon_threadsafe(self._supervisor.hurry, "quick")

    def exit_code(self) -> int:
        """Its exit code, once it has ended and all output has come."""
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive(), "still running:\n" + "\n".join(self.lines)
        if isinstance(self._exit_code, BaseException):
            raise self._exit_code
        self.wait_for("<end of output>", times=2)
        return self._exit_code

    def _run(self) -> None:
        try:
            self._exit_code = self._loop.run_until_complete(self._supervisor.run())
        except BaseException as error:
            self._exit_code = error
        self._console.close()
        for descriptor in (self._out, self._err):
            os.write(descriptor, b"<end of output>\n")
            os.close(descriptor)
        self._loop.close()


def said(lines: Sequence[str], name: str) -> list[str]:
    """The lines that one process wrote."""
    return [line.removeprefix(f"[{name}] ") for line in lines if line.startswith(f"[{name}] ")]


def lives(pid: int) -> bool:
    """Whether the process runs; a zombie does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
        return stat.rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        if Path("/proc/self").exists():
            return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"{what} did not come true"
        time.sleep(0.005)


def assert_gone(*pids: int) -> None:
    wait_until(lambda: not any(map(lives, pids)), f"the end of {pids}")


# -- output


def test_each_line_carries_the_name_of_its_process() -> None:
    """Output of a process to stdout and stderr comes out there, prefixed with its name."""
    launch = Launch([shell("a", "echo one; echo two >&2"), shell("b", "echo three")])
    assert launch.exit_code() == 0
    assert sorted(launch.stdout) == ["<end of output>", "[a] one", "[b] three"]
    assert said(launch.stderr, "a") == ["two"]


def test_events_are_logged_in_the_words_of_ros2_launch() -> None:
    """Start and clean end of a process are logged with its pid, the end after its last output."""
    launch = Launch([shell("a", "echo $$ >&2")])
    assert launch.exit_code() == 0
    pid = said(launch.stderr, "a")[0]
    assert launch.stderr[:-1] == [
        f"[INFO] [a]: process started with pid [{pid}]",
        f"[a] {pid}",
        f"[INFO] [a]: process has finished cleanly [pid {pid}]",
    ]


@pytest.mark.parametrize(("script", "code"), [("exit 3", 3), ("kill -9 $$", -9)])
def test_a_death_is_logged_with_exit_code_and_command(script: str, code: int) -> None:
    """A process that dies is logged with its exit code (-N: by signal N); launch exits with 1."""
    launch = Launch([shell("a", script), shell("b", "exit 0")])
    assert launch.exit_code() == 1
    line = launch.wait_for("[ERROR] [a]: process has died [pid ")
    assert line.endswith(f", exit code {code}, cmd 'sh -c '{script}'']")


def test_lines_stay_whole_when_written_in_pieces() -> None:
    """Processes that write pieces of lines at the same time do not mix them."""
    pieces = "for i in 1 2 3 4 5 6 7 8 9; do printf %s $i; printf ' '; printf '%s\\n' {0}; done"
    names = ["a", "b", "c"]
    launch = Launch([shell(name, pieces.format(name)) for name in names])
    assert launch.exit_code() == 0
    for name in names:
        assert said(launch.stdout, name) == [f"{i} {name}" for i in range(1, 10)]


def test_a_last_line_without_an_end_is_not_lost() -> None:
    """All output before the end of a process comes out, with or without a newline."""
    launch = Launch([shell("a", "printf 'no end'")])
    assert launch.exit_code() == 0
    assert said(launch.stdout, "a") == ["no end"]


@given(st.lists(st.binary(max_size=20).filter(lambda line: b"\n" not in line)), st.data())
def test_lines_do_not_depend_on_how_they_are_cut(lines: list[bytes], data: st.DataObject) -> None:
    """However a stream of lines is cut into chunks, the same lines come out."""
    lines = [line.rstrip(b"\r") for line in lines]
    stream = b"\n".join([*lines, b""])
    cutter, at = Lines(), 0
    found: list[bytes] = []
    while at < len(stream):
        size = data.draw(st.integers(1, len(stream) - at))
        found += cutter.feed(stream[at : at + size])
        at += size
    assert found == lines
    assert list(cutter.end()) == []


def test_a_line_without_end_comes_in_parts() -> None:
    """A process that never ends its line cannot fill the memory of launch."""
    lines = Lines()
    parts = [*lines.feed(b"x" * 200_000), *lines.end()]
    assert b"".join(parts) == b"x" * 200_000
    assert max(map(len, parts)) == 65536


# -- escalation


def test_stopping_lets_processes_end_by_themselves() -> None:
    """A stop sends SIGINT to all; what they write while ending comes out; the exit code is 0."""
    launch = Launch([shell("a", OBEDIENT), shell("b", OBEDIENT)])
    launch.wait_for("ready", times=2)
    launch.stop()
    assert launch.exit_code() == 0
    for name in ("a", "b"):
        assert said(launch.stdout, name) == ["ready", "bye"]
        launch.wait_for(f"[INFO] [{name}]: sending signal 'SIGINT' to process[{name}]")
        launch.wait_for(f"[INFO] [{name}]: process has finished cleanly")


def test_a_process_that_died_before_the_stop_fails_the_launch() -> None:
    """A stop, by a user or by `--for`, does not hide it: exit code 1, and a sentence."""
    launch = Launch([shell("b", "exit 3"), shell("a", "exec sleep 1000")])
    launch.wait_for("[ERROR] [b]: process has died")
    launch.stop()
    launch.wait_for("[ERROR] [launch]: died before: b; exit code 1")
    assert launch.exit_code() == 1


def test_a_process_that_does_not_obey_gets_sigterm_then_sigkill() -> None:
    """SIGINT, SIGTERM, SIGKILL: each after the timeout of the one before."""
    launch = Launch([shell("a", STUBBORN)], Timeouts(0.05, 0.06, NEVER_S, NEVER_S))
    pid = int(launch.wait_for("ready").split()[-1])
    launch.stop()
    assert launch.exit_code() == 0
    assert launch.stderr[1:-2] == [
        "[WARNING] [launch]: enough",
        "[INFO] [a]: sending signal 'SIGINT' to process[a]",
        "[ERROR] [a]: process[a] failed to terminate '0.05' seconds after receiving 'SIGINT', "
        "escalating to 'SIGTERM'",
        "[INFO] [a]: sending signal 'SIGTERM' to process[a]",
        "[ERROR] [a]: process[a] failed to terminate '0.06' seconds after receiving 'SIGTERM', "
        "escalating to 'SIGKILL'",
        "[INFO] [a]: sending signal 'SIGKILL' to process[a]",
    ]
    launch.wait_for(f"[INFO] [a]: process has stopped [pid {pid}, exit code -9]")
    assert_gone(pid)


@pytest.mark.parametrize(
    ("on_signal", "code"), [("trap - INT; kill -INT $$", -2), ("exit 130", 130)]
)
def test_a_process_that_launch_stops_has_not_died(on_signal: str, code: int) -> None:
    """An end by the signal that was sent, or reported as of it, is no error."""
    wait = "echo ready; while :; do sleep 0.01; done"
    launch = Launch([shell("a", f"trap '{on_signal}' INT; {wait}")])
    launch.wait_for("ready")
    launch.stop()
    assert launch.exit_code() == 0
    assert launch.wait_for("[INFO] [a]: process has stopped").endswith(f"exit code {code}]")
    assert not any("died" in line for line in launch.stderr)


@pytest.mark.parametrize("last", ["exit 3", "kill -KILL $$"])
def test_a_process_that_fails_while_launch_stops_it_has_died(last: str) -> None:
    """An error of its own, or a signal that launch has not sent, stays an error."""
    wait = "echo ready; while :; do sleep 0.01; done"
    launch = Launch([shell("a", f"trap '{last}' INT; {wait}")])
    launch.wait_for("ready")
    launch.stop()
    assert launch.exit_code() == 0
    launch.wait_for("[ERROR] [a]: process has died")


def test_a_second_request_to_stop_hurries_and_a_third_kills() -> None:
    """Each further Ctrl-C goes on to the next signal at once, however patient launch is."""
    launch = Launch([shell("a", STUBBORN)])
    launch.wait_for("ready")
    for number in ("SIGINT", "SIGTERM", "SIGKILL"):
        launch.hurry()
        launch.wait_for(f"sending signal '{number}' to process[a]")
    assert launch.exit_code() == 0
    assert not any("failed to terminate" in line for line in launch.stderr)


def test_the_same_signal_twice_within_an_instant_counts_once() -> None:
    """A signal that `timeout` sends to a process and to its group counts once."""
    debounce = Debounce()
    assert [debounce.is_new(now_s) for now_s in (5.0, 5.01, 5.5, 5.55)] == [
        True,
        False,
        True,
        False,
    ]


def test_grandchildren_end_as_well() -> None:
    """Signals go to whole process groups: what a process started ends with it."""
    launch = Launch([shell("a", "sleep 1000 & echo $! $$; exec sleep 1000")])
    pids = [int(pid) for pid in launch.wait_for("[a] ").split()[1:]]
    for _ in range(2):  # a shell starts its background with SIGINT ignored
        launch.hurry()
    assert launch.exit_code() == 0
    assert_gone(*pids)


def test_what_a_process_leaves_behind_is_ended_with_it() -> None:
    """A process that ends while children of its own run takes them along, SIGKILL at last."""
    stubborn = "(trap '' TERM; echo $(exec sh -c 'echo $PPID'); while :; do sleep 0.01; done) &"
    wait = "read ready < {0}; exit 0"
    launch = Launch(
        [shell("a", f"{stubborn} {wait.format('/dev/null')}")],
        Timeouts(NEVER_S, 0.05, NEVER_S, NEVER_S),
    )
    launch.wait_for("[WARNING] [a]: left processes behind: sending them 'SIGTERM'")
    # `read` from an empty file fails, and the shell ends with the 0 of `exit`.
    assert launch.exit_code() == 0
    for line in said(launch.stdout, "a"):
        assert_gone(int(line))


@pytest.mark.parametrize(
    ("line", "plain", "styled"),
    [
        ("plain \tété 日本".encode(), "plain \tété 日本", None),
        (b"\x1b[1;31mred\x1b[0m, plain", "red, plain", "\x1b[1;31mred\x1b[0m, plain\x1b[0m"),
        (b"\x1b[2J\x1b]0;title\x07a\x08b", r"\x1b[2J\x1b]0;title\x07a\x08b", None),
        (b"\x1b[31\x1b[mK\x9bm", r"\x1b[31K\x9bm", "\\x1b[31\x1b[mK\\x9bm\x1b[0m"),
        ("\x9b2J\u202eab\rc".encode(), r"\x9b2J\u202eab\rc", None),
        (b"\xe9t\xe9", r"\xe9t\xe9", None),
        (b"", "", None),
    ],
)
def test_what_a_process_prints_cannot_drive_the_terminal(
    line: bytes, plain: str, styled: str | None
) -> None:
    """Control characters are escaped; colours stay where the terminal shows them, else they are
    left out.
    """
    assert safe_line(line, styled=False).decode() == plain
    assert safe_line(line, styled=True).decode() == (plain if styled is None else styled)


def test_the_output_of_a_process_is_relayed_without_its_control_characters() -> None:
    """Standard output and standard error alike, a last line without an end too."""
    program = r"printf '\033[2Jone\ntwo\a' ; printf '\033]0;three\007' >&2"
    launch = Launch([shell("a", program)])
    assert launch.exit_code() == 0
    assert said(launch.stdout, "a") == [r"\x1b[2Jone", r"two\x07"]
    assert said(launch.stderr, "a") == [r"\x1b]0;three\x07"]


def test_a_long_line_is_not_cut_within_a_letter() -> None:
    """Its parts are as they were."""
    text = "é" * 70_000
    lines = Lines()
    parts = [*lines.feed(b"x" + text.encode()), *lines.end()]
    assert len(parts) == 3 and "".join(part.decode() for part in parts) == "x" + text


def test_a_blocked_output_does_not_keep_launch_from_stopping() -> None:
    """Ctrl-C works while the reader is stopped, as after Ctrl-S in a terminal."""
    unread, out = os.pipe()
    collected = Output()
    read, err = os.pipe()
    collected.collect(read)

    async def run() -> int:
        console = Console(OutputStream(out), OutputStream(err))
        supervisor = Supervisor([shell("a", "exec yes")], console, timeouts=LONG)
        stop = asyncio.get_running_loop().call_soon_threadsafe
        threading.Thread(
            target=lambda: (collected.wait_for("started"), stop(supervisor.stop, "enough"))
        ).start()
        return await supervisor.run()

    assert asyncio.run(asyncio.wait_for(run(), DEADLINE_S)) == 0
    os.close(unread)


def test_a_fault_of_the_supervisor_itself_leaves_nothing_running() -> None:
    """Should launch fail by a mistake of its own, its processes are killed all the same."""

    class Broken:
        def watch(self, group: int) -> None:
            self.group = group
            raise RuntimeError("broken")

        def release(self, group: int) -> None:
            pass

    guard = Broken()
    launch = Launch([shell("a", STUBBORN)], guard=guard)
    with pytest.raises(RuntimeError, match="broken"):
        launch.exit_code()
    assert_gone(guard.group)


# -- respawn


def test_a_process_is_started_again_up_to_its_limit() -> None:
    """Respawn starts a process again, each time later, and says when it gives up."""
    respawn = Respawn(delay_s=0.01, limit=2)
    launch = Launch([shell("a", "echo run; exit 1", respawn=respawn)])
    assert launch.exit_code() == 1
    assert said(launch.stdout, "a") == ["run"] * 3
    events = [line for line in launch.stderr if "again" in line]
    assert events == [
        "[INFO] [a]: process will be started again in 0.01 s",
        "[INFO] [a]: process will be started again in 0.02 s",
        "[ERROR] [a]: not started again: 2 times in a row",
    ]


def test_a_process_that_ran_steadily_has_its_respawns_back() -> None:
    """The limit counts respawns in a row: a steady run resets it."""
    respawn = Respawn(delay_s=0.0, limit=1, steady_s=0.0)
    launch = Launch([shell("a", "echo run", respawn=respawn)])
    launch.wait_for("[a] run", times=5)
    launch.stop()
    assert launch.exit_code() == 0


def test_a_killed_process_comes_back_with_a_new_pid() -> None:
    """A process killed with SIGKILL is started again."""
    launch = Launch([shell("a", STUBBORN, respawn=Respawn(delay_s=0.0))])
    first = int(launch.wait_for("[a] ready").split()[-1])
    os.kill(first, signal.SIGKILL)
    second = int(launch.wait_for("[a] ready", times=2).split()[-1])
    assert first != second and lives(second)
    for _ in range(3):
        launch.hurry()
    assert launch.exit_code() == 0
    assert_gone(first, second)


def test_a_stop_during_the_delay_of_a_respawn_starts_nothing_more() -> None:
    """Ctrl-C between two runs of a process ends the launch at once."""
    launch = Launch([shell("a", "exit 1", respawn=Respawn(delay_s=NEVER_S))])
    launch.wait_for("will be started again in 1000 s")
    launch.stop()
    assert launch.exit_code() == 0
    assert len([line for line in launch.stderr if "started with pid" in line]) == 1


# -- required, and failing to start


@pytest.mark.parametrize("script", ["exit 0", "exit 5"])
def test_the_end_of_a_required_process_ends_all(script: str) -> None:
    """When a required process ends, however it ends, all others do, with exit code 1."""
    launch = Launch([shell("a", OBEDIENT), shell("vital", script, required=True)])
    launch.wait_for("[ERROR] [vital]: required process has ended: stopping all others")
    assert launch.exit_code() == 1
    launch.wait_for("sending signal 'SIGINT' to process[a]")


def test_a_required_process_ends_for_good_only_after_its_respawns() -> None:
    """A process that is required and respawned ends all once its respawns are used up."""
    respawn = Respawn(delay_s=0.0, limit=1)
    launch = Launch(
        [shell("a", OBEDIENT), shell("vital", "echo run", required=True, respawn=respawn)]
    )
    assert launch.exit_code() == 1
    assert said(launch.stdout, "vital") == ["run", "run"]


def test_required_processes_may_end_in_a_stop() -> None:
    """After Ctrl-C the end of a required process is no failure."""
    launch = Launch([shell("vital", OBEDIENT, required=True)])
    launch.wait_for("ready")
    launch.stop()
    assert launch.exit_code() == 0


def test_a_program_that_cannot_be_started_ends_the_launch(tmp_path: Path) -> None:
    """A launch that cannot start all of its processes stops the others and ends with 1."""
    missing = LaunchProgram("b", (str(tmp_path / "no"),), {}, tmp_path)
    launch = Launch([shell("a", OBEDIENT), missing])
    launch.wait_for("[ERROR] [b]: process cannot be started: [Errno 2] No such file or directory")
    assert launch.exit_code() == 1


# -- after


class Bus:
    """Nodes that come when a test says so, instead of a bus."""

    def __init__(self, error: str = "") -> None:
        self._present: set[str] = set()
        self._changed = threading.Condition()
        self._error = error

    def arrive(self, name: str) -> None:
        with self._changed:
            self._present.add(name)
            self._changed.notify_all()

    def wait(self, name: str, *, timeout_s: float | None = None) -> bool:
        if self._error:
            raise BusError(self._error)
        with self._changed:
            return self._changed.wait_for(lambda: name in self._present, timeout_s)


NOTICING = Timeouts(NEVER_S, NEVER_S, NEVER_S, notice_s=0.02)


def test_a_process_is_started_when_those_it_waits_for_are_there() -> None:
    """`after:` holds a process back until each named node is on the bus, and says so meanwhile."""
    bus = Bus()
    follower = shell("follower", "echo here", after=("/sim", "/robot7/sim"))
    launch = Launch([follower, shell("sim", OBEDIENT)], NOTICING, presence=bus)
    launch.wait_for("[INFO] [follower]: waiting for /sim", times=2)
    bus.arrive("/sim")
    launch.wait_for("[INFO] [follower]: waiting for /robot7/sim")
    assert said(launch.stdout, "follower") == []
    bus.arrive("/robot7/sim")
    launch.wait_for("[follower] here")
    launch.stop()
    assert launch.exit_code() == 0


def test_a_stop_while_waiting_for_a_node_starts_nothing_more() -> None:
    """Ctrl-C while a process is held back by `after:` ends the launch at once."""
    launch = Launch([shell("a", "echo here", after=("/sim",))], NOTICING, presence=Bus())
    launch.wait_for("waiting for /sim")
    launch.stop()
    assert launch.exit_code() == 0
    assert said(launch.stdout, "a") == []


def test_no_process_waits_for_one_that_has_ended() -> None:
    """A process whose awaited node ended without appearing is not started, with an error."""
    launch = Launch(
        [
            shell("sim", "exit 1"),
            shell("a", "echo here", after=("/sim",)),
            shell("b", "echo here", after=("/a",)),
        ],
        presence=Bus(),
    )
    assert launch.exit_code() == 1
    launch.wait_for("[ERROR] [a]: not started: /sim has ended")
    launch.wait_for("[ERROR] [b]: not started: /a has ended")


def test_trouble_with_the_bus_ends_a_launch_that_waits() -> None:
    """If the bus cannot be watched, launch logs why and stops."""
    launch = Launch([shell("a", "echo here", after=("/sim",))], presence=Bus("no way there"))
    launch.wait_for("[ERROR] [launch]: no way there")
    assert launch.exit_code() == 1


# -- the command: signals, terminals, and what a killed launch leaves


class Command(Output):
    """`tfbus launch` as a process of its own, on a launch file with the given nodes."""

    def __init__(
        self, folder: Path, nodes: str, *options: str, terminal: int | None = None
    ) -> None:
        super().__init__()
        path = folder / "nodes.yaml"
        path.write_text("nodes:\n" + "".join(f"  {line}\n" for line in dedent(nodes).splitlines()))
        argv = (sys.executable, "-m", "tfbus", "launch", str(path), *options)
        if terminal is None:
            self.process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            assert self.process.stdout and self.process.stderr
            self.stdout = self.collect(os.dup(self.process.stdout.fileno()))
            self.stderr = self.collect(os.dup(self.process.stderr.fileno()))
        else:
            self.process = subprocess.Popen(
                argv,
                stdin=terminal,
                stdout=terminal,
                stderr=terminal,
                start_new_session=True,
                # The terminal becomes that of the new session: its Ctrl-C reaches launch.
                preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            )

    def exit_code(self) -> int:
        return self.process.wait(DEADLINE_S)


@contextmanager
def started(folder: Path, nodes: str, *options: str, **more: int) -> Iterator[Command]:
    """A launch command that is ended at the latest when the block is."""
    command = Command(folder, nodes, *options, **more)
    try:
        yield command
    finally:
        if command.process.poll() is None:
            command.process.kill()
        command.process.wait()
        for pipe in (command.process.stdout, command.process.stderr):
            if pipe:
                pipe.close()


def pids_in(line: str) -> list[int]:
    return [int(word) for word in line.split() if word.isdigit()]


TWO_GENERATIONS = """
    - command: [sh, -c, "trap 'echo bye; exit 0' INT TERM HUP;
        sleep 1000 & echo ready $$ $!; while :; do sleep 0.01; done"]
      name: a
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_to_launch_ends_everything(tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C, SIGTERM, a closed terminal, Ctrl-backslash: all end, exit code 0, nothing stays."""
    with started(tmp_path, TWO_GENERATIONS, "--sigterm-timeout", "0.1") as launch:
        pids = pids_in(launch.wait_for("[a] ready"))
        launch.process.send_signal(number)
        assert launch.exit_code() == 0
        assert_gone(*pids)
        launch.wait_for(f"({number.name})")


def test_a_second_ctrl_c_hurries_the_command(tmp_path: Path) -> None:
    """A second Ctrl-C sends the next signal at once."""
    stubborn = f'- {{command: [sh, -c, "{STUBBORN}"], name: a}}'
    long = ("--sigterm-timeout", str(NEVER_S), "--sigkill-timeout", str(NEVER_S))
    with started(tmp_path, stubborn, *long) as launch:
        pids = pids_in(launch.wait_for("[a] ready"))

        def press_until(text: str) -> None:
            def pressed() -> bool:
                launch.process.send_signal(signal.SIGINT)
                time.sleep(0.15)  # longer than the debounce
                return any(text in line for line in launch.lines)

            wait_until(pressed, text)

        press_until("sending signal 'SIGINT'")
        press_until("sending signal 'SIGTERM'")
        press_until("sending signal 'SIGKILL'")
        assert launch.exit_code() == 0
        assert_gone(*pids)


def test_a_killed_launch_leaves_nothing(tmp_path: Path) -> None:
    """Even when launch itself is killed with SIGKILL, its process groups end."""
    nodes = dedent(TWO_GENERATIONS) + f'- {{command: [sh, -c, "{STUBBORN}"], name: b}}\n'
    with started(tmp_path, nodes, "--sigkill-timeout", "0.1") as launch:
        pids = pids_in(launch.wait_for("[a] ready")) + pids_in(launch.wait_for("[b] ready"))
        launch.process.kill()
        launch.exit_code()
        assert_gone(*pids)
        assert said(launch.stdout, "a")[1:] in ([], ["bye"])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux lets launch adopt daemons")
def test_daemons_end_with_the_launch(tmp_path: Path) -> None:
    """A process that left its group and its parent is found, and ended with the launch."""
    # The parent ends when the daemon has left its group, not before.
    away = tmp_path / "away"
    nodes = f"""
        - command: [sh, -c, "setsid sh -c 'trap : INT; echo ready $$; : > {away}; while :; do
            sleep 0.01; done' & while [ ! -e {away} ]; do sleep 0.01; done; exit 0"]
          name: daemon
        - command: [sh, -c, "trap 'exit 0' INT; while :; do sleep 0.01; done"]
          name: other
    """
    with started(tmp_path, nodes) as launch:
        pids = pids_in(launch.wait_for("[daemon] ready"))
        launch.wait_for("[daemon]: process has finished cleanly")
        assert all(map(lives, pids))
        launch.process.send_signal(signal.SIGINT)
        assert launch.exit_code() == 0
        assert_gone(*pids)


def test_launch_ends_when_the_reader_of_its_output_is_gone(tmp_path: Path) -> None:
    """`tfbus launch FILE | head` ends like any program whose reader goes away."""
    with started(tmp_path, "- {command: [sh, -c, 'exec yes'], name: a}") as launch:
        # A reader of its own, which goes away after the first line.
        launch.wait_for("[a] y")
        launch.process.send_signal(signal.SIGTERM)
        assert launch.exit_code() == 0
    path = tmp_path / "nodes.yaml"
    script = f"{sys.executable} -m tfbus launch {path} | head -1"
    done = subprocess.run(
        ["sh", "-c", script], capture_output=True, text=True, timeout=DEADLINE_S, check=True
    )
    assert done.stdout == "[a] y\n"
    assert "[WARNING] [launch]: the reader" in done.stderr


def test_in_a_terminal_names_have_colours_and_ctrl_c_stops(tmp_path: Path) -> None:
    """In a terminal each name has its colour, and the key Ctrl-C stops the launch."""
    master, terminal = os.openpty()
    with started(tmp_path, TWO_GENERATIONS, terminal=terminal) as launch:
        os.close(terminal)
        launch.collect(os.dup(master))
        line = launch.wait_for("ready")
        assert line.startswith("\x1b[") and "[a]\x1b[0m ready" in line
        os.write(master, b"\x03")
        launch.wait_for("user interrupted with ctrl-c (SIGINT)")
        launch.wait_for("bye")
        for _ in range(2):
            with suppress(OSError):
                os.write(master, b"\x1c")
        assert launch.exit_code() == 0
        assert_gone(*pids_in(line))
    os.close(master)


def test_a_closed_terminal_ends_the_launch(tmp_path: Path) -> None:
    """When its terminal window or ssh connection goes away, launch ends and leaves nothing."""
    master, terminal = os.openpty()
    options = ("--sigterm-timeout", "0.1")
    with started(tmp_path, TWO_GENERATIONS, *options, terminal=terminal) as launch:
        os.close(terminal)
        text = b""
        while b"ready" not in text or not text.endswith(b"\n"):
            text += os.read(master, 1000)
        os.close(master)
        assert launch.exit_code() == 0
        ready = next(line for line in text.decode().splitlines() if "ready" in line)
        assert_gone(*pids_in(ready))


def test_a_launch_for_a_time_ends_as_after_ctrl_c(tmp_path: Path) -> None:
    """`--for SECONDS` stops everything after that time, with exit code 0."""
    with started(tmp_path, "- {command: sleep 1000, name: a}", "--for", "0.3") as launch:
        pids = pids_in(re.sub(r"\W", " ", launch.wait_for("started with pid")))
        launch.wait_for("[INFO] [launch]: has run for 0.3 s, as asked")
        assert launch.exit_code() == 0
        assert_gone(*pids)


def test_a_launch_ends_with_its_processes(tmp_path: Path) -> None:
    """With exit code 0 where they ended well."""
    with started(tmp_path, "- {command: ['true'], name: a}") as launch:
        assert launch.exit_code() == 0
        launch.wait_for("process has finished cleanly")
