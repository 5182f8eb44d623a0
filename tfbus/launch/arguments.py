"""The arguments of a launch file, declared and given, and `${...}`, which names them, in the
fields of an entry.

`${name}` is the launch argument of that name, `${env:NAME}` an environment variable (an error if
it is not set), `${env:NAME:text}` the same with a default, `${here}` the folder of the launch
file. `$${` stands for a plain `${`; any other `$` is a plain `$`. Values are not substituted again.
"""

import json
import re
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from tfbus.base.errors import TfbusError
from tfbus.base.wording import did_you_mean
from tfbus.base.yaml_file import FilePlace, Value, YamlFileError
from tfbus.launch.description import Argument, LaunchArgumentError

HERE = "here"

# A launch file can pass an argument on twice as long, and its includes again.
_LONGEST = 100_000

_SUBSTITUTION = re.compile(r"\$\$\{|\$\{(?P<inside>[^{}]*)\}|\$\{")
_COMPARISON = re.compile(r"(?P<left>.*?)(?P<sign>==|!=)(?P<right>.*)", re.DOTALL)
_TRUTH = {word: True for word in ("true", "yes", "on", "1")} | {
    word: False for word in ("false", "no", "off", "0")
}


@dataclass(frozen=True, slots=True)
class Scope:
    """The values that `${...}` can name in one launch file."""

    arguments: Mapping[str, str]
    environment: Mapping[str, str]
    here: str

    def expand(self, text: str, place: FilePlace) -> str:
        """The text with every substitution made.

        Raises YamlFileError for an argument or a variable that does not exist, and for a text of
        more than 100,000 letters.
        """

        def replaced(match: re.Match[str]) -> str:
            if match.group() == "$${":
                return "${"
            inside = match.group("inside")
            if inside is None:
                raise place.mistake("'${' without its '}'; write '$${' for a plain '${'")
            return self._value(inside.strip(), place)

        expanded = _SUBSTITUTION.sub(replaced, text)
        if len(expanded) > _LONGEST:
            raise place.mistake(
                f"has {len(expanded):,} letters after substitution; at most {_LONGEST:,} are taken"
            )
        return expanded

    def is_true(self, text: str, place: FilePlace) -> bool:
        """Whether a condition holds: a word for true or false, or `a == b`, `a != b` (as text).

        Raises YamlFileError for any other text.
        """
        if comparison := _COMPARISON.fullmatch(text):
            left, right = (
                self.expand(comparison[side], place).strip() for side in ("left", "right")
            )
            return (left == right) is (comparison["sign"] == "==")
        return truth(self.expand(text, place), place)

    def _value(self, inside: str, place: FilePlace) -> str:
        if inside == HERE:
            return self.here
        if inside.startswith("env:"):
            return self._variable(inside.removeprefix("env:"), place)
        if inside in self.arguments:
            return self.arguments[inside]
        if inside in self.environment:
            raise place.mistake(
                f"no argument {inside!r} under 'arguments:'; write ${{env:{inside}}} for the "
                f"environment variable, or $${{{inside}}} to leave it to a shell"
            )
        raise place.mistake(
            f"no argument {inside!r} under 'arguments:'{did_you_mean(inside, self.arguments)}"
        )

    def _variable(self, name: str, place: FilePlace) -> str:
        name, has_default, default = name.partition(":")
        if name in self.environment:
            return self.environment[name]
        if has_default:
            return default
        raise place.mistake(
            f"the environment variable {name!r} is not set; set it, or give a default: "
            f"${{env:{name}:text}}"
        )


def truth(text: str, place: FilePlace) -> bool:
    """True or False for the words that YAML has for them (and 1 and 0)."""
    try:
        return _TRUTH[text.strip().lower()]
    except KeyError:
        raise place.mistake(f"must be true or false, not {text!r}") from None


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


CONDITIONS = ("if", "unless")


class LaunchFields:
    """The fields of a mapping whose keys are all known, read in a scope.

    Each method raises YamlFileError, at the line of the key, for a value of the wrong kind.
    """

    def __init__(self, value: Value, known: Collection[str], scope: Scope) -> None:
        self._values = value.fields((*known, *CONDITIONS))
        self._scope = scope
        self.place = value.place

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def place_of(self, key: str) -> FilePlace:
        """The place of a field; of a missing one, the whole entry's."""
        return self._values[key].place if key in self._values else self.place

    @property
    def is_on(self) -> bool:
        """Whether `if:` and `unless:` let the entry take part."""
        return self._holds("if", default=True) and not self._holds("unless", default=False)

    def text(self, key: str, check: Callable[[str], str] = str) -> str:
        """A text; "" if it is missing. `check` returns it, or raises TfbusError."""
        if key not in self._values:
            return ""
        try:
            return check(self._expanded(self._values[key]))
        except TfbusError as error:
            raise _located(error, self.place_of(key)) from error

    def words(self, key: str) -> tuple[str, ...]:
        """A list of words, or a text that is split as a shell does, before substitution."""
        if key not in self._values:
            return ()
        value = self._values[key]
        if value.is_list:
            return tuple(self._expanded(item) for item in value.items())
        try:
            words = shlex.split(value.text())
        except ValueError as error:
            raise value.place.mistake(f"cannot be split into words: {error}") from error
        return tuple(self._scope.expand(word, value.place) for word in words)

    def pairs(self, key: str) -> tuple[tuple[str, str], ...]:
        """The names and values of a mapping; a list as a value becomes the text `[a, b]`."""
        return tuple((name, self._listed(value)) for name, value in self.entries(key).items())

    def entries(self, key: str) -> dict[str, Value]:
        """The values of a mapping by name, before substitution; {} if it is missing."""
        return self._values[key].entries() if key in self._values else {}

    def items(self, key: str) -> Iterator[tuple[str, FilePlace]]:
        """A text or several in a list, each with its place."""
        if key in self._values:
            value = self._values[key]
            for item in value.items() if value.is_list else [value]:
                yield self._expanded(item), item.place

    def truth(self, key: str) -> bool:
        """True or false; false if it is missing."""
        return key in self._values and truth(self.text(key), self.place_of(key))

    def is_mapping(self, key: str) -> bool:
        return key in self._values and self._values[key].is_mapping

    def inner(self, key: str, known: Collection[str]) -> "LaunchFields":
        """The fields of a field that is a mapping."""
        return LaunchFields(self._values[key], known, self._scope)

    def seconds(self, key: str, default: float) -> float:
        """A number of seconds, 0 or more."""
        if key not in self._values:
            return default
        text = self.text(key)
        try:
            number = float(text)
        except ValueError:
            number = -1.0
        if not isfinite(number) or number < 0:
            raise self.place_of(key).mistake(
                f"must be a number of seconds, 0 or more, not {text!r}"
            )
        return number

    def count(self, key: str) -> int | None:
        """A whole number, 0 or more; None if it is missing."""
        if key not in self._values:
            return None
        text = self.text(key)
        if not (text.isascii() and text.isdigit()):
            raise self.place_of(key).mistake(f"must be a whole number, 0 or more, not {text!r}")
        return int(text)

    def _holds(self, key: str, *, default: bool) -> bool:
        if key not in self._values:
            return default
        return self._scope.is_true(self._values[key].text(), self.place_of(key))

    def _expanded(self, value: Value) -> str:
        return self._scope.expand(value.text(), value.place)

    def _listed(self, value: Value) -> str:
        if not value.is_list:
            return self._expanded(value)
        return f"[{', '.join(_list_item(self._expanded(item)) for item in value.items())}]"


def _list_item(text: str) -> str:
    """The text as an item of a YAML list in brackets, quoted if YAML would split it."""
    return json.dumps(text) if re.search(r"[\[\]{},:#'\"\s]|^$", text) else text


def _located(error: TfbusError, place: FilePlace) -> TfbusError:
    return error if isinstance(error, YamlFileError) else place.mistake(str(error))
