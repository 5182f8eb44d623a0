"""The command-line options that every process takes, as one frozen value of settings."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

import click

from tfbus.bus.settings import LOG_LEVELS, MODES, NodeSettings
from tfbus.errors import SettingsError, TfbusError

F = TypeVar("F", bound=Callable[..., Any])


def bus_options(name: str) -> Callable[[F], F]:
    """Give a click command the options by which a process joins the bus; its first argument is
    then their value, NodeSettings of this name.

    A TfbusError that the command raises is told as one sentence, with exit code 1 (2 where the
    settings themselves are wrong).
    """
    return _with_options(name, _BUS_OPTIONS)


def listening_options(name: str) -> Callable[[F], F]:
    """`bus_options` of a command that listens to transforms: it may go by simulated time, and has
    `fleet_options`.
    """
    options = {"sim_time": _NODE_OPTIONS["sim_time"], **_BUS_OPTIONS}
    return lambda function: fleet_options(_with_options(name, options)(function))


def fleet_options(function: F) -> F:
    """Give a click command the options that say whether it sees a whole fleet; its argument
    `fleet` is then their value, a Fleet or None, as a TransformListener takes it.
    """

    @functools.wraps(function)
    def command(*args: Any, fleet: bool, shared_frames: tuple[str, ...], **values: Any) -> Any:
        from tfbus.wire.fleet import Fleet  # numpy, which `--help` does not need

        if shared_frames and not fleet:
            raise click.UsageError("--shared names what the robots of a fleet share: add --fleet")
        try:
            seen = Fleet(shared_frames) if fleet else None
        except TfbusError as error:
            raise click.UsageError(f"--shared: {error}") from error
        return function(*args, fleet=seen, **values)

    decorated: Any = command
    for option in reversed(_FLEET_OPTIONS):
        decorated = option(decorated)
    return cast(F, decorated)


def node_options(default_name: str) -> Callable[[F], F]:
    """Give a click command the options of a node: as `bus_options`, with its name, parameters
    and remappings. `default_name` is the node's name without `--name`.

    Ctrl-C and SIGTERM are a node's usual end, also while it is still joining the bus: exit code 0.
    """

    def decorate(function: F) -> F:
        return _with_options(default_name, {**_NODE_OPTIONS, **_BUS_OPTIONS})(
            _interruptible(function)
        )

    return decorate


def _interruptible(function: F) -> F:
    @functools.wraps(function)
    def command(*args: Any, **values: Any) -> Any:
        try:
            return function(*args, **values)
        except KeyboardInterrupt:
            raise SystemExit(0) from None

    return cast(F, command)


def _with_options(
    default_name: str, options: Mapping[str, Callable[[Any], Any]]
) -> Callable[[F], F]:
    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(*args: Any, **values: Any) -> Any:
            given = {name: values.pop(name) for name in options}
            try:
                settings = _settings(default_name, given)
            except TfbusError as error:
                raise click.UsageError(str(error)) from error
            try:
                return function(settings, *args, **values)
            except TfbusError as error:
                raise click.ClickException(str(error)) from error

        decorated: Any = command
        for option in reversed([*options.values()]):
            decorated = option(decorated)
        return cast(F, decorated)

    return decorate


def settings_from_args(default_name: str, argv: Sequence[str] | None = None) -> NodeSettings:
    """The settings that a command line gives, where it has the options of a node and no others.

    A mistake in it is told on stderr and exits with 2; `--help` prints the options and exits.
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
    """Ends the process as click does in its own main, for a command that returns a value."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, click.ClickException):
            error.show()
            raise SystemExit(error.exit_code)


def _settings(default_name: str, given: dict[str, Any]) -> NodeSettings:
    values = {name: value for name, value in given.items() if value not in (None, ())}
    values["parameters"] = _pairs(given.get("parameters", ()), "=", "--param name=value")
    values["remappings"] = _pairs(given.get("remappings", ()), ":=", "--remap from:=to")
    return NodeSettings(**({"name": default_name} | values))


def _pairs(texts: Iterable[str], separator: str, form: str) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, found, value = text.partition(separator)
        if not found or not name:
            raise SettingsError(f"{text!r} is not of the form {form}")
        pairs[name] = value
    return pairs


_BUS_OPTIONS = {
    "namespace": click.option(
        "--namespace", metavar="PATH", help="Put before all names on the bus: robot7."
    ),
    "mode": click.option(
        "--mode", type=click.Choice(MODES), help="How to join the bus; peer by default."
    ),
    "connect": click.option(
        "--connect", multiple=True, metavar="ENDPOINT", help="Connect to tcp/host:7447; repeatable."
    ),
    "listen": click.option(
        "--listen", multiple=True, metavar="ENDPOINT", help="Listen on tcp/[::]:7447; repeatable."
    ),
    "config": click.option(
        "--config", type=click.Path(), metavar="FILE", help="Zenoh's configuration, JSON5."
    ),
    "log_level": click.option(
        "--log-level", type=click.Choice(LOG_LEVELS), help="info by default."
    ),
}
_FLEET_OPTIONS = (
    click.option(
        "--fleet",
        is_flag=True,
        help="See the robots in the namespaces below too; their frames are robot7/base_link.",
    ),
    click.option(
        "--shared",
        "shared_frames",
        multiple=True,
        metavar="FRAME",
        help="With --fleet: a frame that all robots share, such as map; repeatable.",
    ),
)
_NODE_OPTIONS = {
    "name": click.option("--name", metavar="NAME", help="The node's name."),
    "sim_time": click.option(
        "--sim-time/--system-time",
        default=None,
        help="Take the time from the topic clock; or from the system, the default.",
    ),
    "parameters": click.option(
        "--param",
        "parameters",
        multiple=True,
        metavar="NAME=VALUE",
        help="Set a parameter of the node; repeatable.",
    ),
    "remappings": click.option(
        "--remap",
        "remappings",
        multiple=True,
        metavar="FROM:=TO",
        help="Use another topic or service; repeatable.",
    ),
}
