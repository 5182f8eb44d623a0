"""The fields of one entry of a launch file, with substitutions made and types checked."""

import json
import re
import shlex
from collections.abc import Callable, Collection, Iterator
from math import isfinite

from tfbus.errors import TfbusError
from tfbus.launch.read.arguments import Scope, truth
from tfbus.runtime.yaml_file import FilePlace, Value, YamlFileError

CONDITIONS = ("if", "unless")


class Fields:
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
        """The place of a field; of a missing one, that of the whole entry."""
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

    def inner(self, key: str, known: Collection[str]) -> "Fields":
        """The fields of a field that is a mapping."""
        return Fields(self._values[key], known, self._scope)

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
    """The text as an item of a YAML list in brackets, quoted where YAML would split it."""
    return json.dumps(text) if re.search(r"[\[\]{},:#'\"\s]|^$", text) else text


def _located(error: TfbusError, place: FilePlace) -> TfbusError:
    return error if isinstance(error, YamlFileError) else place.mistake(str(error))
