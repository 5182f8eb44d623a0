"""The arguments of a launch file: declared in it, and given to it."""

from collections.abc import Iterator, Mapping, Sequence

from tfbus.launch.description import Argument
from tfbus.launch.errors import LaunchArgumentError
from tfbus.launch.read.substitution import HERE
from tfbus.runtime.yaml_file import Value
from tfbus.wording import did_you_mean

_KEYS = ("default", "description", "choices")


def declared_arguments(value: Value) -> Iterator[Argument]:
    """The arguments declared in the mapping under `arguments:` of a launch file."""
    for name, declared in value.entries().items():
        if not name.isidentifier() or name == HERE:
            raise declared.place.mistake(
                f"{name!r} cannot be the name of an argument: use letters, digits and '_', "
                f"and not {HERE!r}, which is the folder of the file"
            )
        yield Argument(name) if declared.is_empty else _argument(name, declared)


def argument_values(
    arguments: Sequence[Argument], given: Mapping[str, str], file: str
) -> dict[str, str]:
    """The value of each argument of `file`. Raises LaunchArgumentError if one does not fit."""
    declared = {argument.name: argument for argument in arguments}
    for name in given:
        if name not in declared:
            raise LaunchArgumentError(
                name,
                f"{file} takes no argument {name!r}"
                f"{did_you_mean(name, declared, none='; it takes none')}",
            )
    return {name: _value(argument, given, file) for name, argument in declared.items()}


def show_arguments(arguments: Sequence[Argument]) -> str:
    """The output of `--show-args`, in the form of `ros2 launch`."""
    lines = ["Arguments (pass arguments as '<name>:=<value>'):", ""]
    for argument in arguments:
        lines += [f"    '{argument.name}':", f"        {argument.description or 'no description'}"]
        if argument.choices:
            lines.append(f"        one of: {', '.join(argument.choices)}")
        if argument.default is not None:
            lines.append(f"        (default: '{argument.default}')")
        lines.append("")
    if not arguments:
        lines += ["    No arguments.", ""]
    return "\n".join(lines[:-1])


def _argument(name: str, declared: Value) -> Argument:
    if not declared.is_mapping:
        raise declared.place.mistake(
            f"must be a mapping, as in `{name}: {{default: ..., description: ...}}`"
        )
    fields = declared.fields(_KEYS)
    choices = fields["choices"].items() if "choices" in fields else []
    argument = Argument(
        name,
        default=fields["default"].text() if "default" in fields else None,
        description=fields["description"].text() if "description" in fields else "",
        choices=tuple(choice.text() for choice in choices),
    )
    if argument.choices and argument.default not in (None, *argument.choices):
        raise fields["default"].place.mistake(
            f"{argument.default!r} is not one of the choices {', '.join(argument.choices)}"
        )
    return argument


def _value(argument: Argument, given: Mapping[str, str], file: str) -> str:
    value = given.get(argument.name, argument.default)
    if value is None:
        about = f" ({argument.description})" if argument.description else ""
        raise LaunchArgumentError(
            argument.name, f"{file} needs a value for its argument {argument.name!r}{about}"
        )
    if argument.choices and value not in argument.choices:
        raise LaunchArgumentError(
            argument.name,
            f"argument {argument.name!r} of {file} must be one of {', '.join(argument.choices)}, "
            f"not {value!r}",
        )
    return value
