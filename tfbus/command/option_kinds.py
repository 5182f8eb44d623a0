"""Kinds of options: left out of a help, ROS's arguments, several values after one name."""

import re
from collections.abc import Collection, Iterator
from typing import Any

import click

from tfbus.bus.settings import log_level_of
from tfbus.wording import printable

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
    """Whether all options are shown: if asked for, and where there are no others."""
    own = (
        param
        for param in ctx.command.params
        if isinstance(param, click.Option) and not isinstance(param, NodeOption | HelpAll)
    )
    return bool(ctx.meta.get(SHOWS_ALL)) or not any(own)


_BEGIN, _END = "--ros-args", "--"
_SHORT = {"-p": "--param", "-r": "--remap"}

# ROS's options, and how tfbus calls them; those after which nothing changes are left out.
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
    """The arguments with those of ROS translated.

    `own` are the options of the command itself; where it `takes_assignments`, `name:=value` is an
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
    as `--topics a --topics b`. The next word that begins with `-` ends them; where it is the first,
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
