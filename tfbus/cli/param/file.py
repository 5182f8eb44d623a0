"""YAML files of parameters, as `tfbus param dump` and ROS 2 write them."""

from collections.abc import Mapping
from typing import IO, Any

import click

from tfbus.wording import listed

# The key for every node, and ROS 2's key above the parameters of one.
_EVERY_NODE = "/**"
_ROS_PARAMETERS = "ros__parameters"


def read_parameter_file(file: IO[str], node: str) -> dict[str, Any]:
    """The parameters in the file for the node of this full name.

    A file without names of nodes is for any node. Raises click.BadParameter if it is not a map, or
    has nothing for this node.
    """
    from tfbus.wire.yaml_values import read_value  # YAML, which `--help` does not need

    content = read_value(file.read())
    if not isinstance(content, dict) or not content:
        raise _mistake(file, "is not a YAML map of parameters")
    if not any(isinstance(value, dict) for value in content.values()):
        return content
    nodes = [name for name in (_EVERY_NODE, node, node.strip("/")) if name in content]
    if not nodes:
        raise _mistake(file, f"has no parameters for {node}; available: {listed(content)}")
    values: dict[str, Any] = {}
    for name in nodes:
        values |= _parameters(file, name, content[name])
    return values


def _parameters(file: IO[str], node: str, content: Any) -> Mapping[str, Any]:
    if isinstance(content, dict) and list(content) == [_ROS_PARAMETERS]:
        content = content[_ROS_PARAMETERS]
    if not isinstance(content, dict):
        raise _mistake(file, f"has no map of parameters under {node}")
    return content


def _mistake(file: IO[str], what: str) -> click.BadParameter:
    return click.BadParameter(f"{file.name} {what}", param_hint="FILE")
