"""ROS's ways to set up a node on its command line, in tfbus's words.

`--ros-args -p rate:=2 -r __ns:=/robot7 --` becomes `--param rate=2 --namespace robot7`; `-p` and
`-r` mean the same without `--ros-args`; of a command that has options of that name itself, only
with a `:=` in their value.
"""

import re
from collections.abc import Collection, Iterator
from typing import Any

import click

from tfbus.bus.settings import log_level_of
from tfbus.command.node_option import NodeOption
from tfbus.wording import printable

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
