"""How tools and nodes end: at any moment, within seconds; nodes with exit code 0."""

import fcntl
import os
import pty
import re
import subprocess
import sys
import termios
import threading
import time
from signal import SIGINT, SIGTERM

import pytest

from tests import simulated_bus
from tests.buses import DEADLINE_S, eventually
from tests.live_bus import Bus
from tfbus import Node
from tfbus.bus.presence import NodeWatch, list_nodes

WAITS_IN_A_CALLBACK = """
import tfbus
buffer = tfbus.Buffer()
with tfbus.Node("waits") as node:
    def look() -> None:
        print("looking", flush=True)
        buffer.lookup_transform("nowhere", "either", timeout_s=600.0)
    node.create_timer(0.01, look)
    node.spin()
"""

# The words come from another thread, once a signal can no longer strike outside of the wait.
SAYS_WHILE_IT_WAITS = """
import threading, time, tfbus
from tfbus.messages import Spawn
def say_while_it_waits(node: tfbus.Node, word: str) -> None:
    def say() -> None:
        while not node._signals._is_held:
            time.sleep(0.001)
        print(word, flush=True)
    threading.Thread(target=say).start()
"""

WAITS_AFTER_THE_SIGNAL = f"""{SAYS_WHILE_IT_WAITS}
with tfbus.Node("waits") as node:
    client = node.create_client(Spawn, "spawn")
    say_while_it_waits(node, "first")
    node.wait(None)
    print("second", flush=True)
    client.wait_for_service()
"""

TWO_LOOPS = f"""{SAYS_WHILE_IT_WAITS}
with tfbus.Node("loops") as node:
    for word in ("first", "second"):
        say_while_it_waits(node, word)
        while node.wait(60.0):
            pass
    print("its end", flush=True)
"""

# Without a `with`: its session ends as Python does. The timer is sending nearly all the time.
SENDS_TO_THE_END = """
import tfbus
node = tfbus.Node("script")
sender = tfbus.TransformBroadcaster(node)
rows = tfbus.Transform.identity()
def send() -> None:
    for _ in range(200):
        sender.send_transform(tfbus.TransformStamped(node.now_ns(), "map", "base", rows))
    print("sent", flush=True)
node.create_timer(0.001, send)
node.spin()
"""

SIGNAL_WHILE_IT_IS_MADE = """
import signal, tfbus, tfbus.node.node
declare = tfbus.Node._declare_itself
def interrupted(self: tfbus.Node) -> None:
    signal.raise_signal(signal.SIGINT)
    declare(self)
tfbus.Node._declare_itself = interrupted
try:
    tfbus.Node("x")
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""

# A signal that its thread does not take while it waits for a lock, as one that comes in the instant
# before: the system gives it to another thread.
SIGNAL_PASSES_IT_BY = """
import signal, tfbus
from tfbus.messages import Spawn
with tfbus.Node("waits") as node:
    client = node.create_client(Spawn, "spawn")
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    print("waiting", flush=True)
    client.wait_for_service()
"""

INTERRUPTED_IN_EXEC = """
import tfbus
with tfbus.Node("reader") as node:
    exec("import os, signal; os.kill(os.getpid(), signal.SIGINT); node.wait(60.0)")
    print("went on", flush=True)
"""

SIGNAL_WHILE_IT_LOADS = """
import os, signal, sys
class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[-1]:
            del sys.argv[-1]
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupter())
from tfbus.__main__ import main
main()
"""


SIGNAL_AS_IT_BEGINS = """
import os, signal
replace = signal.signal
def replace_late(*given):
    os.kill(os.getpid(), signal.SIGINT)
    return replace(*given)
signal.signal = replace_late
from tfbus.__main__ import main
main()
"""


class Prompt:
    """Python's prompt, in a terminal of its own, where Ctrl-C is a key."""

    def __init__(self, bus: Bus) -> None:
        self._keyboard, terminal = pty.openpty()
        self.popen = subprocess.Popen(
            [sys.executable, "-q", "-i", "-c", ""],
            env={**bus.env, "TERM": "dumb", "PYTHON_BASIC_REPL": "1"},
            stdin=terminal,
            stdout=terminal,
            stderr=terminal,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(terminal)
        self._shown = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        try:
            while more := os.read(self._keyboard, 4096):
                self._shown += more
        except OSError:  # the terminal has closed
            return

    def types(self, text: str, answer: str) -> None:
        """Type a line, or a key, and wait for the answer, which the line itself does not have."""
        self._shown = b""
        os.write(self._keyboard, text.encode() if text == "\x03" else f"{text}\n".encode())
        try:
            eventually(lambda: answer.encode() in self._shown)
        except AssertionError:
            raise AssertionError(f"{answer!r} is not in {self._shown!r}") from None

    def close(self) -> None:
        """End the process."""
        self.popen.kill()
        self.popen.wait(DEADLINE_S)
        os.close(self._keyboard)


@pytest.mark.real
@pytest.mark.parametrize(
    ("tool", "module"), [("topic hz a", "click"), ("static a b", "tfbus.command.options")]
)
def test_what_is_interrupted_while_it_loads_ends_without_a_word(
    bus: Bus, tool: str, module: str
) -> None:
    """Ctrl-C while a tool or a node is imported ends it at once, and nothing is printed."""
    command = [sys.executable, "-c", SIGNAL_WHILE_IT_LOADS, *tool.split(), module]
    process = bus.start_command(command)
    assert process.wait() == -SIGINT
    assert process.out == []
    assert process.err == []


@pytest.mark.real
def test_a_signal_as_a_tool_begins_is_neither_lost_nor_shown(bus: Bus) -> None:
    """Ctrl-C in the instant in which Python's handler is replaced ends it without a word."""
    process = bus.start_command([sys.executable, "-c", SIGNAL_AS_IT_BEGINS, "frames"])
    assert process.wait() == -SIGINT
    assert process.out == []
    assert process.err == []


@pytest.mark.parametrize(
    ("tool", "code"),
    [
        ("frames --wait-time 600", 130),
        pytest.param("doctor --for 600", 130, marks=pytest.mark.real),  # scouts
        ("why a b", 130),
        ("plot a b --for 600 -o a.png", 1),
        ("topic echo a --once", 130),
        ("topic hz a --once", 130),
        ("topic pub --once nobody/cmd_vel Twist", 130),
        ("echo a b --once", 130),
        ("monitor --once --period 600", 130),
        ("topic echo a", 0),
        ("topic hz a", 0),
        ("monitor", 0),
        ("frames --watch", 0),
    ],
)
def test_a_tool_that_is_interrupted_says_no_more_than_a_line(
    bus: simulated_bus.Bus, tool: str, code: int
) -> None:
    """Ctrl-C ends with 0 what goes on until then, and with 130 what had not come to its answer."""
    watcher: Node = bus.node("watcher")
    started = bus.start(*tool.split())
    eventually(lambda: len(list_nodes(watcher.session)) > 1)
    assert started.stop() in (130, code)  # it may not have begun to go on
    report = [line for line in started.err if not re.search("Listening|Printing", line)]
    assert len(report) <= (code == 1)
    assert not any(word in line for line in report for word in ("Aborted", "Traceback"))


@pytest.mark.real
def test_a_node_that_imports_something_ends_as_any_other(bus: Bus) -> None:
    """Ctrl-C within an import, which defines its dataclasses by exec(), is a clean end too."""
    process = bus.start_command([sys.executable, "-c", INTERRUPTED_IN_EXEC])
    assert process.wait() == 0
    assert (process.out, process.err) == ([], [])


@pytest.mark.real
@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_callback_that_waits_does_not_hold_up_the_end(bus: Bus, number: int) -> None:
    """A node ends although one of its callbacks waits for a transform that never comes."""
    process = bus.start_command([sys.executable, "-c", WAITS_IN_A_CALLBACK])
    process.wait_for_line("looking")
    assert process.stop(number) == 0
    assert [line for line in process.err if "ready" not in line] == []


def sleep_in_a_callback() -> None:
    """A node whose callback does not return."""
    with Node("sleeps") as node:

        def look() -> None:
            print("looking")
            time.sleep(600.0)

        node.create_timer(0.01, look)
        node.spin()


def test_a_callback_that_does_not_return_does_not_hold_up_the_end(bus: simulated_bus.Bus) -> None:
    """It is named, after 2 s."""
    process = bus.network.program("outside", sleep_in_a_callback, env=bus.env)
    process.wait_for_line("looking")
    assert process.stop(SIGTERM) == 0
    process.wait_for_line("Closed while a callback still runs: timer of 10 ms .*look\\)")


@pytest.mark.real
def test_timers_end_before_the_session_of_a_script(bus: Bus) -> None:
    """A script that ends without closing its node ends with 0, and no timer fails meanwhile."""
    process = bus.start_command([sys.executable, "-c", SENDS_TO_THE_END])
    process.wait_for_line("sent")
    assert process.stop() == 0
    assert not any("Traceback" in line for line in process.err), process.err


@pytest.mark.real
def test_another_signal_interrupts_what_waits_after_the_first(bus: Bus) -> None:
    """A program that goes on to wait after Ctrl-C is ended by the next one."""
    process = bus.start_command([sys.executable, "-c", WAITS_AFTER_THE_SIGNAL])
    process.wait_for_line("first")
    process.signal(SIGINT)
    process.wait_for_line("second")
    assert process.stop(SIGINT) == 0
    assert process.err == []


@pytest.mark.real
def test_a_signal_while_a_node_is_made_is_not_lost(bus: Bus) -> None:
    """Ctrl-C during `Node()` ends it with KeyboardInterrupt."""
    process = bus.start_command([sys.executable, "-c", SIGNAL_WHILE_IT_IS_MADE])
    assert process.wait() == 0
    assert process.out == ["interrupted"]
    assert process.err == []


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_node_ends_from_the_moment_it_is_there(bus: simulated_bus.Bus, number: int) -> None:
    """A node that gets a signal as soon as it is listed ends with 0 and without a traceback."""
    watcher: Node = bus.node("watcher")
    watch = NodeWatch(watcher.session)
    for at in range(4):
        process = bus.start("follow", "--name", f"follow{at}")
        assert watch.wait(f"/follow{at}", timeout_s=20.0)
        assert process.stop(number) == 0
        assert not any("Traceback" in line for line in process.err)


@pytest.mark.real
@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_signal_that_no_wait_noticed_still_ends_it(bus: Bus, number: int) -> None:
    """A wait for a lock ends also where the signal did not interrupt it."""
    process = bus.start_command([sys.executable, "-c", SIGNAL_PASSES_IT_BY])
    process.wait_for_line("waiting")
    assert process.stop(number) == 0
    assert process.err == []


@pytest.mark.real
def test_a_script_goes_on_after_the_loop_that_ctrl_c_ended(bus: Bus) -> None:
    """Ctrl-C ends the loop in progress; a second one the next loop; then the script has ended."""
    process = bus.start_command([sys.executable, "-c", TWO_LOOPS])
    process.wait_for_line("first")
    process.signal(SIGINT)
    process.wait_for_line("second")
    process.signal(SIGINT)
    process.wait_for_line("its end")
    assert process.wait() == 0
    assert process.err == []


@pytest.mark.real
def test_at_the_prompt_ctrl_c_leaves_the_node_alive(bus: Bus) -> None:
    """Interrupted at Python's prompt, in a spin and outside of one, the node works on."""
    prompt = Prompt(bus)
    try:
        prompt.types('import tfbus; node = tfbus.Node("typed"); print("made" + "!")', "made!")
        prompt.types("node.spin()", "ready")
        prompt.types("\x03", "KeyboardInterrupt")
        prompt.types('print("alive", node.ok, node.wait(0.0))', "alive True True")
        prompt.types("node.close()\nexit()\n", "")
        assert prompt.popen.wait(DEADLINE_S) == 0
    finally:
        prompt.close()
