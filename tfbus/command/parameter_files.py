"""Files of parameters for the start of a node, as ROS 2 and `tfbus param dump` write them."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tfbus.errors import SettingsError
from tfbus.runtime.yaml_file import read_yaml_file
from tfbus.wording import listed, printable

# ROS 2's key above the parameters of a node.
_PARAMETERS = "ros__parameters"


def parameters_from_file(path: Path, node: str) -> dict[str, Any]:
    """The parameters in the file for the node of this full name, `/robot7/sim`.

    A file without names of nodes is for any node. In names, `*` is any one part and `**` any
    number of them. A parameter within a map is named with a dot: `arm.speed`. Raises YamlFileError
    if it is not YAML, SettingsError if it has nothing for this node.
    """
    from tfbus.wire.yaml_values import read_value  # YAML, which `--help` does not need

    read_yaml_file(path, "a map of parameters")  # for its errors, which have a line
    content = read_value(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise SettingsError(f"{path} is not a map of parameters")
    sections = [*_sections(content, "")]
    if not sections:
        is_flat = not any(isinstance(value, dict) for value in content.values())
        sections = [("/**", content)] if is_flat else [*_plain_sections(content)]
    fitting = [values for name, values in sections if _fits(name.split("/"), node.split("/"))]
    if not fitting:
        names = [printable(name, 60) for name, _ in sections]
        raise SettingsError(f"{path} has no parameters for {node}; it has some for {listed(names)}")
    return {name: value for values in fitting for name, value in _flat(values, "")}


def _sections(content: Mapping[str, Any], path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Each node's name with its parameters; a namespace may be a map of nodes."""
    for name, value in content.items():
        if name == _PARAMETERS and isinstance(value, dict):
            yield path, value
        elif isinstance(value, dict):
            yield from _sections(value, f"{path}/{name.strip('/')}")


def _plain_sections(content: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield f"/{name.strip('/')}", value


def _fits(pattern: list[str], node: list[str]) -> bool:
    if not pattern:
        return not node
    first, rest = pattern[0], pattern[1:]
    if first == "**":
        return any(_fits(rest, node[at:]) for at in range(len(node) + 1))
    return bool(node) and first in ("*", node[0]) and _fits(rest, node[1:])


def _flat(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
