"""Nodes, topics and services as Foxglove's Topic Graph panel shows them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from tfbus.discover.graph import graph_of
from tfbus.wire.descriptions import NodeDescription, StreamDescription
from tfbus.wording import printable

Ends = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Connections:
    """The full names of the nodes at the ends of topics and services."""

    published: Ends = field(default_factory=dict)
    subscribed: Ends = field(default_factory=dict)
    served: Ends = field(default_factory=dict)


def connections(
    nodes: Collection[NodeDescription], streams: Iterable[StreamDescription]
) -> Connections:
    """The graph of these nodes and streams, with the names of Foxglove's topics.

    All streams are on /tf and /tf_static, and every node with a buffer listens to both.
    """
    published: dict[str, set[str]] = {}
    subscribed: dict[str, set[str]] = {}
    for stream in streams:
        for static in {static for _, _, static in stream.frames}:
            topic = "/tf_static" if static else "/tf"
            published.setdefault(topic, set()).add(printable(stream.node))
    for node in nodes:
        if node.buffers:
            for topic in ("/tf", "/tf_static"):
                subscribed.setdefault(topic, set()).add(node.name)
    graph = graph_of(nodes, {})
    for name, info in graph.topics.items():
        if info.publishers:
            published[absolute(name)] = {end.node for end in info.publishers}
        if info.subscribers:
            subscribed[absolute(name)] = {end.node for end in info.subscribers}
    served = {
        absolute(name): {end.node for end in info.servers}
        for name, info in graph.services.items()
        if info.servers
    }
    return Connections(_sorted(published), _sorted(subscribed), _sorted(served))


def absolute(name: str) -> str:
    """The name of a topic or service as ROS, Foxglove and recordings have it: `/turtle1/pose`."""
    return f"/{name.lstrip('/')}"


def _sorted(ends: Mapping[str, set[str]]) -> Ends:
    return {name: sorted(nodes) for name, nodes in sorted(ends.items())}
