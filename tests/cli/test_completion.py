"""Completion: by real shells in a terminal, of names on the bus, and without a bus."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import count
from pathlib import Path

import click
import pytest
from click.shell_completion import CompletionItem

from tests import live_bus, needs, recordings
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import (
    Node,
    NodeSettings,
    StaticTransformBroadcaster,
    Transform,
    TransformStamped,
)
from tfbus.cli import main
from tfbus.cli.completion import SHELLS, Bash
from tfbus.cli.message import complete_values, prototype, supplied_names, supplied_type
from tfbus.command import names
from tfbus.command.names import live_names, look_for_names
from tfbus.command.types import LiveNames
from tfbus.messages import Pose, Spawn, Twist
from tfbus.recording.items import TopicItem

AnyBus = Bus | live_bus.Bus

# Names of frames, some of them hard for shells.
FRAMES = ["arm:tip=$5", "d'or", "left camera", "world"]

# A request to fill in, as each shell writes it.
A_SPAWN = {
    "bash": """'{x: 0.0, y: 0.0, theta: 0.0, name: ""}'""",
    "zsh": """'{x: 0.0, y: 0.0, theta: 0.0, name: ""}'""",
    "fish": r"""\{x:\ 0.0,\ y:\ 0.0,\ theta:\ 0.0,\ name:\ \"\"\}""",
}

# How to start each shell without a user's settings, and to source the script.
STARTED = {
    "bash": ("bash --norc --noprofile -i", "source ./script"),
    "zsh": ("zsh -f -i", "autoload -Uz compinit; compinit -u -D; source ./script"),
    "fish": ("fish --no-config", "source ./script"),
}


def robot(bus: AnyBus, namespace: str = "") -> Node:
    """A node with a parameter, topics, a service and the frames."""
    node = bus.node("sim", namespace=namespace)
    node.declare_parameter("holonomic", False)
    node.create_publisher(Pose, "turtle1/pose")
    node.create_subscription(Twist, "turtle1/cmd_vel", lambda twist: None)
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
    StaticTransformBroadcaster(node).send_transform(
        [TransformStamped(1, "world", child, Transform.identity()) for child in FRAMES[:-1]]
    )
    return node


@pytest.fixture
def env(bus: AnyBus, tmp_path: Path) -> dict[str, str]:
    """The environment of a user with an empty home and `tfbus` on the path."""
    return {
        **bus.env,
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "XDG_CONFIG_HOME": str(tmp_path / "config"),
        "XDG_DATA_HOME": str(tmp_path / "data"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "TERM": "screen",
    }


def candidates(bus: AnyBus, env: dict[str, str], line: str) -> list[str]:
    """The candidates that `tfbus` answers the script of fish for this line."""
    done = bus.run(env={**env, "_TFBUS_COMPLETE": "fish_complete", "TFBUS_LINE": line})
    assert (done.returncode, done.stderr) == (0, "")
    rows = [row.split("\t") for row in done.stdout.splitlines() if row]
    return [value for kind, value, _ in rows if kind in ("plain", "map")]


def offers(bus: AnyBus, env: dict[str, str], *lines: tuple[str, list[str]]) -> bool:
    """Whether the lines are completed so in the end: the first look may miss slow nodes."""

    def found() -> bool:
        return all(candidates(bus, env, line) == wanted for line, wanted in lines) or forget(env)

    return eventually(found)


def cache_files(env: Mapping[str, str]) -> list[Path]:
    """The files of names that were found."""
    return list((Path(env["XDG_CACHE_HOME"]) / "tfbus").glob("*"))


def forget(env: Mapping[str, str]) -> bool:
    """Delete the cache; returns False."""
    shutil.rmtree(Path(env["XDG_CACHE_HOME"]) / "tfbus", ignore_errors=True)
    return False


def refresh(env: Mapping[str, str]) -> None:
    """Make the cache as new as now, by the clock of the test's bus."""
    now_s = time.time()
    for file in cache_files(env):
        os.utime(file, (now_s, now_s))


class Terminal:
    """A shell in a terminal of tmux."""

    def __init__(self, shell: str, env: dict[str, str], folder: Path):
        self._socket = ["tmux", "-f", "/dev/null", "-S", str(folder / "tmux")]
        self._env = env
        self.shell = shell
        started, _ = STARTED[shell]
        self._tmux("new-session", "-d", "-x", "100", "-y", "30", "-c", str(folder), started)

    def type(self, *keys: str) -> None:
        """Press keys; a text is typed as it is, `Tab` and `Enter` are those keys."""
        self._tmux("send-keys", *keys)

    def screen(self) -> str:
        """The text on the screen."""
        return self._tmux("capture-pane", "-p")

    def line(self) -> str:
        """The last line that contains `tfbus`, from there on; "" if there is none."""
        lines = [line for line in self.screen().splitlines() if "tfbus" in line]
        return lines[-1][lines[-1].index("tfbus") :] if lines else ""

    def shows(self, line: str) -> bool:
        """Whether that is the last line."""
        return self.line() == line

    def shows_no_longer(self, line: str) -> bool:
        """Whether the last line has become another one."""
        return not self.shows(line)

    def close(self) -> None:
        """End the shell."""
        self._tmux("kill-server")

    def _tmux(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self._socket, *arguments], env=self._env, capture_output=True, text=True, check=True
        )
        return done.stdout


@pytest.fixture(params=STARTED)
def terminal(
    request: pytest.FixtureRequest, env: dict[str, str], tmp_path: Path
) -> Iterator[Terminal]:
    """Each of the shells that are installed, with the script of completion taken."""
    shell = request.param
    for program in (shell, "tmux"):
        needs.program(program)
    script = subprocess.run(
        ["tfbus", "completion", shell], env=env, capture_output=True, text=True, check=True
    )
    (tmp_path / "script").write_text(script.stdout)
    terminal = Terminal(shell, env, tmp_path)
    terminal.type(f"{STARTED[shell][1]}; echo tak''en", "Enter")
    eventually(lambda: "\ntaken" in terminal.screen(), every_s=0.1)
    yield terminal
    terminal.close()


@pytest.mark.real
def test_a_shell_completes_what_is_typed(
    bus: live_bus.Bus, env: dict[str, str], terminal: Terminal
) -> None:
    """With Tab a shell completes commands, live names, launch files and their arguments."""
    robot(bus)

    def all_are_found() -> bool:
        found = candidates(bus, env, "tfbus echo ")
        cached = "".join(file.read_text() for file in cache_files(env))
        return found == FRAMES and all(
            name in cached for name in ("holonomic", "turtle1/pose", "spawn")
        )

    eventually(lambda: all_are_found() or forget(env))
    for typed, completed in (
        ("tfbus topic ec", "tfbus topic echo X"),
        ("tfbus topic echo turtle1/p", "tfbus topic echo turtle1/pose X"),
        ("tfbus echo left", r"tfbus echo left\ camera X"),
        ("tfbus echo arm:t", r"tfbus echo arm:tip=\$5 X"),
        ("tfbus param set sim ho", "tfbus param set sim holonomic X"),
        ("tfbus call spawn ", f"tfbus call spawn {A_SPAWN[terminal.shell]} X"),
        ("tfbus launch turtle turtlen", "tfbus launch turtle turtlename:=X"),
        ("tfbus launch turtle turtlename:=t", "tfbus launch turtle turtlename:=turtle1 X"),
    ):
        terminal.type("C-u", "C-l")
        eventually(lambda: not terminal.line(), every_s=0.1)
        terminal.type(typed)
        shown = typed.rstrip()
        eventually(partial(terminal.shows, shown), every_s=0.1)
        refresh(env)
        terminal.type("Tab")
        eventually(partial(terminal.shows_no_longer, shown), every_s=0.1)
        terminal.type("X")
        eventually(lambda: terminal.line().endswith("X"), every_s=0.1)
        assert terminal.line() == completed


class TestCandidates:
    def test_names_are_those_of_the_place_that_the_options_say(
        self, bus: Bus, env: dict[str, str]
    ) -> None:
        """With --namespace the names are those within; hidden nodes are no candidates."""
        robot(bus, "robot7")
        bus.node("_echo_1")
        inside = "--namespace robot7"
        assert offers(
            bus,
            env,
            ("tfbus node info ", ["robot7/sim"]),
            ("tfbus node info /", ["/robot7/sim"]),
            ("tfbus echo ", []),
            (f"tfbus node info {inside} ", ["sim"]),
            (f"tfbus node info {inside} /r", ["/robot7/sim"]),
            (f"tfbus topic hz {inside} /robot7/turtle1/p", ["/robot7/turtle1/pose"]),
            ("tfbus call /robot7/s", ["/robot7/spawn"]),
            (f"tfbus topic hz {inside} turtle1/pose tu", ["turtle1/cmd_vel", "turtle1/pose"]),
            (f"tfbus echo {inside} world ", FRAMES),
            ("tfbus echo --fleet ro", [f"robot7/{frame}" for frame in FRAMES]),
            ("tfbus why --fleet --shared world w", ["world"]),
        )

    def test_without_a_bus_there_are_no_names(self, bus: Bus, env: dict[str, str]) -> None:
        """An unreachable router or an invalid option gives no names and no error."""
        for options in ("--mode client --connect tcp/127.0.0.1:1", "--connect nonsense"):
            assert candidates(bus, env, f"tfbus node info {options} ") == []

    def test_arguments_of_a_launch_file(
        self, bus: Bus, env: dict[str, str], tmp_path: Path
    ) -> None:
        """A launch file's arguments are completed, then its choices; each is given once."""
        file = tmp_path / "robot.yaml"
        file.write_text(
            "arguments: {side: {choices: [left, right]}, speed: }\nnodes: [{node: simulator}]\n"
        )
        line = f"tfbus launch {file} "
        assert candidates(bus, env, line) == ["side:=", "speed:="]
        assert candidates(bus, env, f"{line}side:=left s") == ["speed:="]
        assert candidates(bus, env, f"{line}side:=r") == ["side:=right"]
        assert candidates(bus, env, "tfbus launch nosuch ") == []

    def test_types_and_values(self, bus: Bus, env: dict[str, str]) -> None:
        """After a topic comes a type; the value of a parameter is not completed."""
        robot(bus)
        assert candidates(bus, env, "tfbus topic pub turtle1/cmd_vel Tw") == [
            "Twist",
            "TwistWithCovariance",
        ]
        assert candidates(bus, env, "tfbus param set sim holonomic ") == []
        assert offers(bus, env, ("tfbus param get sim ", ["holonomic"]))

    def test_a_line_is_split_as_the_shell_does(self, bus: Bus, env: dict[str, str]) -> None:
        """Quotes may be open, blanks escaped; an unknown command has no candidates."""
        assert candidates(bus, env, "tfbus topic 'ec") == ["echo"]
        assert candidates(bus, env, r"tfbus topic echo\ ") == []
        assert (
            candidates(bus, env, "")
            == candidates(bus, env, "tfbus ")
            == candidates(bus, env, "tfbus nosuch ")
        )

    def test_a_message_to_fill_in(self, bus: Bus, env: dict[str, str]) -> None:
        """For a message or request, one with its defaults or zeros is offered."""
        robot(bus)
        twist = "{linear: {x: 0.0, y: 0.0, z: 0.0}, angular: {x: 0.0, y: 0.0, z: 0.0}}"
        assert offers(
            bus,
            env,
            ("tfbus topic pub turtle1/cmd_vel Twist ", [twist]),
            ("tfbus topic pub turtle1/cmd_vel ", [twist, *supplied_names()]),
            ("tfbus topic pub turtle1/cmd_vel Nosuch ", []),
            ("tfbus service call spawn ", ['{x: 0.0, y: 0.0, theta: 0.0, name: ""}']),
        )

    @pytest.mark.parametrize("name", supplied_names())
    def test_a_message_to_fill_in_is_one_of_its_type(self, name: str) -> None:
        """The offered message can be published as it is."""
        message_type = supplied_type(name)
        assert message_type is not None
        assert complete_values(prototype(message_type), message_type)


class TestBash:
    @pytest.mark.real
    @pytest.mark.parametrize("quote", ["", "'", '"'])
    def test_bash_reads_back_what_is_written(
        self, monkeypatch: pytest.MonkeyPatch, quote: str
    ) -> None:
        """Whatever a frame is called, bash takes the word for that name and runs nothing."""
        name = "~root$(echo run) `echo run` \\ \" ' ! * ~ ; & | < > #"
        monkeypatch.setenv("TFBUS_LINE", f"tfbus echo {quote}")
        written = Bash(main, {}, "tfbus", "_TFBUS_COMPLETE").written(name)
        done = subprocess.run(
            ["bash", "-c", f"printf %s {quote}{written}{quote}"], capture_output=True, text=True
        )
        assert done.stdout == name

    @pytest.mark.parametrize(
        ("line", "value", "written"),
        [
            ("tfbus echo ", "left camera", r"left\ camera"),
            (r"tfbus echo left\ c", "left camera", r"left\ camera"),
            ("tfbus echo 'left c", "left camera", "left camera"),
            ("tfbus echo d", "d'or", r"d\'or"),
            ("tfbus echo 'd", "d'or", r"d'\''or"),
            ('tfbus echo "', "$(touch `x`)", r"\$(touch \`x\`)"),
            ('tfbus echo "a', 'a "b" \\', r"a \"b\" \\"),
            ('tfbus echo "w', "wow!", r'wow"\!"'),
            ("tfbus echo $", "$(touch x)!", r"\$\(touch\ x\)\!"),
            ("tfbus launch turtle name:=t", "name:=turtle1", "turtle1"),
            ("tfbus launch turtle name:=", "name:=turtle1", "turtle1"),
            ("tfbus echo arm:t", "arm:tip=$5", r"tip=\$5"),
            ("tfbus echo ä", "ängste", "ängste"),
        ],
    )
    def test_only_the_part_that_bash_replaces_is_written(
        self, monkeypatch: pytest.MonkeyPatch, line: str, value: str, written: str
    ) -> None:
        """bash replaces the end of a word after its breaks; the rest is escaped for it."""
        monkeypatch.setenv("TFBUS_LINE", line)
        monkeypatch.setenv("TFBUS_BREAKS", " \t\n\"'@><=;|&(:")
        shell = Bash(main, {}, "tfbus", "_TFBUS_COMPLETE")
        assert shell.format_completion(CompletionItem(value, help="x")) == f"plain\t{written}\tx"


SETTINGS = NodeSettings("looker")


class TestNames:
    def test_all_names_are_found_at_once(self, bus: Bus) -> None:
        """One look brings frames, nodes, topics and services with their types, and parameters."""
        robot(bus)
        wanted = LiveNames(
            frames=tuple(FRAMES),
            nodes=("sim",),
            topics={
                "tf_static/sim": "TransformMessage",
                "turtle1/cmd_vel": "Twist",
                "turtle1/pose": "Pose",
            },
            services={"spawn": "Spawn"},
            parameters={"sim": ("holonomic",)},
        )
        eventually(lambda: look_for_names(SETTINGS) == wanted)

    def test_names_are_remembered_for_some_seconds(
        self, bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A second look within 5 s asks no node; a later one, or at another place, does."""
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        first = bus.node("first")
        eventually(lambda: live_names(SETTINGS).nodes == ("first",) or forget(os.environ))
        first.close()
        refresh(os.environ)
        assert live_names(SETTINGS).nodes == ("first",)
        (file,) = (tmp_path / "tfbus").iterdir()
        os.utime(file, (0, 0))
        eventually(lambda: live_names(SETTINGS).nodes == () or forget(os.environ))

    def test_each_identity_and_configuration_has_its_own(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Names of an open bus are not remembered for a closed one, nor another folder's files."""
        pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")
        from tfbus.bus.keystore import Keystore
        from tfbus.bus.rights import Identity

        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        monkeypatch.setattr(
            names, "look_for_names", lambda settings: LiveNames(nodes=(f"node{next(numbers)}",))
        )
        numbers = count(1)
        found = [live_names(NodeSettings("looker"))]
        for folder in ("here", "there"):
            (tmp_path / folder).mkdir()
            monkeypatch.chdir(tmp_path / folder)
            Keystore.init(Path("keys"), days=1).add(Identity("arm", "reader"), days=1)
            found.append(live_names(NodeSettings("arm", secure="keys/arm")))
        assert [each.nodes for each in found] == [("node1",), ("node2",), ("node3",)]

    @pytest.mark.parametrize("content", ["", "[]", "{", json.dumps({"frames": 5}), "\0"])
    def test_an_unreadable_cache_is_ignored(
        self, bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str
    ) -> None:
        """An invalid cache is ignored."""
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert live_names(SETTINGS) == LiveNames()
        (file,) = (tmp_path / "tfbus").iterdir()
        bus.node("sim")

        def is_ignored() -> bool:
            file.write_text(content)
            refresh(os.environ)
            return live_names(SETTINGS).nodes == ("sim",)

        eventually(is_ignored)


class TestCommand:
    @pytest.mark.parametrize("shell", SHELLS)
    def test_the_script_says_how_to_keep_it(self, bus: Bus, shell: str) -> None:
        """The script ends with where to put it, as comments."""
        done = bus.run("completion", shell)
        assert (done.returncode, done.stderr) == (0, "")
        assert f"# To keep it: tfbus completion {shell} > ~/" in done.stdout

    def test_the_shell_is_that_of_the_user(self, bus: Bus) -> None:
        """Without a name it is that of $SHELL; an unknown one is a usage error."""
        assert bus.run("completion", env={"SHELL": "/bin/zsh"}).stdout.startswith("#compdef tfbus")
        done = bus.run("completion", env={"SHELL": "/bin/tcsh"})
        assert done.returncode == 2
        assert done.stderr.endswith("Error: $SHELL is none of bash, zsh, fish: name a shell\n")

    def test_every_command_of_the_list_is_a_candidate(self) -> None:
        """Commands are completed without importing any."""
        context = click.Context(main)
        found = {item.value: item.help for item in main.shell_complete(context, "topi")}
        assert found == {"topic": "List, show, print, measure and publish topics."}


def test_names_are_completed_from_the_recording_that_the_line_names(
    bus: Bus, env: dict[str, str], tmp_path: Path
) -> None:
    """Frames, topics, nodes and parameters; no bus is looked at."""
    path = recordings.write(
        tmp_path / "run.mcap",
        recordings.node("/sim", parameters=[{"name": "speed", "value": 1.5, "type": "double"}]),
        recordings.steadily(recordings.publisher("sim"), 0.0, 1.0, ("world", "base_link")),
        TopicItem(recordings.at(0.5), "battery", "Battery", {"percent": 80.0}),
    )
    for line, wanted in (
        (f"tfbus echo --bag {path} wor", ["world"]),
        (f"tfbus why --bag {path} world ", ["base_link", "world"]),
        (f"tfbus topic echo --bag {path} b", ["battery"]),
        (f"tfbus node info --bag {path} ", ["/sim", "sim"]),
        (f"tfbus param get --bag {path} sim ", ["speed"]),
        (f"tfbus bag export {path} world b", ["base_link"]),
    ):
        assert set(candidates(bus, env, line)) <= set(wanted) and candidates(bus, env, line), line
