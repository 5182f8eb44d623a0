"""YAML values that know where they stand, so that every mistake gets its line and key."""

from collections.abc import Collection
from pathlib import Path

import yaml

from tfbus.launch.place import LaunchError, Place, nearest

_NULL = "tag:yaml.org,2002:null"


class Value:
    """One value of a YAML document.

    Every scalar is read as text, as it is written; whoever reads it converts it after
    substitution. So `delay: ${delay}` and `delay: 2` obey one rule.
    """

    def __init__(self, node: yaml.Node, place: Place) -> None:
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
        """The text of a scalar; LaunchFileError for a list, a mapping or nothing."""
        if self.is_empty:
            raise self.place.mistake("has no value; write one, or leave the key out")
        if not isinstance(self._node, yaml.ScalarNode):
            raise self._wrong_kind("one value")
        return str(self._node.value)

    def items(self) -> "list[Value]":
        """The values of a list; LaunchFileError for anything else."""
        if not isinstance(self._node, yaml.SequenceNode):
            raise self._wrong_kind("a list")
        place = self.place
        return [
            Value(node, Place(place.path, _line(node), f"{place.key}[{index}]"))
            for index, node in enumerate(self._node.value)
        ]

    def entries(self) -> "dict[str, Value]":
        """The values of a mapping by key; LaunchFileError for anything else or a key twice."""
        if not isinstance(self._node, yaml.MappingNode):
            raise self._wrong_kind("a mapping (lines of `key: value`)")
        entries: dict[str, Value] = {}
        for key_node, node in self._node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                line = _line(key_node)
                raise Place(self.place.path, line, self.place.key).mistake("a key must be a word")
            key = str(key_node.value)
            full_key = ".".join(filter(None, (self.place.key, key)))
            place = Place(self.place.path, _line(key_node), full_key)
            if key in entries:
                earlier = entries[key].place.line
                raise place.mistake(f"is written twice, first in line {earlier}; keep one")
            entries[key] = Value(node, place)
        return entries

    def fields(self, known: Collection[str]) -> "dict[str, Value]":
        """The entries of a mapping that may have the known keys only."""
        entries = self.entries()
        for key, value in entries.items():
            if key not in known:
                raise value.place.mistake(
                    f"unknown key {key!r}{nearest(key, known)} Known here: {', '.join(known)}"
                )
        return entries

    def _wrong_kind(self, expected: str) -> LaunchError:
        found = "a list" if self.is_list else "a mapping" if self.is_mapping else "one value"
        return self.place.mistake(
            f"must be {expected}, and is {'empty' if self.is_empty else found}"
        )


def read_document(path: Path, shown: str) -> Value:
    """The whole document in a YAML file, which errors call `shown`.

    Raises LaunchFileError where it is not YAML, LaunchError where it cannot be read.
    """
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise Place(shown, mark.line + 1 if mark else 1).mistake(
            f"is not YAML: {error.problem or error.context}"
        ) from error
    except yaml.YAMLError as error:
        raise Place(shown, 1).mistake(f"is not YAML: {error}") from error
    except UnicodeDecodeError as error:
        raise LaunchError(f"{shown} is not a text file in UTF-8") from error
    except OSError as error:
        raise LaunchError(f"{shown} cannot be read: {error.strerror}") from error
    if node is None:
        raise Place(shown, 1).mistake("is empty; a launch file lists at least one node")
    return Value(node, Place(shown, _line(node)))


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1
