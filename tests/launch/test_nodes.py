"""`tfbus launch` with tfbus nodes on a bus: names, options, and start by readiness."""

import os
import re
import shlex
import signal
from pathlib import Path
from textwrap import dedent

import pytest

from tests import simulated_bus
from tests.buses import eventually
from tests.live_bus import Bus, Process, free_port
from tfbus.bus.presence import list_nodes

TALKER = """
    from tfbus import Node

    with Node.from_args("talker") as node:
        word = node.declare_parameter("word", "nothing")
        print(f"I am {node.full_name} and say {word.value}", flush=True)
        node.spin()
"""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(dedent(text))
    return path


def launched(bus: Bus, *arguments: str) -> Process:
    """`tfbus launch ARGUMENTS`, whose nodes do not wait until they have found others."""
    return bus.start("launch", *arguments, env={"TFBUS_CONFIG": str(bus.quick_config)})


@pytest.mark.real
def test_nodes_learn_their_names_parameters_and_bus_from_the_launch_file(
    bus: Bus, tmp_path: Path
) -> None:
    """A node of one's own gets name, namespace and parameters, and is on the bus of the launch."""
    write(tmp_path, "talker.py", TALKER)
    path = write(
        tmp_path,
        "robot.yaml",
        """
        arguments: {word: {default: hello}}
        nodes:
          - {node: talker.py, parameters: {word: "${word}"}}
          - {node: talker.py, name: bob, namespace: b}
        """,
    )
    launch = launched(bus, str(path), "word:=two words", "--namespace", "fleet")
    launch.wait_for_line(r"^\[fleet/talker\] I am /fleet/talker and say two words$")
    launch.wait_for_line(r"^\[fleet/b/bob\] I am /fleet/b/bob and say nothing$")
    watcher = bus.node("watcher")
    expected = {"/fleet/b/bob", "/fleet/talker"}
    eventually(lambda: expected <= set(list_nodes(watcher.session)))
    assert launch.stop() == 0
    eventually(lambda: not expected & set(list_nodes(watcher.session)))


@pytest.mark.real
def test_a_node_starts_when_the_one_it_waits_for_is_on_the_bus(bus: Bus, tmp_path: Path) -> None:
    """`after:` is settled by the node itself being there, wherever it was started."""
    write(tmp_path, "talker.py", TALKER)
    path = write(
        tmp_path,
        "robot.yaml",
        """
        nodes:
          - {node: talker.py, name: last, after: middle}
          - {node: talker.py, name: middle, after: /elsewhere/first}
        """,
    )
    launch = launched(bus, str(path))
    launch.wait_for_line(r"\[INFO\] \[middle\]: waiting for /elsewhere/first")
    assert not any("process started" in line for line in launch.err)
    bus.node("first", namespace="elsewhere")
    launch.wait_for_line(r"^\[last\] I am /last")
    launch.wait_for_line(r"\[last\]: process started")  # on another pipe, which is read apart
    started = re.findall(r"\[(\w+)\]: process started", "\n".join(launch.err))
    assert started == ["middle", "last"]
    assert launch.stop(signal.SIGTERM) == 0


@pytest.mark.real
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_launch_waits_for_its_router(bus: Bus, tmp_path: Path, number: int) -> None:
    """A client's launch may begin before the router; Ctrl-C ends it cleanly while it waits."""
    write(tmp_path, "talker.py", TALKER)
    path = write(
        tmp_path,
        "robot.yaml",
        "nodes: [{node: talker.py}, {node: talker.py, name: last, after: talker}]",
    )
    router = f"tcp/127.0.0.1:{free_port()}"
    launch = launched(bus, str(path), "--mode", "client", "--connect", router)
    launch.wait_for_line(f"Waiting for a router at {router}")
    assert launch.stop(number) == 0
    assert "Traceback" not in "\n".join(launch.err)


@pytest.mark.real
def test_nodes_that_still_load_end_without_a_word(bus: Bus) -> None:
    """Ctrl-C right after the start ends nodes whose Python is not ready for it yet."""
    # On a busy machine they take long to load, and launch says of whom it waits too long for; or
    # the test takes long, and they say that they are ready.
    launch = launched(bus, "turtle", "headless:=true", "--sigterm-timeout", "100")
    launch.wait_for_line(r"\[broadcaster1\]: process started")
    assert launch.stop() == 0
    assert launch.out == []
    usual = re.compile(r"(\[\w+\] \[(INFO|WARN)\]|\[(INFO|WARNING)\]) ")
    assert all(map(usual.match, launch.err)), launch.err


@pytest.mark.parametrize("option", ["--for", "--sigterm-timeout", "--sigkill-timeout"])
def test_times_are_finite(bus: simulated_bus.Bus, option: str) -> None:
    """A time that is no number of seconds is a usage error."""
    assert bus.run("launch", "turtle", option, "nan").returncode == 2


@pytest.mark.parametrize(
    ("options", "code", "stdout", "stderr"),
    [
        (["--dry-run"], 0, "[a] env PYTHONUNBUFFERED=1 TFBUS_LOG_LEVEL=info true", ""),
        (["--show-args"], 0, "No arguments.", ""),
        (["x:=1"], 2, "", "takes no argument 'x'; it takes none"),
        (["x=1"], 2, "", "takes no argument 'x'; it takes none"),
        (["x"], 2, "", "'x' is not of the form NAME:=VALUE"),
        (["--mode", "pear"], 2, "", "is not one of"),
        (["--namespace", "a//b"], 2, "", "cannot be the name of a namespace"),
    ],
)
def test_the_command_line_of_launch(
    bus: simulated_bus.Bus, tmp_path: Path, options: list[str], code: int, stdout: str, stderr: str
) -> None:
    """The options of `tfbus launch`; wrong ones exit with 2."""
    path = write(tmp_path, "nodes.yaml", "nodes: [{command: ['true'], name: a}]\n")
    ended = bus.run("launch", str(path), *options)
    assert ended.returncode == code
    assert stdout in ended.stdout
    assert stderr in " ".join(ended.stderr.split())
    assert "Traceback" not in ended.stderr


def test_a_mistake_in_a_file_is_one_line(bus: simulated_bus.Bus, tmp_path: Path) -> None:
    """A wrong launch file gives its line and key, exit code 1, and no traceback."""
    ended = bus.run("launch", str(write(tmp_path, "nodes.yaml", "nodes:\n  - {nod: a}\n")))
    assert ended.returncode == 1
    assert "nodes.yaml:2: nodes[0].nod: " in ended.stderr and "mean 'node'" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.real
def test_a_killed_node_is_back_on_the_bus(bus: Bus, tmp_path: Path) -> None:
    """A node with `respawn` that is killed with SIGKILL comes back under its name."""
    write(tmp_path, "talker.py", TALKER)
    path = write(tmp_path, "robot.yaml", "nodes: [{node: talker.py, respawn: {delay: 0}}]")
    launch = launched(bus, str(path))
    launch.wait_for_line(r"^\[talker\] I am /talker")
    pid = launch.wait_for_line("process started with pid").split("[")[-1].rstrip("]")
    watcher = bus.node("watcher")
    eventually(lambda: "/talker" in list_nodes(watcher.session))
    os.kill(int(pid), signal.SIGKILL)
    eventually(lambda: len([line for line in launch.out if "I am /talker" in line]) == 2)
    eventually(lambda: "/talker" in list_nodes(watcher.session))
    assert launch.stop() == 0


@pytest.mark.parametrize(
    ("name", "nodes"),
    [
        ("turtle", ["/broadcaster1", "/sim"]),
        ("follow", ["/broadcaster1", "/broadcaster2", "/listener", "/sim"]),
        ("carrot", ["/broadcaster1", "/broadcaster2", "/carrot", "/listener", "/sim"]),
        ("time_travel", ["/broadcaster1", "/broadcaster2", "/carrot", "/listener", "/sim"]),
        ("square", ["/broadcaster1", "/draw_square", "/sim"]),
    ],
)
def test_the_installed_launch_files_bring_their_nodes(
    bus: simulated_bus.Bus, name: str, nodes: list[str]
) -> None:
    """Each launch file that comes with tfbus names its nodes, which start and end cleanly."""
    rows = bus.run("launch", name, "headless:=true", "--dry-run").stdout.splitlines()
    commands = [shlex.split(row.rpartition(" -m tfbus ")[2]) for row in rows]
    programs = [bus.start(*command) for command in commands]
    watcher = bus.node("watcher")
    eventually(lambda: list_nodes(watcher.session) == sorted(["/watcher", *nodes]))
    for program in programs:
        program.wait_for_line("ready$")
    assert [program.stop() for program in programs] == [0] * len(nodes)


@pytest.mark.real
def test_the_demo_prints_where_the_drone_is(bus: Bus) -> None:
    """`tfbus launch demo` prints a line for each place of the drone, and how to drive by hand."""
    launch = launched(bus, "demo", "headless:=true")
    launch.wait_for_line(r"^\[hint\] To drive by hand: ")

    def places() -> set[str]:
        return {line for line in launch.out if line.startswith("[echo] ")}

    eventually(lambda: len(places()) >= 2)
    assert all(
        re.fullmatch(r"\[echo\] \d+\.\d{3}: xyz \[.*\] m, rpy \[.*\] degrees", line)
        for line in places()
    )
    assert launch.stop() == 0
