"""The command-line options of every process."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from tfbus import BusError, NodeSettings, node_options
from tfbus.command.options import bus_options, in_tfbus_words, settings_from_args

seen: list[NodeSettings] = []


@click.command()
@click.argument("frame", default="world")
@node_options("echo")
def command(settings: NodeSettings, frame: str) -> None:
    """Test."""
    seen.append(settings)
    if frame == "trouble":
        raise BusError("the bus is away")
    if frame == "interrupt":
        raise KeyboardInterrupt
    click.echo(frame)


def run(*arguments: str, env: dict[str, str] | None = None) -> Result:
    """The command, run with these arguments."""
    seen.clear()
    return CliRunner().invoke(command, arguments, env=env)


def settings_of(*arguments: str, env: dict[str, str] | None = None) -> NodeSettings:
    """The settings that the arguments give."""
    result = run(*arguments, env=env)
    assert result.exit_code == 0, result.output
    return seen[0]


def test_without_options_a_node_has_its_default_name() -> None:
    """A node that is started without options has the name of its command."""
    assert settings_of() == NodeSettings("echo")


def test_each_option_becomes_a_setting() -> None:
    """Every option of a node is in its settings; repeatable ones in order."""
    assert settings_of(
        *("--name", "echo2", "--namespace", "/robot7", "--mode", "client"),
        *("--connect", "tcp/a:1", "--connect", "tcp/b:2", "--listen", "tcp/[::]:0"),
        *("--log-level", "debug", "--sim-time", "--param", "rate=2", "--param", "a_b=c=d"),
        *("--remap", "pose:=turtle2/pose"),
    ) == NodeSettings(
        "echo2",
        namespace="robot7",
        mode="client",
        connect=("tcp/a:1", "tcp/b:2"),
        listen=("tcp/[::]:0",),
        log_level="debug",
        sim_time=True,
        parameters={"rate": "2", "a_b": "c=d"},
        remappings={"pose": "turtle2/pose"},
    )


def test_options_go_before_the_environment() -> None:
    """An option wins over the environment, which wins over the default."""
    env = {"TFBUS_NAMESPACE": "robot7", "TFBUS_LOG_LEVEL": "error", "TFBUS_SIM_TIME": "1"}
    settings = settings_of("--namespace", "robot8", "--system-time", env=env)
    assert (settings.namespace, settings.log_level) == ("robot8", "error")
    assert not settings.sim_time
    assert settings_of(env=env).sim_time


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--param", "rate"], "'rate' is not of the form --param name=value"),
        (["--param", "=2"], "'=2' is not of the form --param name=value"),
        (["--param", ":=2"], "':=2' is not of the form --param name=value"),
        (["-p"], "option '-p' needs a value, as in -p name:=value"),
        (["rate:=2"], "write --param rate=2 to set a parameter, or --remap rate:=2"),
        (["_rate:=2"], "write --param rate=2\n"),
        (["--ros-args", "--enclave", "/x"], "'--enclave' is not known after --ros-args; known: -p"),
        (["--ros-args", "-r"], "option '-r' needs a value, as in -r name:=value"),
        (["-p", "use_sim_time:=maybe"], "use_sim_time must be true or false, not 'maybe'"),
        (["--remap", "a=b"], "'a=b' is not of the form --remap from:=to"),
        (["--connect", "hub"], "'hub' is not an endpoint: write protocol/address, as in tcp/hub"),
        (["--config", "/no/such"], "there is no configuration file '/no/such'"),
        (["--name", "a/b"], "'a/b' cannot be a node's name"),
        (["--mode", "boss"], "'boss' is not one of 'peer', 'client', 'router'"),
        (["--nonsense"], "No such option"),
    ],
)
def test_a_mistake_exits_with_2(arguments: Sequence[str], sentence: str) -> None:
    """A mistake on the command line is one sentence on stderr, and exit code 2."""
    result = run(*arguments)
    assert result.exit_code == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.output


def test_an_error_exits_with_1() -> None:
    """A failure while it runs is one sentence on stderr, and exit code 1."""
    result = run("trouble")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.startswith("Error: ") and result.stderr.endswith("bus is away\n")


def test_a_node_that_is_interrupted_has_ended_well() -> None:
    """Ctrl-C is a node's usual end at any time."""
    assert (run("interrupt").exit_code, run("interrupt").output) == (0, "")


def test_the_arguments_of_the_command_come_through() -> None:
    """A command keeps its own arguments beside the options of a node."""
    assert run("turtle1", "--name", "x").stdout == "turtle1\n"


def test_a_tool_takes_no_name_and_no_parameters() -> None:
    """A tool that only looks at the bus has the options of the bus and no others."""

    @click.command()
    @bus_options("tool")
    def tool(settings: NodeSettings) -> None:
        """Test."""

    assert CliRunner().invoke(tool, ["--namespace", "a"]).exit_code == 0
    assert CliRunner().invoke(tool, ["--name", "a"]).exit_code == 2
    assert CliRunner().invoke(tool, ["--param", "a=b"]).exit_code == 2


def test_settings_from_a_list_of_arguments() -> None:
    """A node without arguments of its own takes its settings from the command line directly."""
    settings = settings_from_args("mine", ["--name", "yours", "--param", "speed=1"])
    assert settings == NodeSettings("yours", parameters={"speed": "1"})


def test_a_mistake_in_a_list_of_arguments_ends_the_process(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A mistake there ends the process as in any command."""
    with pytest.raises(SystemExit) as caught:
        settings_from_args("mine", ["extra"])
    assert caught.value.code == 2
    assert "unexpected extra argument (extra)" in capsys.readouterr().err


def test_help_ends_the_process_well(capsys: pytest.CaptureFixture[str]) -> None:
    """`--help` prints every option and ends with 0."""
    with pytest.raises(SystemExit) as caught:
        settings_from_args("mine", ["--help"])
    assert caught.value.code == 0
    printed = capsys.readouterr().out
    for option in ("name", "namespace", "mode", "connect", "listen", "config", "param", "remap"):
        assert f"--{option}" in printed


@pytest.mark.parametrize(
    "arguments",
    [
        ["--param", "rate=2"],
        ["--param", "rate:=2"],
        ["-p", "rate:=2"],
        ["-p", "rate=2"],
        ["--ros-args", "-p", "rate:=2"],
        ["--ros-args", "--param", "rate:=2", "--"],
        ["--ros-args", "--ros-args", "-p", "rate:=2", "--disable-stdout-logs"],
    ],
)
def test_a_parameter_is_set_as_in_ros_too(arguments: list[str]) -> None:
    """`:=` and `=` mean the same, after `--param` and after `-p`."""
    assert dict(settings_of(*arguments).parameters) == {"rate": "2"}


def test_all_of_ros_in_one_line() -> None:
    """A command line that was written for a node of ROS 2 starts one of tfbus."""
    settings = settings_of(
        *("--ros-args", "-p", "text:=a=b:=c", "-r", "__node:=x", "-r", "__ns:=/r"),
        *("-r", "/old:=~/new", "--log-level", "x:=WARN", "-p", "use_sim_time:=true", "--"),
        *("turtle1", "--connect", "tcp/a:1"),
    )
    assert settings == NodeSettings(
        "x",
        namespace="r",
        parameters={"text": "a=b:=c"},
        remappings={"/old": "~/new"},
        log_level="warning",
        sim_time=True,
        connect=("tcp/a:1",),
    )


def test_an_option_goes_before_a_remapping_of_the_node() -> None:
    """`--name` and `--system-time` are tfbus's own, and say it more clearly."""
    settings = settings_of(
        *("--name", "a", "-r", "__node:=b", "-p", "use_sim_time:=true", "--system-time")
    )
    assert (settings.name, settings.sim_time) == ("a", False)


def test_a_command_keeps_its_own_short_options() -> None:
    """Only a value with `:=` is ROS's."""

    @click.command()
    @click.option("-p", "--precision", type=int)
    @click.option("-r", "--rate", type=float)
    @node_options("echo")
    def echo(settings: NodeSettings, precision: int, rate: float) -> None:
        """Test."""
        click.echo(f"{precision} {rate} {dict(settings.parameters)}")

    done = CliRunner().invoke(echo, ["-p", "3", "-r", "2", "-p", "x:=1"])
    assert done.output == "3 2.0 {'x': '1'}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file of parameters, as ROS 2 writes it."""
    path = tmp_path / "params.yaml"
    path.write_text(
        "/**:\n  ros__parameters: {rate: 1.5, frame: map}\n"
        "echo:\n  ros__parameters:\n    rate: 2\n    arm: {speed: 3, on: true}\n"
        "robot7:\n  echo:\n    ros__parameters: {rate: 7}\n"
    )
    return path


def test_parameters_come_from_a_file_of_ros(file: Path) -> None:
    """The node's own section goes before that of all nodes, and the command line before both."""
    settings = settings_of("--params-file", str(file), "--param", "frame=odom")
    assert dict(settings.parameters) == {
        "rate": 2,
        "frame": "odom",
        "arm.speed": 3,
        "arm.on": True,
    }
    settings = settings_of("--ros-args", "--params-file", str(file), "-r", "__ns:=/robot7")
    assert dict(settings.parameters) == {"rate": 7, "frame": "map"}


@pytest.mark.parametrize(
    ("content", "parameters"),
    [
        ("{rate: 2}", {"rate": 2}),
        ("/echo: {rate: 2}\n/other: {rate: 3}", {"rate": 2}),
        ("/*: {ros__parameters: {rate: 2}}", {"rate": 2}),
        ("a: &a {ros__parameters: {rate: 2}}\necho: *a", {"rate": 2}),
    ],
)
def test_simpler_files_of_parameters_are_read_too(
    tmp_path: Path, content: str, parameters: dict[str, object]
) -> None:
    """A map of parameters, or of nodes, as `tfbus param dump` writes it."""
    path = tmp_path / "params.yaml"
    path.write_text(content)
    assert dict(settings_of("--params-file", str(path)).parameters) == parameters


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("other: {ros__parameters: {a: 1}}", "no parameters for /echo; it has some for /other"),
        ("[1]", "is not a map of parameters"),
        ("{", "params.yaml:1: is not YAML"),
        ("", "is empty; write a map of parameters"),
    ],
)
def test_a_mistake_in_a_file_of_parameters_is_one_sentence(
    tmp_path: Path, content: str, sentence: str
) -> None:
    """A file that has nothing for the node is most likely misspelt."""
    path = tmp_path / "params.yaml"
    path.write_text(content)
    result = run("--params-file", str(path))
    assert result.exit_code == 2
    assert sentence in result.stderr


@pytest.mark.parametrize(
    ("typed", "form"),
    [
        ("__ns:=/r", "--namespace r"),
        ("__node:=cam", "--name cam"),
        ("__name:=cam", "--name cam"),
        ("_rate:=2", "--param rate=2"),
        ("~rate:=2", "--param rate=2"),
        ("pose:=odom", "--param pose=odom to set a parameter, or --remap pose:=odom to use"),
    ],
)
def test_an_assignment_of_ros_is_answered_in_our_words(typed: str, form: str) -> None:
    """Without `--ros-args` each form of ROS is named by the option that does the same."""
    with pytest.raises(click.UsageError) as caught:
        list(in_tfbus_words([typed]))
    assert caught.value.message.startswith(f"'{typed}' needs its option: write {form}")


@pytest.mark.real
def test_an_interrupted_exec_is_a_usual_end_too(tmp_path: Path) -> None:
    """As where a dataclass is imported just then: Python would end a module by SIGINT."""
    (tmp_path / "interrupted.py").write_text(
        "import click\n"
        "from tfbus import node_options\n"
        "@click.command()\n"
        "@node_options('x')\n"
        "def main(settings):\n"
        "    exec('import signal; signal.raise_signal(signal.SIGINT)')\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
