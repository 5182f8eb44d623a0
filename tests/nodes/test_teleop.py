"""`tfbus teleop`: every key, on a simulated bus; and a real terminal, during and after it."""

import math
import os
import re
import signal
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue

import pytest

from tests import needs, simulated_bus
from tests.buses import DEADLINE_S, eventually
from tests.live_bus import Bus
from tfbus import Node
from tfbus.command.terminal import NoTerminalError, RawTerminal
from tfbus.messages import Pose, Twist, Vector3
from tfbus.nodes import teleop as teleop_module
from tfbus.nodes.teleop import BANNER, HEADINGS_RAD

TELEOP = [sys.executable, "-m", "tfbus", "teleop"]

# Runs a command with standard input as its controlling terminal, as a terminal window does.
IN_TERMINAL = """
import os, sys
os.login_tty(0)
os.execv(sys.argv[1], sys.argv[1:])
"""

# Does what a shell does for Ctrl-Z and fg, and says what the terminal was like in between.
IN_SHELL = """
import os, signal, sys, termios
os.login_tty(0)
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
job = os.fork()
if job == 0:
    os.setpgid(0, 0)
    os.tcsetpgrp(0, os.getpgrp())
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    os.execv(sys.argv[1], sys.argv[1:])
_, status = os.waitpid(job, os.WUNTRACED)
assert os.WIFSTOPPED(status), status
print("stopped with echo", bool(termios.tcgetattr(0)[3] & termios.ECHO), flush=True)
os.tcsetpgrp(0, job)
os.kill(job, signal.SIGCONT)
_, status = os.waitpid(job, 0)
sys.exit(os.waitstatus_to_exitcode(status))
"""


class Terminal:
    """A terminal window with one program in it."""

    def __init__(self, command: list[str], env: dict[str, str], wrapper: str = IN_TERMINAL):
        self.master, self._slave = os.openpty()
        self.found = self.modes()
        self.process = subprocess.Popen(
            [sys.executable, "-c", wrapper, *command], stdin=self._slave, env=env
        )
        self._shown = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        try:
            while data := os.read(self.master, 4096):
                self._shown += data
        except OSError:
            return  # hung up

    @property
    def text(self) -> str:
        """All output so far."""
        return self._shown.decode(errors="replace").replace("\r\n", "\n")

    def wait_for(self, pattern: str) -> None:
        eventually(lambda: re.search(pattern, self.text))

    def type(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def modes(self) -> object:
        return termios.tcgetattr(self._slave)

    @property
    def echoes(self) -> bool:
        """Whether it echoes, and waits for Enter."""
        local_modes: int = termios.tcgetattr(self._slave)[3]
        return bool(local_modes & (termios.ECHO | termios.ICANON))

    def exit_code(self) -> int:
        return self.process.wait(DEADLINE_S)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(DEADLINE_S)
        os.close(self._slave)
        self._reader.join(DEADLINE_S)
        os.close(self.master)


class Turtle:
    """The poses of turtle1."""

    def __init__(self, node: Node):
        self.pose: Pose | None = None
        node.create_subscription(Pose, "turtle1/pose", self._take)
        eventually(lambda: self.pose is not None)

    def _take(self, pose: Pose) -> None:
        self.pose = pose

    @property
    def now(self) -> Pose:
        assert self.pose is not None
        return self.pose


class Keyboard:
    """A terminal whose keys the test types, for teleop on a simulated bus."""

    def __init__(self) -> None:
        self._typed: SimpleQueue[bytes] = SimpleQueue()
        self.type = self._typed.put

    def __enter__(self) -> "Keyboard":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        try:
            return self._typed.get(timeout=timeout_s)
        except Empty:
            return b""


@pytest.fixture
def keyboard(bus: simulated_bus.Bus, monkeypatch: pytest.MonkeyPatch) -> Keyboard:
    """The keyboard of a teleop that is started on the bus."""
    keyboard = Keyboard()
    monkeypatch.setattr(teleop_module, "RawTerminal", lambda fd: keyboard)
    return keyboard


@pytest.fixture
def turtle(bus: simulated_bus.Bus) -> Turtle:
    """The turtle1 of a simulator."""
    bus.start("simulator", "--headless").wait_for_line("ready")
    return Turtle(bus.node("watcher"))


@pytest.fixture
def driven(bus: simulated_bus.Bus, turtle: Turtle, keyboard: Keyboard) -> Keyboard:
    """The keyboard of a teleop that drives turtle1."""
    bus.start("teleop").wait_for_line("Driving turtle1")
    return keyboard


@pytest.fixture
def teleop(bus: Bus) -> Iterator[Terminal]:
    """A terminal in which teleop reads keys; it need not find others."""
    terminal = Terminal(TELEOP, {**bus.env, "TFBUS_CONFIG": str(bus.quick_config)})
    terminal.wait_for("Driving turtle1")
    yield terminal
    terminal.close()


@pytest.mark.real
def test_the_banner_is_turtlesims(teleop: Terminal) -> None:
    """Its first output is the banner of turtle_teleop_key."""
    assert BANNER.splitlines() == [
        "Reading from keyboard",
        "---------------------------",
        "Use arrow keys to move the turtle.",
        "Use G|B|V|C|D|E|R|T keys to rotate to absolute orientations. 'F' to cancel a rotation.",
        "'Q' to quit.",
    ]
    assert teleop.text.startswith(BANNER)


def test_arrow_keys_drive_the_turtle(turtle: Turtle, driven: Keyboard) -> None:
    """Up and Down move it at 2 m/s, Left and Right turn it at 2 rad/s, in either cursor mode."""
    start = turtle.now
    driven.type(b"\x1b[A")
    eventually(lambda: turtle.now.x > start.x + 1.5)
    driven.type(b"\x1bOB")
    eventually(lambda: turtle.now.x < start.x + 0.5)
    assert turtle.now.linear_velocity == 2.0
    driven.type(b"\x1b[D")
    eventually(lambda: turtle.now.theta > 1.0)
    assert turtle.now.angular_velocity == 2.0
    driven.type(b"\x1b[C")
    eventually(lambda: turtle.now.theta < 0.0)
    assert turtle.now.angular_velocity == -2.0
    assert turtle.now.y == start.y


def test_a_key_that_comes_in_pieces_is_one_key(turtle: Turtle, driven: Keyboard) -> None:
    """An arrow drives even if its bytes come one by one, as over a slow connection."""
    for piece in (b"\x1b", b"[", b"A"):
        driven.type(piece)
    eventually(lambda: turtle.now.linear_velocity == 2.0)


def test_letters_turn_the_turtle_to_absolute_headings(turtle: Turtle, driven: Keyboard) -> None:
    """G T R E D C V B turn it to the eight headings, in upper and lower case."""
    assert HEADINGS_RAD.keys() == set("gtredcvb")
    for number, (key, heading_rad) in enumerate(HEADINGS_RAD.items()):
        driven.type((key if number % 2 else key.upper()).encode())
        eventually(lambda: is_at(turtle.now, heading_rad))  # noqa: B023 - called here only


def is_at(pose: Pose, heading_rad: float) -> bool:
    """Whether the turtle rests at the heading, within turtlesim's tolerance."""
    away_rad = math.remainder(pose.theta - heading_rad, math.tau)
    return abs(away_rad) < 0.021 and pose.angular_velocity == 0.0


def test_f_cancels_a_rotation(turtle: Turtle, driven: Keyboard) -> None:
    """F stops the turtle on its way to a heading."""
    driven.type(b"d")
    eventually(lambda: turtle.now.angular_velocity != 0.0)
    driven.type(b"f")
    eventually(lambda: turtle.now.angular_velocity == 0.0)
    assert not is_at(turtle.now, HEADINGS_RAD["d"])


def test_it_drives_the_named_turtle(bus: simulated_bus.Bus, keyboard: Keyboard) -> None:
    """`--turtle` names another turtle, and parameters set its speed."""
    heard: list[Twist] = []
    bus.node("listener").create_subscription(Twist, "turtle2/cmd_vel", heard.append)
    program = bus.start("teleop", "--turtle", "turtle2", "--param", "scale_linear=1.5")
    program.wait_for_line("Driving turtle2")

    def press_until_heard() -> bool:
        keyboard.type(b"\x1b[A")
        return bool(heard)

    eventually(press_until_heard)
    assert heard[0] == Twist(linear=Vector3(x=1.5))
    program.wait_for_line("No turtle 'turtle2': start the simulator")
    keyboard.type(b"Q")
    assert program.wait() == 0
    assert program.stderr.count("No turtle 'turtle2'") == 1


def test_it_says_where_the_turtle_is(bus: simulated_bus.Bus, keyboard: Keyboard) -> None:
    """A turtle in a namespace below is named at the first key, with the way to drive it."""
    bus.start("simulator", "--headless", "--namespace", "robot7").wait_for_line("ready")
    program = bus.start("teleop")
    program.wait_for_line("Driving turtle1")
    keyboard.type(b"\x1b[A")
    program.wait_for_line(
        "No turtle 'turtle1': it is in namespace robot7; drive it with --namespace"
    )
    keyboard.type(b"q")
    assert program.wait() == 0


@pytest.mark.real
def test_it_works_in_tmux(bus: Bus, tmp_path: Path) -> None:
    """In tmux, which encodes arrows in its own way, keys drive and Q returns to the shell."""
    needs.program("tmux")
    heard: list[Twist] = []
    bus.node("listener").create_subscription(Twist, "turtle1/cmd_vel", heard.append)
    env = {**bus.env, "TMUX_TMPDIR": str(tmp_path), "TERM": "xterm-256color"}

    def tmux(*arguments: str) -> str:
        command = ["tmux", "-f", "/dev/null", *arguments]
        return subprocess.run(command, env=env, capture_output=True, text=True).stdout

    def press_until_heard() -> bool:
        tmux("send-keys", "Left")
        return bool(heard)

    tmux("new-session", "-d", "-x", "90", "-y", "20", f"{' '.join(TELEOP)}; echo left; cat")
    try:
        eventually(lambda: BANNER in tmux("capture-pane", "-p"))
        eventually(press_until_heard)
        tmux("send-keys", "q")
        eventually(lambda: "left" in tmux("capture-pane", "-p"))
    finally:
        tmux("kill-server")
    assert heard[0] == Twist(angular=Vector3(z=2.0))


@pytest.mark.real
@pytest.mark.parametrize(
    ("ending", "exit_code"),
    [
        (b"q", 0),
        (b"Q", 0),
        (b"\x03", 0),
        (signal.SIGINT, 0),
        (signal.SIGTERM, 0),
        (signal.SIGHUP, -signal.SIGHUP),
        (signal.SIGQUIT, -signal.SIGQUIT),
    ],
)
def test_the_terminal_gets_its_modes_back(
    teleop: Terminal, ending: bytes | signal.Signals, exit_code: int
) -> None:
    """While it reads keys the terminal does not echo; however it ends, all modes come back."""
    assert not teleop.echoes
    if isinstance(ending, bytes):
        teleop.type(ending)
    else:
        teleop.process.send_signal(ending)
    assert teleop.exit_code() == exit_code
    assert teleop.modes() == teleop.found
    assert "Traceback" not in teleop.text


@pytest.mark.real
def test_the_terminal_has_its_modes_while_teleop_is_stopped(bus: Bus) -> None:
    """After Ctrl-Z the terminal echoes, after fg keys are read again; the end restores it."""
    terminal = Terminal(TELEOP, {**bus.env, "TFBUS_CONFIG": str(bus.quick_config)}, IN_SHELL)
    terminal.wait_for("Driving turtle1")
    terminal.type(b"\x1a")
    terminal.wait_for("stopped with echo True")
    eventually(lambda: not terminal.echoes)
    terminal.type(b"q")
    assert terminal.exit_code() == 0
    assert terminal.modes() == terminal.found
    terminal.close()


def test_an_exception_restores_the_terminal_too() -> None:
    """The modes come back when the code that reads keys fails."""
    master, slave = os.openpty()
    found = termios.tcgetattr(slave)
    with pytest.raises(ZeroDivisionError), RawTerminal(slave):
        assert termios.tcgetattr(slave) != found
        raise ZeroDivisionError
    assert termios.tcgetattr(slave) == found
    os.close(master)
    os.close(slave)


def test_a_terminal_that_has_gone_raises() -> None:
    """Reading from a terminal whose window was closed raises instead of waiting forever."""
    master, slave = os.openpty()
    with RawTerminal(slave) as terminal:
        assert terminal.read(0.0) == b""
        os.close(master)
        with pytest.raises(NoTerminalError, match="was closed"):
            terminal.read(1.0)
    os.close(slave)


@pytest.mark.real
def test_without_a_terminal_it_says_so(bus: Bus) -> None:
    """With standard input redirected it ends with exit code 2 and one sentence."""
    done = bus.run("teleop", stdin="q")
    assert done.returncode == 2
    assert done.stdout == ""
    assert re.fullmatch(r"Error: standard input .* terminal: .*\n", done.stderr)
