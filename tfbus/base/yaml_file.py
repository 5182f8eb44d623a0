"""YAML of people: files, with a place for each mistake, and values as they are typed.

Typed values are of YAML 1.2, whose words have no traps. PyYAML reads YAML 1.1, in which `no`, `off`
and `y: 1` hold booleans, 010 is eight, 1:30 is ninety, 1e-3 is a text and 2022-12-07 is a date. A
typed plain word is nothing (`null`, `~`), true or false, a number, or else a text, and the key of a
map is always a text.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tfbus.base.errors import TfbusError
from tfbus.base.wording import did_you_mean

_NULL = "tag:yaml.org,2002:null"


class YamlFileError(TfbusError):
    """A file that cannot be read or is not YAML, or has a mistake: `file:line: key: reason`."""


@dataclass(frozen=True, slots=True)
class FilePlace:
    """A line (from 1) of a file and the key that stands there, `nodes[0].name`; "" for the file."""

    path: str
    line: int
    key: str = ""

    def __str__(self) -> str:
        return ": ".join(filter(None, (f"{self.path}:{self.line}", self.key)))

    def mistake(self, reason: str) -> YamlFileError:
        """The error to raise for a mistake at this place."""
        return YamlFileError(f"{self}: {reason}")


class Value:
    """A value of a YAML document.

    A scalar is its text as written; the reader converts it. So `delay: ${delay}` and `delay: 2`
    obey one rule. Methods raise YamlFileError, at the place of the value, for another kind.
    """

    def __init__(self, node: yaml.Node, place: FilePlace) -> None:
        self._node = node
        self.place = place

    @property
    def is_list(self) -> bool:
        return isinstance(self._node, yaml.SequenceNode)

    @property
    def is_mapping(self) -> bool:
        return isinstance(self._node, yaml.MappingNode)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is written there, or `null`."""
        return bool(self._node.tag == _NULL)

    def text(self) -> str:
        """The text of a scalar."""
        if self.is_empty:
            raise self.place.mistake("has no value; write one, or omit the key")
        if not isinstance(self._node, yaml.ScalarNode):
            raise self._wrong_kind("one value")
        return str(self._node.value)

    def items(self) -> "list[Value]":
        """The values of a list."""
        if not isinstance(self._node, yaml.SequenceNode):
            raise self._wrong_kind("a list")
        place = self.place
        return [
            Value(node, FilePlace(place.path, _line(node), f"{place.key}[{index}]"))
            for index, node in enumerate(self._node.value)
        ]

    def entries(self) -> "dict[str, Value]":
        """The values of a mapping by key; a key must not stand there twice."""
        if not isinstance(self._node, yaml.MappingNode):
            raise self._wrong_kind("a mapping (lines of `key: value`)")
        entries: dict[str, Value] = {}
        for key_node, node in self._node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                line = _line(key_node)
                raise FilePlace(self.place.path, line, self.place.key).mistake(
                    "a key must be a word"
                )
            key = str(key_node.value)
            full_key = ".".join(filter(None, (self.place.key, key)))
            place = FilePlace(self.place.path, _line(key_node), full_key)
            if key in entries:
                earlier = entries[key].place.line
                raise place.mistake(f"is written twice, first in line {earlier}; keep one")
            entries[key] = Value(node, place)
        return entries

    def fields(self, known: Collection[str]) -> "dict[str, Value]":
        """The entries of a mapping whose keys are all known."""
        entries = self.entries()
        for key, value in entries.items():
            if key not in known:
                raise value.place.mistake(f"unknown key {key!r}{did_you_mean(key, known)}")
        return entries

    def _wrong_kind(self, expected: str) -> YamlFileError:
        found = "a list" if self.is_list else "a mapping" if self.is_mapping else "one value"
        return self.place.mistake(f"must be {expected}, not {'empty' if self.is_empty else found}")


def read_yaml_file(path: Path, content: str) -> Value:
    """The whole document in a file, which must hold `content`, such as "a list of edges".

    Raises YamlFileError if the file cannot be read, is not YAML, or is empty.
    """
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line, reason = yaml_mistake(error)
        raise FilePlace(str(path), line).mistake(f"is not YAML: {reason}") from error
    except yaml.YAMLError as error:
        raise FilePlace(str(path), 1).mistake(f"is not YAML: {error}") from error
    except RecursionError:
        raise FilePlace(str(path), 1).mistake("is nested too deeply") from None
    except UnicodeDecodeError as error:
        raise YamlFileError(f"{path} is not a text file in UTF-8") from error
    except OSError as error:
        raise YamlFileError(f"{path} cannot be read: {error.strerror}") from error
    if node is None:
        raise FilePlace(str(path), 1).mistake(f"is empty; write {content}")
    return Value(node, FilePlace(str(path), _line(node)))


def yaml_mistake(error: yaml.MarkedYAMLError) -> tuple[int, str]:
    """The line (from 1) that YAML does not accept, and the mistake there in plain words."""
    problem = error.problem or error.context or "it cannot be read"
    for pattern, reason, is_at_start in _MISTAKES:
        if found := re.search(pattern, problem):
            mark = error.context_mark if is_at_start else error.problem_mark
            return _line_of(mark or error.problem_mark), reason.format(*found.groups())
    return _line_of(error.problem_mark or error.context_mark), problem


# The parser's words; ours; and whether the line is the one where the part begins.
_MISTAKES = (
    (
        "mapping values are not allowed",
        "a ':' stands where no key can be; check the indentation, or put the text in quotes",
        False,
    ),
    (
        "expected <block end>",
        "this does not fit the lines above it; check the indentation, and that a list is not "
        "mixed with keys",
        False,
    ),
    (r"expected ',' or '\]'", "a list that begins here has no end; write ',' or ']'", True),
    (r"expected ',' or '\}'", "a mapping that begins here has no end; write ',' or '}}'", True),
    ("unexpected end of stream", "a quote that begins here has no end", True),
    (r"found character '\\t'", "a tab stands here; indent with spaces", False),
    (r"found character '(.)'", "a text cannot begin with {0!r}; put it in quotes", False),
    ("expected ':'", "a key that begins here has no ':' after it", True),
    (
        r"undefined alias '(.*)'",
        "'*{0}' refers to '&{0}', which is not there; put it in quotes if it is a text",
        False,
    ),
    (
        r"unknown escape character '(.)'",
        "'\\{0}' means nothing between double quotes; use single quotes",
        False,
    ),
)


def _line_of(mark: yaml.Mark | None) -> int:
    return int(mark.line) + 1 if mark else 1


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


_TAG = "tag:yaml.org,2002:"
_BASES = {"0o": 8, "0x": 16}

# Of a text that came over the network. PyYAML's time grows with the square of the nesting.
_MOST_LETTERS = 10_000
_MOST_NESTED = 100

# The core schema: https://yaml.org/spec/1.2.2/#1032-tag-resolution
_WORDS = {
    "null": r"null|~|",
    "bool": r"true|false",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-f]+",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)(e[-+]?[0-9]+)?|[-+]?\.inf|\.nan",
}


def read_value(text: str) -> Any:
    """The value of the text; a text that is not YAML is its own value."""
    try:
        return yaml.load(text, _LOADER)
    except Exception:  # a tag that does not fit may raise any: `!!bool 5` a KeyError
        return text


def read_strangers_value(text: str) -> Any:
    """As `read_value`, for a text that came over the network.

    A text is its own value if it has anchors, which let a few letters stand for billions of
    values, or more than 10,000 letters or 100 lists and maps, which could take seconds to read.
    """
    if len(text) > _MOST_LETTERS or text.count("[") + text.count("{") > _MOST_NESTED:
        return text
    try:
        return yaml.load(text, _STRANGERS_LOADER)
    except Exception:
        return text


def _read_int(loader: Any, node: Any) -> int:
    return int(node.value, _BASES.get(node.value[:2].lower(), 10))


def _read_map(loader: Any, node: Any) -> dict[str, Any]:
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise yaml.YAMLError("the key of a map must be a text")
    return {key.value: loader.construct_object(value, deep=True) for key, value in node.value}


def _without_anchors(loader: Any, parent: Any, index: Any) -> Any:
    event = loader.peek_event()
    if getattr(event, "anchor", None) is not None:
        raise yaml.YAMLError("there are no anchors and aliases here")
    return yaml.SafeLoader.compose_node(loader, parent, index)


def _make_loader() -> Any:
    # Not a class statement: without PyYAML's types, mypy does not know its base.
    loader: Any = type("_Loader", (yaml.SafeLoader,), {"yaml_implicit_resolvers": {}})
    for name, pattern in _WORDS.items():
        word = re.compile(rf"(?:{pattern})\Z", re.IGNORECASE)
        loader.add_implicit_resolver(_TAG + name, word, [None])
    loader.add_constructor(f"{_TAG}int", _read_int)
    loader.add_constructor(f"{_TAG}map", _read_map)
    return loader


_LOADER = _make_loader()
_STRANGERS_LOADER: Any = type("_Loader", (_LOADER,), {"compose_node": _without_anchors})
