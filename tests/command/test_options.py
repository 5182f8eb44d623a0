"""The command-line options of every process."""

from collections.abc import Sequence

import click
import pytest
from click.testing import CliRunner, Result

from tfbus import BusError, NodeSettings, node_options
from tfbus.command.options import bus_options, settings_from_args

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
        *("--log-level", "debug", "--sim-time", "--param", "rate=2", "--param", "a b=c=d"),
        *("--remap", "pose:=turtle2/pose"),
    ) == NodeSettings(
        "echo2",
        namespace="robot7",
        mode="client",
        connect=("tcp/a:1", "tcp/b:2"),
        listen=("tcp/[::]:0",),
        log_level="debug",
        sim_time=True,
        parameters={"rate": "2", "a b": "c=d"},
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
    assert (result.exit_code, result.stdout, result.stderr) == (1, "", "Error: the bus is away\n")


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
