"""The command line: exact output, exit codes, and one sentence for each mistake."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import tfbus
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import GoalHandle
from tfbus.base.installation import version_and_origin
from tfbus.bus.network_session import Declaration
from tfbus.bus.query import Query
from tfbus.cli import JOBS, NODES, TOOLS, main
from tfbus.messages import RotateAbsolute, SetPen, Spawn, TeleportRelative
from tfbus.testing.programs import Program
from tfbus.wire.codec import encode_map

_RESULT = RotateAbsolute.Result(-1.5)

# A client of a router that nobody runs.
NOWHERE = "tcp/127.0.0.1:7447"


def a_node() -> None:
    """A node of a user's own."""
    tfbus.Node.from_args("mine").spin()


def run(bus: Bus, *arguments: str) -> tuple[int, list[str], list[str]]:
    """Exit code, lines of stdout, lines of stderr."""
    done = bus.run(*arguments)
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()


def serve(bus: Bus) -> None:
    """A node /robot7/sim and a node /sim that offer a bit of everything."""
    bus.node("sim", namespace="robot7").declare_parameter("rate", 2.5)
    node = bus.node("sim")
    node.declare_parameter("background_r", 69, minimum=0, maximum=255)
    node.declare_parameter("holonomic", False)
    node.declare_parameter("title", "Turtles")
    node.create_publisher(Spawn.Response, "names")
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
    node.create_goal_server(
        RotateAbsolute,
        "rotate",
        lambda handle: (
            handle.feedback(RotateAbsolute.Feedback(0.5)),
            handle.succeed(RotateAbsolute.Result(-1.5)),
        ),
    )


class TestTools:
    def test_node_list(self, bus: Bus) -> None:
        """Nodes are listed one a line, counted, or as JSON."""
        serve(bus)
        assert run(bus, "node", "list") == (0, ["/robot7/sim", "/sim"], [])
        assert run(bus, "node", "list", "--count") == (0, ["2"], [])
        assert run(bus, "node", "list", "--namespace", "robot7") == (0, ["/robot7/sim"], [])
        _, out, _ = run(bus, "node", "list", "--json")
        assert json.loads(out[0]) == ["/robot7/sim", "/sim"]

    def test_no_node_is_an_empty_list(self, bus: Bus) -> None:
        """Without nodes nothing is printed, with exit code 0."""
        assert run(bus, "node", "list") == (0, [], [])
        assert run(bus, "param", "list") == (0, [], [])

    @pytest.mark.parametrize("kind", ["node", "topic", "service", "param"])
    def test_an_empty_list_is_explained_to_a_person_only(self, bus: Bus, kind: str) -> None:
        """At a terminal one line says that there is nothing, and what to look at."""
        what = "node" if kind == "param" else kind
        shown = re.sub(r"\x1b\[\d*m", "", bus.run_in_terminal(kind, "list"))
        assert shown.startswith(f"No {what}: ") and shown.count("\n") == 1
        assert run(bus, kind, "list") == (0, [], [])

    def test_an_empty_list_names_the_namespace(self, bus: Bus) -> None:
        """The node that is there is in none."""
        serve(bus)
        shown = bus.run_in_terminal("node", "list", "--namespace", "robot8")
        assert "No node in namespace 'robot8': " in shown

    def test_node_info(self, bus: Bus) -> None:
        """A node is shown with its process, what it says and serves, and its parameters."""
        serve(bus)
        code, out, err = run(bus, "node", "info", "/sim")
        assert (code, out[0], err) == (0, "/sim", [])
        text = "\n".join(out)
        for part in ("Pid: ", "Version: 0.1.0", "names: Spawn.Response", "spawn: Spawn"):
            assert part in text
        assert out[-4:] == [
            "  Parameters:",
            "    background_r: 69",
            "    holonomic: false",
            "    title: Turtles",
        ]
        code, out, [error] = run(bus, "node", "info", "simm")
        assert (code, out) == (1, []) and "'simm'" in error and "mean '/sim'" in error

    def test_param(self, bus: Bus) -> None:
        """Parameters are listed, read and set; an invalid value is refused in a sentence."""
        serve(bus)
        assert run(bus, "param", "list", "sim") == (
            0,
            ["/sim:", "  background_r", "  holonomic", "  title"],
            [],
        )
        assert run(bus, "param", "get", "sim", "background_r") == (0, ["Integer value is: 69"], [])
        assert run(bus, "param", "get", "/sim", "title") == (0, ["Text value is: Turtles"], [])
        assert run(bus, "param", "set", "sim", "holonomic", "true") == (
            0,
            ["Set parameter successful"],
            [],
        )
        assert run(bus, "param", "get", "sim", "holonomic") == (0, ["Boolean value is: true"], [])
        for arguments, sentence in (
            (("set", "sim", "background_r", "300"), "'background_r' must be at most 255, not 300"),
            (("set", "sim", "background_r", "red"), "'background_r' must be an integer, not 'red'"),
            (
                ("get", "sim", "speed"),
                "sim has no parameter 'speed'; available: background_r, holonomic, title",
            ),
            (("get", "sin", "x"), "there is no node 'sin'; did you mean '/sim'?"),
        ):
            assert run(bus, "param", *arguments) == (1, [], [f"Error: {sentence}"])

    def test_call(self, bus: Bus) -> None:
        """A service answers with a line of JSON; a goal with its feedback and its result."""
        serve(bus)
        assert run(bus, "call", "spawn", "{x: 2, y: 3, theta: 0, name: turtle2}") == (
            0,
            ['{"name": "turtle2"}'],
            [],
        )
        code, out, _ = run(bus, "call", "rotate", "{theta: 1.5}")
        assert (code, [json.loads(line) for line in out][1:]) == (
            0,
            [
                {"feedback": {"remaining": 0.5}},
                {"status": "succeeded", "result": {"delta": -1.5}},
            ],
        )
        bus.node("pens").create_service(
            SetPen, "set_pen", lambda pen: {True: SetPen.Response()}[pen.off]
        )
        assert run(bus, "call", "set_pen", "{r: 1, g: 2, b: 3, width: 3, off: 1}") == (
            0,
            ["{}"],
            [],
        )
        code, out, err = run(bus, "call", "spawn", "{x: 2, z: 3}")
        assert (code, out) == (2, [])
        assert err[-1].startswith("Error: ") and "no field 'z'" in err[-1]
        assert err[-1].endswith(": name, theta, x, y")
        bus.node("mover").create_service(
            TeleportRelative, "move", lambda by: {0.0: TeleportRelative.Response()}[by.angular]
        )
        assert run(bus, "service", "call", "move", "{linear: 1}") == (0, ["{}"], [])
        code, _, err = run(bus, "call", "spwan")
        assert (code, len(err)) == (1, 1)
        assert err[0].startswith("Error: no service 'spwan'; ")

    @pytest.mark.parametrize(
        ("request_text", "mistake"),
        [
            ("x", "'spawn' is of type Spawn, not x"),
            ("[1]", "Invalid value for REQUEST: "),
            ("{", "Invalid value for REQUEST: "),
            ("{[1]: 2}", "Invalid value for REQUEST: "),
            (
                "{x: !!timestamp 2022-12-07}",
                "not a valid Spawn.Request: field 'x' must be a number",
            ),
            ("{name: 99999999999999999999}", "not a valid Spawn.Request: field 'name' must be"),
        ],
    )
    def test_a_request_that_cannot_be_is_a_usage_error(
        self, bus: Bus, request_text: str, mistake: str
    ) -> None:
        """A request must be a map of the fields of its type, checked before it is sent."""
        bus.node("sim").create_service(Spawn, "spawn", lambda request: Spawn.Response("a"))
        code, out, err = run(bus, "call", "spawn", request_text)
        assert (code, out) == (2, [])
        assert err[-1].startswith(f"Error: {mistake}")

    @pytest.mark.parametrize("timeout", ["0", "-1", "nan", "soon"])
    def test_a_timeout_that_cannot_be_is_a_usage_error(self, bus: Bus, timeout: str) -> None:
        """A timeout is more than nothing."""
        assert run(bus, "call", "spawn", "{}", "--timeout", timeout)[0] == 2

    def test_a_router_routes_until_it_is_stopped(self, bus: Bus) -> None:
        """The router logs where it listens, and exits with 0."""
        router = bus.start("router", "--listen", "tcp/127.0.0.1:0")
        router.wait_for_line(r"\[router\]: Routing on tcp/127.0.0.1:0")
        assert router.stop() == 0
        assert router.out == []

    @pytest.mark.real
    def test_a_router_that_cannot_listen_says_so(self, bus: Bus) -> None:
        """A place that is taken, or not ours, is one sentence and exit code 1."""
        code, out, err = run(bus, "router", "--listen", "tcp/192.0.2.1:7447")
        assert (code, out, len(err)) == (1, [], 1)
        assert err[0].startswith("Error: ") and "192.0.2.1:7447" in err[0]


class TestOthers:
    """Processes that are not ours, and nodes that are not alone."""

    @staticmethod
    def serve_evil(bus: Bus) -> Declaration:
        """A process that answers as no node of tfbus does."""
        session = bus.node("looker").session
        for key, report in (
            ("@tfbus/node/evil", {"name": 5}),
            ("@tfbus/param/evil/x", {"value": 3}),
        ):

            def answer(query: Query, key: str = key, report: dict[str, int] = report) -> None:
                query.answer(key, encode_map(report))
                query.close()

            session.queryable(key, answer)
        return session.token("@tfbus/node/evil")

    def test_an_unreadable_node_is_skipped_with_a_warning(self, bus: Bus) -> None:
        """A node with an unreadable description does not hide the others."""
        serve(bus)
        token = self.serve_evil(bus)
        report = "the description of node '/evil' .* 'name' .*integer"
        code, out, [warning] = run(bus, "node", "list")
        assert (code, out) == (0, ["/evil", "/looker", "/robot7/sim", "/sim"])
        assert re.fullmatch(f"Warning: {report}", warning)
        code, out, err = run(bus, "param", "list")
        assert (code, out[-4:]) == (0, ["/sim:", "  background_r", "  holonomic", "  title"])
        assert len(err) == 1
        assert err[0].startswith("Warning: the parameters of node '/evil'")
        code, _, [error] = run(bus, "node", "info", "evil")
        assert code == 1 and re.fullmatch(f"Error: {report}", error)
        assert run(bus, "param", "get", "evil", "x")[0] == 1
        code, _, err = run(bus, "call", "spwan")
        assert (code, len(err)) == (1, 2)
        assert "no service 'spwan'" in err[1] and "mean 'spawn'" in err[1]
        token.close()

    def test_two_nodes_of_one_name_are_a_warning(self, bus: Bus) -> None:
        """A list shows a name once, with a warning if several nodes have it."""
        for _ in range(2):
            bus.node("twin")
        code, out, [warning] = run(bus, "node", "list")
        assert (code, out) == (0, ["/twin"])
        assert warning.startswith("Warning: 2 nodes ") and warning.endswith(" /twin")

    def test_parameters_are_listed_under_the_full_name(self, bus: Bus) -> None:
        """From within a namespace too a node is shown by its full name."""
        serve(bus)
        for name in ("sim", "/robot7/sim"):
            assert run(bus, "param", "list", "--namespace", "robot7", name) == (
                0,
                ["/robot7/sim:", "  rate"],
                [],
            )


class TestGoals:
    @staticmethod
    def serve_goal(bus: Bus, *, feedback: bool) -> list[str]:
        """A goal `rotate` that never ends by itself; how it was ended."""
        ended: list[str] = []
        node = bus.node("sim")

        def execute(handle: GoalHandle) -> None:
            handle.on_cancel(lambda: (ended.append("cancel"), handle.cancel(_RESULT)))
            if feedback:
                node.create_timer(0.1, lambda: handle.feedback(RotateAbsolute.Feedback(0.5)))

        node.create_goal_server(RotateAbsolute, "rotate", execute)
        return ended

    def test_ctrl_c_cancels_the_action(self, bus: Bus) -> None:
        """A goal lives through any number of timeouts while feedback comes, and ends by Ctrl-C."""
        ended = self.serve_goal(bus, feedback=True)
        call = bus.start("call", "rotate", "{theta: 1.5}", "--timeout", "0.7")
        eventually(lambda: len(call.out) > 12)
        assert ended == []
        assert call.stop() == 130
        assert ended == ["cancel"]
        assert call.err == []

    def test_a_silent_action_is_cancelled(self, bus: Bus) -> None:
        """An action that is silent for the timeout is an error."""
        ended = self.serve_goal(bus, feedback=False)
        code, out, [error] = run(bus, "call", "rotate", "{theta: 1.5}", "--timeout", "0.5")
        assert (code, len(out)) == (1, 1) and "'rotate'" in error and "0.5 s" in error
        assert ended == ["cancel"]


class TestCommands:
    @pytest.mark.real
    def test_help_is_light(self) -> None:
        """`tfbus --help` loads neither Zenoh nor numpy, nor any node."""
        script = (
            "import sys; sys.argv = ['tfbus', '--help']\n"
            "from tfbus.cli import main\n"
            "try: main()\n"
            "except SystemExit as end: assert not end.code\n"
            "print(*sorted({'zenoh', 'numpy', 'msgpack', 'yaml'} & set(sys.modules)), 'end')"
        )
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        )
        assert done.stdout.splitlines()[-1].strip() == "end"
        for name in (*TOOLS, *NODES):
            assert f"  {name} " in done.stdout

    @pytest.mark.real
    def test_a_tool_is_there_without_numpy(self) -> None:
        """No tool imports numpy before it needs it: that takes longer than all else of a start."""
        script = (
            "import sys\n"
            "from importlib import import_module\n"
            f"for name in {[*TOOLS]}: import_module('tfbus.cli.' + name)\n"
            "assert 'numpy' not in sys.modules"
        )
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")

    @pytest.mark.parametrize("name", [*TOOLS, *NODES])
    def test_the_list_says_what_each_command_says_of_itself(self, name: str) -> None:
        """The line of a command in `tfbus --help` is the first line of its own help."""
        context = main.make_context("tfbus", [name, "--help"], resilient_parsing=True)
        command = main.get_command(context, name)  # a group
        text = (command.help or command.callback.__doc__).strip().split("\n\n")[0]
        assert " ".join(text.split()) == {**TOOLS, **NODES}[name]

    @pytest.mark.parametrize("name", [*TOOLS, *NODES])
    def test_the_help_of_each_command_has_an_example(self, name: str) -> None:
        """Every command, and every one of a group, shows an example, within 80 columns."""
        context = main.make_context("tfbus", [name, "--help"], resilient_parsing=True)
        command = main.get_command(context, name)  # a group
        commands = command.commands.values() if isinstance(command, click.Group) else [command]
        for each in commands:
            help_ = each.get_help(click.Context(each, context, terminal_width=80))
            assert "\n  Example" in help_
            # An option's value has a name, not a type of click's.
            assert not re.search(r"^  -.* (INTEGER|FLOAT|TEXT|RANGE)\b", help_, re.MULTILINE)
            assert max(map(len, help_.splitlines())) <= 80

    @pytest.mark.parametrize("name", ["keys", "node", "param", "service", "topic"])
    def test_a_group_lists_its_commands_by_whole_sentences(self, name: str) -> None:
        """Two lines are enough for the longest, so none is cut."""
        listed = CliRunner().invoke(main, [name, "--help"]).output.partition("\nCommands:\n")[2]
        assert listed and "..." not in listed

    def test_the_list_has_each_command_under_one_job(self) -> None:
        """The commands to begin with are first, and turtles are apart."""
        listed = [name for names in JOBS.values() for name in names]
        assert sorted(listed) == sorted([*TOOLS, *NODES])
        text = CliRunner().invoke(main, ["--help"]).output
        places = [text.index(f"\n  {name} ") for name in listed]
        assert places == sorted(places)

    def test_options_that_all_share_are_shown_when_asked_for(self) -> None:
        """Beside options of its own a command names some; `--help-all` shows them. A command that
        has no others shows them at once.
        """
        short = CliRunner().invoke(main, ["echo", "--help"]).output
        whole = CliRunner().invoke(main, ["echo", "--help-all"]).output
        for option in ("--params-file FILE", "--mode [peer|client|router]", "--ros-args"):
            assert option not in short
            assert option in whole
        assert "--help-all" in short and "--help-all" not in whole
        assert "--precision" in short and "--precision" in whole
        assert "--listen ENDPOINT" in CliRunner().invoke(main, ["follow", "--help"]).output

    def test_an_unknown_command_gets_a_near_name(self, bus: Bus) -> None:
        """A misspelt command is a usage error with a near name."""
        code, out, err = run(bus, "nod", "list")
        assert (code, out) == (2, [])
        assert "no command 'nod'" in err[-1] and "mean 'node'" in err[-1]

    @pytest.mark.parametrize(
        ("command", "hint"),
        [
            (["tf2_echo", "a", "b"], "'tf2_echo'; use: tfbus echo"),
            (["run", "turtlesim"], "'run'; a node is a command itself, as in: tfbus simulator"),
            (["run", "tf2_ros", "tf2_echo", "a", "b"], "'run'; use: tfbus echo"),
            (["run", "turtlesim", "draw_square"], "'run'; use: tfbus draw_square"),
            (["run", "my_package", "my_node"], "'run'; a node is a command itself"),
            (["joint_state_publisher_gui"], "'joint_state_publisher_gui'; use: tfbus joints"),
            (["topic", "lst"], "'lst'; did you mean 'list'?"),
            (["param", "delete", "sim"], "'delete'; a node keeps its parameters while it runs"),
        ],
    )
    def test_commands_of_ros_get_a_hint(self, bus: Bus, command: list[str], hint: str) -> None:
        """A command of ROS 2 is a usage error that names the one of tfbus."""
        code, out, err = run(bus, *command)
        assert (code, out) == (2, [])
        assert f"there is no command {hint}" in err[-1]

    @pytest.mark.parametrize(
        "arguments", [["node"], ["node", "info"], ["param", "get"], ["call"], ["node", "lst"]]
    )
    def test_a_mistake_ends_with_2(self, bus: Bus, arguments: list[str]) -> None:
        """A command line that is not complete or not right ends with 2, and no traceback."""
        assert run(bus, *arguments)[0] == 2

    @pytest.mark.parametrize("command", [["node", "list"], ["param", "list"], ["router"]])
    def test_settings_that_no_bus_can_be_joined_with_end_with_2(
        self, tmp_path: Path, command: list[str]
    ) -> None:
        """An invalid configuration is an error with its place, and exit code 2."""
        config = tmp_path / "zenoh.json5"
        config.write_text("{mode: }")
        done = CliRunner().invoke(main, [*command, "--config", str(config)])
        assert (done.exit_code, done.stdout) == (2, "")
        assert done.stderr.startswith(f"Error: {config} ") and "JSON5: 1:8, " in done.stderr
        assert done.stderr.count("\n") == 1

    @pytest.mark.real
    def test_version(self) -> None:
        """`tfbus --version` prints the version, and of a clone the commit."""
        done = CliRunner().invoke(main, ["--version"])
        version = done.stdout.splitlines()[0]
        assert (done.exit_code, version, done.stderr) == (0, f"tfbus {version_and_origin()}", "")
        assert version.startswith(f"tfbus {tfbus.__version__}")


class TestEnding:
    def start(self, bus: Bus, *arguments: str) -> Program:
        """A node of a user's own as a process."""
        return bus.start_main(a_node, *arguments)

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_a_signal_ends_a_node_well(self, bus: Bus, number: int) -> None:
        """Ctrl-C and SIGTERM end a node with 0, and nothing else is printed."""
        process = self.start(bus)
        process.wait_for_line(r"\[INFO\] \[\d+\.\d{9}\] \[mine\]: ready")
        assert process.stop(number) == 0
        assert (process.out, len(process.err)) == ([], 1)

    def test_a_second_signal_while_it_ends_changes_nothing(self, bus: Bus) -> None:
        """An impatient user's Ctrl-C Ctrl-C is still a clean end."""
        process = self.start(bus)
        process.wait_for_line("ready")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
            process.signal(number)
        assert process.wait() in (0, -signal.SIGTERM, -signal.SIGINT)
        assert "Traceback" not in "\n".join(process.err)

    @pytest.mark.parametrize(
        ("arguments", "code", "sentence"),
        [
            (["--nonsense"], 2, "Error: No such option"),
            (["--listen", "tcp/192.0.2.1:7447"], 1, "Error: could not join the bus"),
            (["--param", "speed"], 2, "is not of the form --param name=value"),
        ],
    )
    def test_a_mistake_has_no_traceback(
        self, bus: Bus, arguments: list[str], code: int, sentence: str
    ) -> None:
        """A user's node prints mistakes on its command line as the supplied ones do."""
        process = self.start(bus, *arguments)
        assert process.wait() == code
        assert sentence in "\n".join(process.err)
        assert "Traceback" not in "\n".join(process.err)


@pytest.mark.parametrize(
    "line",
    [
        "frames -t 1",
        "why world robot",
        "monitor --once",
        "plot world robot -o robot.png",
        "doctor",
        "node list",
        "echo world robot --timeout 0.1",
    ],
)
def test_an_unreachable_router_is_an_error_at_once(bus: Bus, line: str) -> None:
    """A tool that answers once fails, with a reason, if its router cannot be reached."""
    done = bus.run(*line.split(), env={"TFBUS_MODE": "client", "TFBUS_CONNECT": NOWHERE})
    assert done.returncode == 1
    assert f"no router answers at {NOWHERE}" in done.stderr


@pytest.mark.parametrize("line", ["frames --watch", "monitor", "echo world robot"])
def test_what_goes_on_says_that_it_waits_for_a_router(bus: Bus, line: str) -> None:
    """A tool that goes on until Ctrl-C waits for its router, and says so."""
    env = {"TFBUS_MODE": "client", "TFBUS_CONNECT": NOWHERE}
    bus.start(*line.split(), env=env).wait_for_line(f"Waiting for a router at {NOWHERE}")


@pytest.mark.parametrize(
    ("arguments", "needs", "written"),
    [
        ("keys init {folder}/keys", "cryptography", "keys/rights.yaml"),
        ("plot --from {folder}/in.csv --show position -o {folder}/a.svg", "matplotlib", "a.svg"),
    ],
)
def test_a_reader_that_is_gone_is_no_fault_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str, needs: str, written: str
) -> None:
    """A tool that nobody reads any more has written its file, and does not say that it cannot."""
    pytest.importorskip(needs)
    pose = ",world,turtle1,0,0,0,0,0,0,1,0,0,0"
    header = "stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw,roll,pitch,yaw"
    (tmp_path / "in.csv").write_text(f"{header}\n1{pose}\n2{pose}\n")

    def gone(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(click, "echo", gone)
    with pytest.raises(BrokenPipeError):
        main(arguments.format(folder=tmp_path).split(), standalone_mode=False)
    assert (tmp_path / written).is_file()
