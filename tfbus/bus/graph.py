"""The graph of nodes: topics, services and actions, and which nodes are at their ends; and which
namespaces have a frame.

It is made from the descriptions of nodes and streams, without reading messages.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from tfbus.base.wording import natural_order, printable
from tfbus.wire.descriptions import FLOAT64, NodeDescription, StreamDescription
from tfbus.wire.keys import relative, relative_name

# At most this many namespaces are named in a hint.
_NAMED = 3

# The type of messages on the keys of transforms.
TRANSFORMS_TYPE = "TransformMessage"


@dataclass(frozen=True, order=True)
class Endpoint:
    """An end of a topic, service or action: the full name of the node, and its type there."""

    node: str
    type: str
    host: str = ""
    pid: int = 0
    # Of a publisher: whether its last message also reaches subscribers that join later.
    retained: bool = False
    # Of a subscription whose messages wait for transforms: its counts, as a sentence.
    filtered: str = ""
    # Of a publisher of dynamic transforms: how precise they are, "" for exact ones.
    poses: str = ""


@dataclass(frozen=True)
class TopicInfo:
    """A topic by its name relative to the viewing namespace, and its ends sorted by node.

    Nodes do not list the transforms that they receive: `subscribers` is None for their topics.
    """

    name: str
    publishers: tuple[Endpoint, ...] = ()
    subscribers: tuple[Endpoint, ...] | None = ()

    @property
    def types(self) -> tuple[str, ...]:
        """The types at its ends, sorted: one if they agree."""
        return _types(self.publishers, self.subscribers or ())

    @property
    def retained(self) -> bool:
        """Whether a publisher's last message also reaches subscribers that join later."""
        return any(end.retained for end in self.publishers)


@dataclass(frozen=True)
class ServiceInfo:
    """A service or action by its name relative to the viewing namespace, and its ends."""

    name: str
    servers: tuple[Endpoint, ...] = ()
    clients: tuple[Endpoint, ...] = ()

    @property
    def types(self) -> tuple[str, ...]:
        """The types at its ends, sorted: one if they agree."""
        return _types(self.servers, self.clients)


@dataclass(frozen=True)
class Graph:
    """All topics and services by name, sorted."""

    topics: Mapping[str, TopicInfo] = field(default_factory=dict)
    services: Mapping[str, ServiceInfo] = field(default_factory=dict)


def graph_of(
    nodes: Iterable[NodeDescription],
    streams: Mapping[str, StreamDescription],
    namespace: str = "",
) -> Graph:
    """The graph as seen from the namespace; `streams` as `ask_streams` returns them."""
    ends: dict[str, dict[str, list[Endpoint]]] = defaultdict(lambda: defaultdict(list))
    for node in nodes:
        above = relative_name(node.name, namespace).rpartition("/")[0]
        for kind in ("publishes", "subscribes", "serves", "calls"):
            for name, type_ in getattr(node, kind).items():
                full = relative(
                    name if name.startswith("/") else "/".join(filter(None, (above, name))),
                    namespace,
                )
                retained = kind == "publishes" and name in node.retained
                filtered = [str(each) for each in node.filters if each.topic == name]
                end = Endpoint(
                    node.name,
                    type_,
                    node.host,
                    node.pid,
                    retained,
                    "; ".join(filtered if kind == "subscribes" else ()),
                )
                ends[kind][full].append(end)

    def at(kind: str, name: str) -> tuple[Endpoint, ...]:
        return tuple(sorted(ends[kind].get(name, ())))

    topics = {
        name: TopicInfo(name, at("publishes", name), at("subscribes", name))
        for name in {*ends["publishes"], *ends["subscribes"]}
    }
    for key, stream in streams.items():
        for name in _stream_topics(key, stream):
            by, host = printable(stream.node), printable(stream.host)
            is_exact = stream.poses == FLOAT64 or "tf_static" in name.split("/")
            poses = "" if is_exact else printable(stream.poses)
            end = Endpoint(by, TRANSFORMS_TYPE, host, stream.pid, poses=poses)
            topics[name] = TopicInfo(name, (end,), None)
    services = {
        name: ServiceInfo(name, at("serves", name), at("calls", name))
        for name in {*ends["serves"], *ends["calls"]}
    }
    return Graph(dict(sorted(topics.items())), dict(sorted(services.items())))


def _stream_topics(key: str, stream: StreamDescription) -> list[str]:
    """`robot7/tf/sim` and `robot7/tf_static/sim` of the stream at `robot7/@tfbus/stream/sim`."""
    kinds = {"tf_static" if static else "tf" for _, _, static in stream.frames}
    return [printable(key.replace("@tfbus/stream", kind)) for kind in kinds]


def _types(*ends: Iterable[Endpoint]) -> tuple[str, ...]:
    return tuple(sorted({end.type for side in ends for end in side} - {""}))


def where_to_look(frames_in_other_namespaces: Collection[tuple[str, str]], frame: str = "") -> str:
    """A hint which namespaces have this frame, or any frame, and how to look there; "" for none.

    The frame goes by its own name, or by that in a fleet: `robot7/base_link`.
    """
    having = {
        namespace
        for namespace, name in frames_in_other_namespaces
        if not frame or frame in (name, f"{namespace}/{name}")
    }
    if not having:
        return ""
    known = f"{frame!r} is" if frame else "frames are"
    if "" in having:
        return f"{known} known outside of this namespace: look without --namespace"
    named = " or ".join(sorted(having, key=natural_order)[:_NAMED])
    return f"{known} known in other namespaces: look with --namespace {named}, or with --fleet"
