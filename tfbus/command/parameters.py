"""Parameters of a node on a command line: in its help, and from a file."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import click

from tfbus.base.errors import SettingsError
from tfbus.base.wording import listed, printable
from tfbus.base.yaml_file import read_value, read_yaml_file

Value = bool | int | float | str

_TYPE_NAMES: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "text"}


class _Declares(Protocol):
    """The part of a Node that declares parameters."""

    @property
    def declare_parameter(self) -> Callable[..., Any]: ...


@dataclass(frozen=True)
class Declared:
    """A parameter: its default and so its type, a description, and bounds if it is a number."""

    name: str
    default: Value
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def on(self, node: _Declares, **more: Any) -> Any:
        """Declare it on a node, with more arguments of `declare_parameter`; the Parameter."""
        return node.declare_parameter(
            self.name,
            self.default,
            description=self.description,
            minimum=self.minimum,
            maximum=self.maximum,
            **more,
        )

    @property
    def help(self) -> str:
        """`Seconds for one circle. [number from 0.1; default 10.0]`."""
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (("from", self.minimum), ("to", self.maximum))
            if bound is not None
        ]
        kind = " ".join((_TYPE_NAMES[type(self.default)], *bounds))
        is_text = isinstance(self.default, str) and self.default
        default = self.default if is_text else json.dumps(self.default)
        return f"{self.description}  [{kind}; default {default}]"


class NodeCommand(click.Command):
    """The command of a node; its help lists the `declared` parameters."""

    def __init__(self, *args: Any, declared: Sequence[Declared] = (), **given: Any) -> None:
        super().__init__(*args, **given)
        self.declared = tuple(declared)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The parameters after the options."""
        super().format_options(ctx, formatter)
        if self.declared:
            with formatter.section("Parameters, set by --param NAME=VALUE or `tfbus param set`"):
                formatter.write_dl([(each.name, each.help) for each in self.declared])


# ROS 2's key above the parameters of a node.
_PARAMETERS = "ros__parameters"


def parameters_from_file(path: Path, node: str) -> dict[str, Any]:
    """The parameters in the file for the node of this full name, `/robot7/sim`.

    A file without names of nodes is for any node. In names, `*` is any one part and `**` any
    number of them. A parameter within a map is named with a dot: `arm.speed`. Raises YamlFileError
    if it is not YAML, SettingsError if it has nothing for this node.
    """
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
