"""The nodes that were there at a moment of a recording."""

from tfbus.bus.settings import NodeSettings
from tfbus.command.names import nodes_in
from tfbus.command.recordings import BagChoice
from tfbus.errors import BusError, ParameterError
from tfbus.wire.descriptions import NodeDescription, ParameterDescription
from tfbus.wording import did_you_mean


def nodes_at(choice: BagChoice) -> tuple[dict[str, NodeDescription], int]:
    """The nodes by their full names, and the log time of the moment. Raises TfbusError."""
    with choice.opened() as bag:
        return nodes_in(bag.reader.state_at(bag.at_ns).nodes.values()), bag.at_ns


def node_at(choice: BagChoice, settings: NodeSettings, name: str) -> tuple[NodeDescription, int]:
    """The node of a name, relative to the namespace or full, and the log time of the moment.

    Raises BusError for none.
    """
    nodes, at_ns = nodes_at(choice)
    path = name.strip("/")
    full = path if name.startswith("/") else "/".join(filter(None, (settings.namespace, path)))
    if f"/{full}" not in nodes:
        hint = did_you_mean(f"/{full}", nodes, none=", nor any other")
        raise BusError(f"there is no node {name!r} in the recording at that time{hint}")
    return nodes[f"/{full}"], at_ns


def parameter_in(node: NodeDescription, name: str) -> ParameterDescription:
    """A parameter of a recorded node. Raises ParameterError for none."""
    for each in node.parameters:
        if each.name == name:
            return each
    names = [each.name for each in node.parameters]
    raise ParameterError(
        f"node {node.name!r} has no parameter {name!r} in the recording{did_you_mean(name, names)}"
    )
