"""Which nodes, topics and services there are, by the names that ROS has for them."""

from collections.abc import Iterable, Mapping

from tfbus.discover.graph import TRANSFORMS_TYPE, Graph, TopicInfo
from tfbus.discover.presence import ask_graph, ask_nodes
from tfbus.node.action import CancelGoal
from tfbus.node.node import Node as TfbusNode
from tfbus.ros.counterparts import LIVE_COUNTERPARTS
from tfbus.ros.definitions import TF_MESSAGE, interfaces_of

NamesAndTypes = list[tuple[str, list[str]]]

# Of these packages tfbus has services of its own, under the names in ROS.
_OURS = ("turtlesim", "std_srvs")


class NodeGraph:
    """The nodes, topics and services on the bus; each call asks all nodes."""

    def __init__(self, node: TfbusNode) -> None:
        self._node = node

    def nodes(self) -> list[tuple[str, str]]:
        """The names of nodes, each with its namespace, `/` for none."""
        names = sorted({each.name for each in ask_nodes(self._node.session).nodes})
        parts = (each.strip("/").rpartition("/") for each in names)
        return [(name, f"/{above}") for above, _, name in parts]

    def topics(self) -> NamesAndTypes:
        """The full names of topics, sorted, each with its types."""
        found: dict[str, set[str]] = {}
        for name, topic in self._graph().topics.items():
            if TRANSFORMS_TYPE in topic.types:
                # Each stream is a topic on the bus; in ROS they are one.
                name, _, _ = name.rpartition("/")
            found.setdefault(self._full(name), set()).update(map(_message_in_ros, topic.types))
        return _sorted(found)

    def services(self) -> NamesAndTypes:
        """The full names of services, sorted, each with its types; an action has none."""
        found = {
            self._full(name): {_service_in_ros(each) for each in service.types}
            for name, service in self._graph().services.items()
            if service.servers and not any(map(_is_of_action, service.types))
        }
        return _sorted(found)

    def publishers(self, topic: str) -> int:
        """How many publish a topic."""
        found = self._topic(topic)
        return len(found.publishers) if found else 0

    def subscribers(self, topic: str) -> int:
        """How many subscribe to a topic."""
        found = self._topic(topic)
        return len(found.subscribers or ()) if found else 0

    def _graph(self) -> Graph:
        return ask_graph(self._node.session).graph(self._node.namespace)

    def _topic(self, name: str) -> TopicInfo | None:
        wanted = self._full(name)
        topics = self._graph().topics.items()
        return next((each for at, each in topics if self._full(at) == wanted), None)

    def _full(self, name: str) -> str:
        above = self._node.namespace
        return name if name.startswith("/") else f"/{above}/{name}" if above else f"/{name}"


def _sorted(found: Mapping[str, Iterable[str]]) -> NamesAndTypes:
    return [(name, sorted(types)) for name, types in sorted(found.items())]


def _message_in_ros(type_name: str) -> str:
    if type_name == TRANSFORMS_TYPE:
        return TF_MESSAGE.name
    ours = LIVE_COUNTERPARTS.get(type_name)
    return type_name if ours is None else ours.definition.name


def _service_in_ros(type_name: str) -> str:
    packages = [each for each in _OURS if type_name in interfaces_of(each).get("srv", ())]
    return f"{packages[0]}/srv/{type_name}" if packages else type_name


def _is_of_action(type_name: str) -> bool:
    return "/action/" in type_name or type_name == CancelGoal.__name__
