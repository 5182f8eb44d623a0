"""The command-line options of every process, as one frozen value of settings; and kinds of options:
left out of a help, ROS's arguments, several values after one name.
"""

import functools
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.core import ParameterSource

from tfbus.base.errors import InvalidNameError, MissingFileError, SettingsError, TfbusError
from tfbus.base.signals import forget_interrupt
from tfbus.base.wording import natural_order, printable
from tfbus.bus.settings import MODES, NodeSettings, log_level_of
from tfbus.bus.settings import NAMES as NETWORK_NAMES
from tfbus.command.types import NOT_NEGATIVE, LogLevel, Number, RosterNames, own_name
from tfbus.geometry.sampling import TF2, Sampling
from tfbus.wire.descriptions import POSES

# In the context of a help that shows all.
SHOWS_ALL = "tfbus.help_all"


class NodeOption(click.Option):
    """An option that other commands have too."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help; None if it leaves it out."""
        return super().get_help_record(ctx) if _shows_all(ctx) else None


class HelpAll(click.Option):
    """The option `--help-all`, in the help of a command that leaves options out."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help; None if nothing is left out."""
        return None if _shows_all(ctx) else super().get_help_record(ctx)


def help_all_option(function: Any) -> Any:
    """Add `--help-all` to a click command."""

    def show(ctx: click.Context, _: click.Parameter, is_given: bool) -> None:
        if is_given and not ctx.resilient_parsing:
            ctx.meta[SHOWS_ALL] = True
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    option = click.option(
        "--help-all",
        cls=HelpAll,
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Show the options that all commands share, too: --namespace, --connect, --secure, "
        "--log-level and others.",
    )
    return option(function)


def _shows_all(ctx: click.Context) -> bool:
    """Whether all options are shown: if asked for, or if there are no others."""
    own = (
        param
        for param in ctx.command.params
        if isinstance(param, click.Option) and not isinstance(param, NodeOption | HelpAll)
    )
    return bool(ctx.meta.get(SHOWS_ALL)) or not any(own)


_BEGIN, _END = "--ros-args", "--"
_SHORT = {"-p": "--param", "-r": "--remap"}

# ROS's options, and how tfbus calls them; options that change nothing are left out.
_OPTIONS = {
    **_SHORT,
    "--param": "--param",
    "--remap": "--remap",
    "--params-file": "--params-file",
    "--log-level": "--log-level",
}
_FLAGS_WITHOUT_MEANING = re.compile(
    r"--(enable|disable)-(rosout-logs|stdout-logs|external-lib-logs)"
)
_ASSIGNMENT = re.compile(r"([A-Za-z_~/][\w./~:-]*?)(:?=)(.*)", re.DOTALL)


class RosArgs(NodeOption):
    """The option `--ros-args`: all that follows is as in ROS, up to `--` or the end."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Read the arguments of ROS in tfbus's words, before click reads any."""
        super().add_to_parser(parser, ctx)
        parse = parser.parse_args
        own = {name for param in ctx.command.params for name in param.opts}
        arguments = [each for each in ctx.command.params if isinstance(each, click.Argument)]
        # A command with arguments of this form says so in its help.
        takes_assignments = any(":=" in (each.metavar or "") for each in arguments)

        def parse_args(args: list[str]) -> Any:
            if not ctx.resilient_parsing:
                args = list(in_tfbus_words(args, own, bool(arguments), takes_assignments))
            return parse(args)

        parser.parse_args = parse_args


def in_tfbus_words(
    args: list[str],
    own: Collection[str] = (),
    has_arguments: bool = False,
    takes_assignments: bool = False,
) -> Iterator[str]:
    """The arguments with ROS's translated.

    `own` are the options of the command itself; if it `takes_assignments`, `name:=value` is an
    argument of its own. Raises click.UsageError, with the right form, for
    an argument of ROS that tfbus does not have.
    """
    rest = iter(args)
    before = ""
    for arg in rest:
        if arg == _BEGIN:
            yield from _of_ros(rest)
        elif arg == _END:
            yield from (arg, *rest)
        elif arg in _SHORT:
            value = _value_of(arg, rest)
            yield from (arg if arg in own and ":=" not in value else _SHORT[arg], value)
        else:
            _check_assignment(arg, before, has_arguments, takes_assignments)
            yield arg
        before = arg


def _of_ros(rest: Iterator[str]) -> Iterator[str]:
    for arg in rest:
        if arg == _END:
            return
        if arg == _BEGIN or _FLAGS_WITHOUT_MEANING.fullmatch(arg):
            continue
        name, has_value, value = arg.partition("=") if arg.startswith("--") else (arg, "", "")
        if name not in _OPTIONS:
            raise click.UsageError(
                f"'{printable(arg, 60)}' is not known after --ros-args; known: "
                f"{', '.join(_OPTIONS)}, and -- ends them"
            )
        value = value if has_value else _value_of(arg, rest)
        yield from (_OPTIONS[name], _level(value) if name == "--log-level" else value)


def _value_of(option: str, rest: Iterator[str]) -> str:
    value = next(rest, None)
    if value is None:
        raise click.UsageError(f"option '{option}' needs a value, as in {option} name:=value")
    return value


def _level(text: str) -> str:
    """The level in `WARN`, and in `node:=warn`."""
    return log_level_of(text.rpartition(":=")[2])


def _check_assignment(arg: str, before: str, has_arguments: bool, takes_assignments: bool) -> None:
    found = _ASSIGNMENT.fullmatch(arg)
    if not found or before.startswith("-"):
        return
    name, sign, value = found.groups()
    if sign == "=" and has_arguments:
        return
    if takes_assignments and not name.startswith(("_", "~")):
        return
    form = _form(printable(name, 60), printable(value, 60))
    raise click.UsageError(f"'{printable(arg, 60)}' needs its option: write {form}")


def _form(name: str, value: str) -> str:
    """The meaning of ROS's `name:=value` is in tfbus's words; ROS 1 has `_` before a private
    parameter.
    """
    if name == "__ns":
        return f"--namespace {value.strip('/')}"
    if name in ("__node", "__name"):
        return f"--name {value}"
    if name.startswith(("_", "~")):
        return f"--param {name.lstrip('_~/')}={value}"
    return (
        f"--param {name}={value} to set a parameter, or --remap {name}:={value} to use another name"
    )


class Several(click.Option):
    """An option with `multiple=True` whose values may follow one another: `--topics a b`, as well
    as `--topics a --topics b`. The next word that begins with `-` ends them; if it is the first,
    it is a usage error.
    """

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Have the parser take all values that follow."""
        super().add_to_parser(parser, ctx)
        for name in self.opts:
            option = parser._long_opt.get(name) or parser._short_opt.get(name)
            option.process = self._taking_several(option.process)

    def takes(self, word: str) -> bool:
        """Whether the next word is a value."""
        return not word.startswith("-")

    def _taking_several(self, process: Any) -> Any:
        def take(value: Any, state: Any) -> None:
            if value.startswith("-"):
                name = max(self.opts, key=len)
                raise click.BadOptionUsage(
                    name,
                    f"option '{name}' needs at least one value, and {printable(value, 60)!r} is an "
                    "option",
                )
            process(value, state)
            while state.rargs and self.takes(state.rargs[0]):
                process(state.rargs.pop(0), state)

        return take


F = TypeVar("F", bound=Callable[..., Any])


def click_error(error: TfbusError) -> click.ClickException:
    """The error of a command: exit code 2 if it was called wrongly, with a setting or name that is
    invalid, a file that is not there, or without its terminal; 1 if it failed.
    """
    is_mistake = isinstance(error, (SettingsError, InvalidNameError, MissingFileError))
    return (_Mistake if is_mistake else click.ClickException)(str(error))


class _Mistake(click.ClickException):
    """A usage error in one sentence: the command line itself is complete."""

    exit_code = click.UsageError.exit_code


def bus_options(name: str) -> Callable[[F], F]:
    """Add the options by which a process joins the bus to a click command.

    The command's first argument is then their value, NodeSettings of this name. A TfbusError that
    it raises is printed as one sentence, with the exit code of `click_error`.
    """
    return _with_options(name, _BUS_OPTIONS)


def listening_options(kind: str, *, always_fleet: bool = False) -> Callable[[F], F]:
    """`bus_options`, `--sim-time` and `fleet_options`, for a command that listens to transforms;
    with `always_fleet` to a fleet's, without `--fleet`. Each run has a name of its own, which
    begins with `kind`.
    """
    name = partial(own_name, kind)
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
    """Add `--expect` to a click command with `fleet_options` below it; its argument `roster` has
    the names of robots, sorted.
    """

    @functools.wraps(function)
    def command(*args: Any, expected: tuple[tuple[str, ...], ...], **values: Any) -> Any:
        names = {name for each in expected for name in each}
        if names and not values.get("fleet", True):
            raise click.UsageError("--expect names the robots of a fleet: give --fleet too")
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


def check_grace(is_used: object, needed: str) -> None:
    """Refuse a `--grace` on the command line that would do nothing: it is for the `needed` options.

    Raises click.UsageError.
    """
    source = click.get_current_context().get_parameter_source("grace_s")
    if source is ParameterSource.COMMANDLINE and not is_used:
        raise click.UsageError(
            f"--grace is for {needed}: it says how long robots of the roster have to come"
        )


def grace_option(until: str) -> Callable[[F], F]:
    """The option `--grace`; its argument `grace_s` is in seconds, and `until` names in its help the
    event after that.
    """
    return click.option(
        "--grace",
        "grace_s",
        type=NOT_NEGATIVE,
        default=30.0,
        metavar="SECONDS",
        show_default=True,
        help=f"How long robots of the roster have to come before {until}.",
    )


def period_option(meaning: str) -> Callable[[F], F]:
    """The option `--period`; its argument `period_s` is in seconds, and `meaning` is its help, to
    which the least value is added.
    """
    return click.option(
        "-p",
        "--period",
        "period_s",
        type=Number(least=0.1, most=3600.0),
        default=1.0,
        metavar="SECONDS",
        show_default=True,
        help=f"{meaning}, at least 0.1.",
    )


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
        return _ROS_ARGS(_with_options(default_name, options)(interruptible(function)))

    return decorate


def interruptible(function: F) -> F:
    """Take Ctrl-C and SIGTERM for the usual end of a click command: exit code 0."""

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
                raise click_error(error) from error

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
    "network": _option(
        "--network",
        type=click.Choice(NETWORK_NAMES),
        help="The network to the others (default lan); auto: that of this host's interface.",
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
    "poses": _option(
        "--poses",
        type=click.Choice(POSES),
        help="How precise the transforms are that it sends (default float64).",
    ),
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
