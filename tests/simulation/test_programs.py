"""Programs in simulated processes: each one's own files and arguments, and its end."""

import atexit
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import ModuleType

import click
import pytest

import tfbus
from tfbus import Node, Transform, TransformBroadcaster, TransformStamped
from tfbus.recording.reader import RecordingReader
from tfbus.testing import Network, SimulationError, tasks


def _show() -> None:
    """A program that shows what it was given."""
    print(sys.argv[1:], os.environ.get("ROBOT"), sys.stdin.read(), sys.stdout.isatty())
    print("a mistake", file=sys.stderr)


def test_a_program_has_arguments_environment_input_and_output(network: Network) -> None:
    """All of them are its own, and the test's stay as they were."""
    before = sys.argv, os.environ, sys.stdout, sys.stdin
    program = network.program("outside", _show, "--rate", "5", env={"ROBOT": "r1"}, stdin="typed")
    assert program.wait() == 0
    assert program.out == ["['--rate', '5'] r1 typed False"]
    assert program.stderr == "a mistake\n"
    assert (sys.argv, os.environ, sys.stdout, sys.stdin) == before


def test_a_terminal_shows_output_and_errors_together(network: Network) -> None:
    """Both are terminals, and in the order in which they were written."""
    program = network.program("outside", _show, is_terminal=True)
    program.wait()
    assert program.out[-2:] == ["[] None  True", "a mistake"]


def test_output_and_errors_may_go_together(network: Network) -> None:
    """As behind `2>&1`: in the order in which they were written."""
    program = network.program("outside", _show, is_merged=True)
    program.wait()
    assert program.out[-2:] == ["[] None  False", "a mistake"]


def test_a_restarted_program_is_as_before(network: Network) -> None:
    """Its output and errors still go together."""
    network.program("outside", _show, name="show", is_merged=True).wait()
    program = network.restart("outside/show").program
    assert program is not None and program.wait() == 0
    assert program.out[-2:] == ["[] None  False", "a mistake"]


def test_two_programs_print_apart(network: Network) -> None:
    """However their turns change, each has its own output and environment."""

    def count() -> None:
        os.environ["SET"] = sys.argv[1]
        for number in range(3):
            print(sys.argv[1], os.environ["SET"], number)
            time.sleep(0.1)

    one, other = (network.program("outside", count, name) for name in "ab")
    network.run(1.0)
    assert one.out == ["a a 0", "a a 1", "a a 2"]
    assert other.out == ["b b 0", "b b 1", "b b 2"]
    assert "SET" not in os.environ


def _exit(code: object) -> None:
    raise SystemExit(code)


@pytest.mark.parametrize(
    ("main", "code", "said"),
    [
        (lambda: None, 0, ""),
        (lambda: _exit(None), 0, ""),
        (lambda: _exit(3), 3, ""),
        (lambda: _exit("no bus"), 1, "no bus\n"),
        (lambda: 1 / 0, 1, "ZeroDivisionError: division by zero\n"),
        (click.command("tool")(click.argument("n", type=int)(lambda n: None)), 2, "'N'.\n"),
    ],
)
def test_its_exit_code_is_that_of_python(
    network: Network, main: object, code: int, said: str
) -> None:
    """0 for a return, the code of SystemExit, 1 with a traceback for an error."""
    program = network.program("outside", main)  # type: ignore[arg-type]
    assert program.wait() == code
    assert program.stderr.endswith(said)


def _spin() -> None:
    with tfbus.Node("robot") as node:
        node.spin()
    print("ended")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_cleanly(network: Network, number: int) -> None:
    """Its program goes on after the node, as in a real process."""
    program = network.program("outside", _spin)
    program.wait_for_line("ready")
    assert program.stop(number) == 0
    assert program.out == ["ended"]


def test_ctrl_c_interrupts_what_waits(network: Network) -> None:
    """Without a node it raises KeyboardInterrupt in the main thread, wherever that waits."""

    def wait() -> None:
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            print("interrupted")
            time.sleep(1.0)

    program = network.program("outside", wait)
    network.run(0.1)
    assert program.stop(signal.SIGINT) == 0
    assert program.out == ["interrupted"]


def test_a_handler_lets_a_wait_go_on(network: Network) -> None:
    """If a handler returns, a sleep lasts as long as it was to."""

    def sleep() -> None:
        signal.signal(signal.SIGHUP, lambda number, frame: print("reload"))
        begun_s = time.monotonic()
        time.sleep(2.0)
        print(round(time.monotonic() - begun_s, 3))

    program = network.program("outside", sleep)
    network.run(0.5)
    program.signal(signal.SIGHUP)
    program.wait()
    assert program.out == ["reload", "2.0"]


def test_a_signal_without_a_handler_ends_it(network: Network) -> None:
    """With the number of the signal, at once; `os.kill` sends one by the number of a process."""
    program = network.program("outside", lambda: time.sleep(10.0))
    network.run(0.1)
    os.kill(program.pid, signal.SIGTERM)
    assert program.wait() == -signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(program.pid, signal.SIGTERM)


def test_signal_0_asks_whether_a_process_lives(network: Network) -> None:
    """It does nothing else."""
    program = network.program("outside", lambda: time.sleep(1.0))
    os.kill(program.pid, 0)
    assert program.wait() == 0
    with pytest.raises(ProcessLookupError):
        os.kill(program.pid, 0)


def test_os_exit_ends_a_program_at_once(network: Network) -> None:
    """With its code, without its `finally`, its threads and what is for its end."""

    def main() -> None:
        atexit.register(print, "at exit")
        threading.Thread(target=lambda: [time.sleep(1.0), print("thread")]).start()
        try:
            os._exit(3)
        finally:
            print("finally")

    program = network.program("outside", main)
    assert program.wait() == 3
    network.run(2.0)
    assert program.out == []


def test_a_program_whose_host_loses_its_power_has_ended(network: Network) -> None:
    """As by SIGKILL."""
    program = network.program(network.host("robot"), lambda: time.sleep(10.0))
    network.power_off("robot")
    assert program.wait() == -signal.SIGKILL


def test_it_waits_for_its_threads_and_then_calls_what_is_for_its_end(network: Network) -> None:
    """As Python does: threads that are no daemons, then `atexit`, the last first."""

    def main() -> None:
        atexit.register(print, "first")
        atexit.register(print, "last")
        atexit.unregister(atexit.register(_show))
        threading.Thread(target=lambda: [time.sleep(1.0), print("thread")]).start()
        threading.Thread(target=threading.Event().wait, daemon=True).start()

    program = network.program("outside", main)
    assert program.wait() == 0
    assert program.out == ["thread", "last", "first"]


def test_a_thread_that_never_ends_does_not_hold_up_the_end_of_the_simulation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its program, which waits for it, is ended before it."""
    monkeypatch.setattr(tasks, "_STUCK_AFTER_S", 0.2)
    has_program_ended: list[bool] = []

    def wait() -> None:
        try:
            threading.Event().wait()
        finally:
            has_program_ended.append(program.process.main.is_over)

    with Network() as network:
        program = network.program("outside", lambda: threading.Thread(target=wait).start())
        network.run(1.0)
    assert has_program_ended == [True]


def test_a_node_that_nobody_closes_leaves_at_the_end(network: Network) -> None:
    """Others know at once that it has gone."""
    seen = tfbus.Node("eye")
    network.program("outside", lambda: [tfbus.Node("robot"), time.sleep(1.0)]).wait()
    begun_ns = network.now_ns
    network.run(until=lambda: not seen.session.linked())
    assert network.now_ns - begun_ns < 10_000_000
    seen.close()


def test_an_error_shows_what_a_program_has_printed(network: Network) -> None:
    """A line that never comes, and an end that never comes, are told with output and errors."""
    program = network.program("outside", lambda: [print("hello"), time.sleep(100.0)], name="mute")
    with pytest.raises(SimulationError, match=r"mute .*'ready' within 1 s\nstdout: h"):
        program.wait_for_line("ready", timeout_s=1.0)
    with pytest.raises(SimulationError, match=r"mute .* within 1 s\nstdout: hello"):
        program.wait(timeout_s=1.0)
    program.kill()
    with pytest.raises(SimulationError, match="ended without 'ready'"):
        program.wait_for_line("ready")


def test_names_that_a_module_has_bound_are_virtual(monkeypatch: pytest.MonkeyPatch) -> None:
    """As by `from time import sleep`: in a module that is new, in one that has a new name since the
    simulation before, and in each further simulation; after each they are Python's own.
    """
    module = ModuleType("bound_names")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names: dict[str, object] = {"sleep": time.sleep, "monotonic": time.monotonic}
    for bound in (["sleep"], ["sleep", "monotonic"], ["sleep", "monotonic"]):
        for name in bound:
            setattr(module, name, names[name])
        with Network() as network:
            for name in bound:
                assert getattr(module, name) is not names[name]
            begun_ns = network.now_ns
            module.sleep(5.0)
            assert network.now_ns - begun_ns >= 5_000_000_000
        assert [getattr(module, name) for name in bound] == [names[name] for name in bound]


def _camera() -> None:
    with tfbus.Node("camera") as node:
        broadcaster = tfbus.TransformBroadcaster(node)

        def send() -> None:
            lens = tfbus.TransformStamped(node.now_ns(), "world", "lens", tfbus.Transform())
            broadcaster.send_transform(lens)

        node.create_timer(0.1, send)
        node.spin()


def test_an_installed_command_is_a_program(network: Network) -> None:
    """A tool of `tfbus` sees the nodes of other hosts, after its restart, too."""
    robot, base = network.host("robot"), network.host("base")
    network.start(robot, "camera", _camera)
    network.run(1.0)
    checks = network.program(base, "tfbus", "frames", "--check", "--json")
    assert checks.wait() == 0
    assert '"lens"' in checks.stdout
    echo = network.program(base, "tfbus", "echo", "world", "lens")
    echo.wait_for_line("Translation")
    again = network.restart("base/tfbus").program
    assert again is not None
    again.wait_for_line("Translation")
    assert again.stop() == 0


def _fail() -> None:
    raise ImportError("no module named 'camera'")


def test_what_waits_in_vain_names_the_programs_that_have_failed(network: Network) -> None:
    """With the last line of their errors."""
    network.program(network.host("robot"), _fail, name="broken")
    with pytest.raises(SimulationError, match=r"robot/broken .* 1: .*no module named"):
        network.run(until=lambda: False, timeout_s=1.0)


def test_a_node_of_arguments_has_none_of_pytest_s(network: Network) -> None:
    """A process of `start` has no arguments; those of the test stay as they are."""
    before = [*sys.argv]
    seen: list[list[str]] = []

    def main() -> None:
        with tfbus.Node.from_args("camera") as node:
            seen.append(sys.argv[1:])
            node.wait(0.1)

    network.start(network.host("robot"), "camera", main)
    network.run(1.0)
    assert seen == [[]]
    assert sys.argv == before


@pytest.mark.parametrize(
    ("command", "needs"), [("doctor", "mcap"), ("foxglove", "websockets"), ("view", "viser")]
)
def test_a_tool_with_sockets_says_how_to_look_into_the_network(
    network: Network, tmp_path: Path, command: str, needs: str
) -> None:
    """It names the way by a recording, which works."""
    pytest.importorskip("mcap")
    pytest.importorskip(needs)
    refused = network.program("outside", "tfbus", command)
    assert refused.wait() == 1
    path = tmp_path / "run.mcap"
    assert f"tfbus bag record -o {path.name}" in refused.stderr
    assert f"tfbus {command} --bag {path.name}" in refused.stderr
    recorder = network.program("outside", "tfbus", "bag", "record", "-o", str(path))
    recorder.wait_for_line("Recording to")
    with network.process("outside", "robot"):
        TransformBroadcaster(Node("robot")).send_transform(
            TransformStamped(0, "map", "base", Transform.identity())
        )
    network.run(1.0)
    assert recorder.stop() == 0
    with RecordingReader(path) as reader:
        assert [stream.stream.name for stream in reader.streams] == ["robot"]


def test_sites_of_a_hub_see_each_other(network: Network) -> None:
    """A robot at one site is known at another once their hub is there, and again once it was."""
    hub, *sites = (network.host(name) for name in ("hub", "yard", "hall"))
    for site in sites:
        network.program(site, "tfbus", "router", "--hub", "tcp/hub:7447", name="router")
    network.program(hub, "tfbus", "router", name="router").wait_for_line("Routing on")
    at = [("--mode", "client", "--connect", f"tcp/{site.name}:7447") for site in sites]
    network.program(sites[0], "tfbus", "static", "map", "base", "--x", "5", *at[0], name="robot")

    def is_seen() -> bool:
        echo = network.program(sites[1], "tfbus", "echo", "map", "base", "--once", *at[1])
        return echo.wait() == 0 and "5.000" in echo.stdout

    assert is_seen()
    network.restart("hub/router")
    assert is_seen()


def test_a_site_says_each_minute_that_it_waits_for_its_hub(network: Network) -> None:
    """Meanwhile its own nodes have a router."""
    site = network.program(network.host("yard"), "tfbus", "router", "--hub", "tcp/hub:7447")
    site.wait_for_line("Routing on")
    network.run(150.0)
    said = [line for line in site.stderr.splitlines() if "Waiting for a router" in line]
    assert len(said) == 3
    assert all("tcp/hub:7447" in line for line in said)
