"""The command-line options of every process, as one frozen value of settings."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from tfbus.bus.settings import MODES, NodeSettings
from tfbus.command.option_kinds import NodeOption, RosArgs, help_all_option
from tfbus.command.types import LogLevel, Number, RosterNames
from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import SettingsError, TfbusError
from tfbus.runtime.signals import forget_interrupt
from tfbus.wording import natural_order, printable

F = TypeVar("F", bound=Callable[..., Any])


def bus_options(name: str) -> Callable[[F], F]:
    """Add the options by which a process joins the bus to a click command.

    The command's first argument is then their value, NodeSettings of this name. A TfbusError that
    it raises is printed as one sentence, with exit code 1; 2 for wrong settings.
    """
    return _with_options(name, _BUS_OPTIONS)


def listening_options(
    name: str | Callable[[], str], *, always_fleet: bool = False
) -> Callable[[F], F]:
    """`bus_options`, `--sim-time` and `fleet_options`, for a command that listens to transforms;
    with `always_fleet` to those of a fleet, without `--fleet`.
    """
    options = {"sim_time": _NODE_OPTIONS["sim_time"], **_BUS_OPTIONS}
    return lambda function: _with_fleet(_with_options(name, options)(function), always_fleet)


def fleet_options(function: F) -> F:
    """Add `--fleet` and `--shared` to a click command.

    Its argument `fleet` is then their value, a Fleet or None, for a TransformListener.
    """
    return _with_fleet(function)


def _with_fleet(function: F, always_fleet: bool = False) -> F:

    @functools.wraps(function)
    def command(
        *args: Any, shared_frames: tuple[str, ...], fleet: bool = always_fleet, **values: Any
    ) -> Any:
        from tfbus.wire.fleet import Fleet  # with its reader, which `--help` does not need

        if shared_frames and not fleet:
            raise click.UsageError("--shared needs --fleet")
        try:
            seen = Fleet(shared_frames) if fleet else None
        except TfbusError as error:
            raise click.UsageError(f"--shared: {error}") from error
        return function(*args, fleet=seen, **values)

    decorated: Any = command
    for option in reversed(_FLEET_OPTIONS[1:] if always_fleet else _FLEET_OPTIONS):
        decorated = option(decorated)
    return cast(F, decorated)


def roster_option(function: F) -> F:
    """Add `--expect` to a click command; its argument `roster` has the names of robots, sorted."""

    @functools.wraps(function)
    def command(*args: Any, expected: tuple[tuple[str, ...], ...], **values: Any) -> Any:
        names = {name for each in expected for name in each}
        return function(*args, roster=tuple(sorted(names, key=natural_order)), **values)

    option = click.option(
        "--expect",
        "expected",
        type=RosterNames(),
        multiple=True,
        metavar="ROBOTS",
        help="The roster: names such as 'robot[1-30]', or a file with one a line; repeatable.",
    )
    return cast(F, option(command))


def max_gap_option(function: F) -> F:
    """Add `--max-gap` to a click command. Its argument `sampling` is then a Sampling with it."""

    @functools.wraps(function)
    def command(*args: Any, max_gap_s: float | None, **values: Any) -> Any:
        sampling = TF2 if max_gap_s is None else Sampling(max_gap_s=max_gap_s)
        return function(*args, sampling=sampling, **values)

    return cast(
        F,
        click.option(
            "--max-gap",
            "max_gap_s",
            type=Number(least=0.0, most=1e6),
            metavar="SECONDS",
            help="Do not interpolate between samples farther apart than this.",
        )(command),
    )


def node_options(default_name: str | Callable[[], str]) -> Callable[[F], F]:
    """Add the options of a node to a click command: `bus_options`, name, parameters, remappings.

    `default_name` is the node's name without `--name`, or returns one for each run. Ctrl-C and
    SIGTERM are a node's usual end, also while it joins the bus: exit code 0.
    """

    def decorate(function: F) -> F:
        options = {**_NODE_OPTIONS, **_BUS_OPTIONS}
        return _ROS_ARGS(_with_options(default_name, options)(_interruptible(function)))

    return decorate


def _interruptible(function: F) -> F:
    @functools.wraps(function)
    def command(*args: Any, **values: Any) -> Any:
        try:
            return function(*args, **values)
        except KeyboardInterrupt:
            forget_interrupt()
            raise SystemExit(0) from None

    return cast(F, command)


def _with_options(
    default_name: str | Callable[[], str], options: Mapping[str, Callable[[Any], Any]]
) -> Callable[[F], F]:
    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(*args: Any, **values: Any) -> Any:
            given = {name: values.pop(name) for name in options}
            try:
                name = default_name() if callable(default_name) else default_name
                settings = _settings(name, given)
            except TfbusError as error:
                raise click.UsageError(str(error)) from error
            try:
                return function(settings, *args, **values)
            except TfbusError as error:
                raise click.ClickException(str(error)) from error

        decorated: Any = help_all_option(command)
        for option in reversed([*options.values()]):
            decorated = option(decorated)
        return cast(F, decorated)

    return decorate


def settings_from_args(default_name: str, argv: Sequence[str] | None = None) -> NodeSettings:
    """The settings from a command line that has only the options of a node.

    A mistake in it is printed to stderr and exits with 2; `--help` prints the options and exits.
    """

    @click.command(help=f"The node {default_name}.")
    @node_options(default_name)
    def command(settings: NodeSettings) -> NodeSettings:
        return settings

    with _click_exits():
        settings = command.main(None if argv is None else list(argv), standalone_mode=False)
    if not isinstance(settings, NodeSettings):
        raise SystemExit(0)  # --help was printed
    return settings


class _click_exits:
    """Exits as click's own main does, for a command that returns a value."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, click.ClickException):
            error.show()
            raise SystemExit(error.exit_code)


def _settings(default_name: str, given: dict[str, Any]) -> NodeSettings:
    values = {name: value for name, value in given.items() if value not in (None, ())}
    files = values.pop("parameter_files", ())
    remappings = _pairs(given.get("remappings", ()), ":=", "--remap from:=to")
    # ROS's remappings of the node itself.
    for rule, name in (("__node", "name"), ("__name", "name"), ("__ns", "namespace")):
        if rule in remappings:
            values.setdefault(name, remappings.pop(rule))
    values["remappings"] = remappings
    parameters = _pairs(given.get("parameters", ()), "=", "--param name=value")
    # With ROS's sign in --param name:=value.
    values["parameters"] = {name.removesuffix(":"): text for name, text in parameters.items()}
    settings = NodeSettings(**({"name": default_name} | values))
    if "name" not in values:
        settings = settings.named_by_default(default_name)
    return _with_sim_time(_with_parameter_files(settings, files), given.get("sim_time"))


def _pairs(texts: Iterable[str], separator: str, form: str) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, found, value = text.partition(separator)
        if not found or not name.rstrip(":"):
            raise SettingsError(f"'{printable(text, 60)}' is not of the form {form}")
        pairs[name] = value
    return pairs


def _with_parameter_files(settings: NodeSettings, files: Iterable[str]) -> NodeSettings:
    """The settings with the parameters of the files, if none is given on the command line."""
    values: dict[str, Any] = {}
    for file in files:
        from tfbus.command.parameters import parameters_from_file  # YAML

        values |= parameters_from_file(Path(file), settings.full_name)
    return replace(settings, parameters=values | dict(settings.parameters)) if values else settings


def _with_sim_time(settings: NodeSettings, is_given: bool | None) -> NodeSettings:
    """The settings with `sim_time` for ROS's parameter `use_sim_time`."""
    parameters = dict(settings.parameters)
    value = parameters.pop(_USE_SIM_TIME, None)
    if value is None:
        return settings
    truth = str(value).lower()
    if truth not in ("true", "false"):
        raise SettingsError(f"{_USE_SIM_TIME} must be true or false, not {value!r}")
    sim_time = truth == "true" if is_given is None else is_given
    return replace(settings, parameters=parameters, sim_time=sim_time)


_USE_SIM_TIME = "use_sim_time"

_option = partial(click.option, cls=NodeOption)
_ROS_ARGS = click.option(
    "--ros-args",
    cls=RosArgs,
    is_flag=True,
    expose_value=False,
    help="Arguments of ROS 2 follow, up to --: -p name:=value, -r from:=to, -r __ns:=/robot7.",
)
_BUS_OPTIONS = {
    "namespace": _option(
        "--namespace", metavar="PATH", help="Prefix of all names on the bus, such as robot7."
    ),
    "mode": _option("--mode", type=click.Choice(MODES), help="How to join the bus (default peer)."),
    "connect": _option(
        "--connect",
        multiple=True,
        metavar="ENDPOINT",
        help="Connect to an endpoint, such as tcp/host:7447; repeatable.",
    ),
    "listen": _option(
        "--listen",
        multiple=True,
        metavar="ENDPOINT",
        help="Listen on an endpoint, such as tcp/[::]:7447; repeatable.",
    ),
    "config": _option(
        "--config", type=click.Path(), metavar="FILE", help="Zenoh's configuration, in JSON5."
    ),
    "secure": _option(
        "--secure",
        type=click.Path(),
        metavar="DIR",
        help="Join a closed bus by the identity in DIR (tfbus keys).",
    ),
    "log_level": _option(
        "--log-level", type=LogLevel(), help="The lowest level to log (default info)."
    ),
}
_FLEET_OPTIONS = (
    click.option(
        "--fleet",
        is_flag=True,
        help="Include robots in namespaces below; frames are named like robot7/base_link.",
    ),
    click.option(
        "--shared",
        "shared_frames",
        multiple=True,
        metavar="FRAME",
        help="With --fleet, a frame that all robots share, such as map; repeatable.",
    ),
)
_NODE_OPTIONS = {
    "name": _option("--name", metavar="NAME", help="The node's name."),
    "sim_time": _option(
        "--sim-time/--system-time",
        default=None,
        help="Take the time from the topic clock, or from the system (default).",
    ),
    "parameters": _option(
        "--param",
        "parameters",
        multiple=True,
        metavar="NAME=VALUE",
        help="Set a parameter of the node; repeatable. -p as in ROS.",
    ),
    "parameter_files": _option(
        "--params-file",
        "parameter_files",
        multiple=True,
        type=click.Path(exists=True, dir_okay=False),
        metavar="FILE",
        help="Set parameters from a YAML file, as of ROS 2; repeatable.",
    ),
    "remappings": _option(
        "--remap",
        "remappings",
        multiple=True,
        metavar="FROM:=TO",
        help="Use another topic or service name; repeatable. -r as in ROS.",
    ),
}
