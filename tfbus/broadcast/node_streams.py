"""The streams of each node: one of a name, which the node's broadcasters share."""

from typing import Any

from tfbus.broadcast.stream import Stream
from tfbus.errors import InvalidArgumentException
from tfbus.node.node import Node
from tfbus.runtime import scheduler


class NodeStreams:
    """The streams of one node; it finds them again among the node's describers."""

    def __init__(self) -> None:
        self._lock = scheduler.Lock()
        self._by_name: dict[str, Stream] = {}

    @classmethod
    def of(cls, node: Node) -> "NodeStreams":
        """The streams of the node, made at the first call."""
        if (found := cls._found(node)) is not None:
            return found
        made = cls()
        node.describers.append(made)
        # Of two threads that come here at once both take the first.
        found = cls._found(node)
        if found is not made:
            node.describers.remove(made)
        return found or made

    @classmethod
    def _found(cls, node: Node) -> "NodeStreams | None":
        return next((each for each in [*node.describers] if isinstance(each, cls)), None)

    def get(self, node: Node, name: str) -> Stream:
        """The node's stream of this name, made at the first call."""
        with self._lock:
            if name not in self._by_name:
                self._by_name[name] = Stream(
                    name, node.full_name, node.started_ns, node.session, node.executor, node.log
                )
            return self._by_name[name]

    def reopen(self, node: Node, name: str, origin: tuple[str, ...]) -> Stream:
        """A new stream of this name and origin, whose first epoch begins now, in place of a former
        one.
        """
        self.close(name)
        with self._lock:
            stream = self._by_name[name] = Stream(
                name,
                node.full_name,
                scheduler.time_ns(),
                node.session,
                node.executor,
                node.log,
                origin=origin,
            )
            return stream

    def close(self, name: str) -> None:
        """End the stream of this name, if there is one."""
        with self._lock:
            stream = self._by_name.pop(name, None)
        if stream is not None:
            stream.close()

    def __call__(self) -> dict[str, list[Any]]:
        """The streams in the node's description of itself."""
        streams = dict(self._by_name)
        return {
            "streams": sorted(streams),
            "unread": sorted(name for name, stream in streams.items() if stream.unread),
        }


def stream_of_node(node: Node, name: str | None = None) -> Stream:
    """The stream of this name that the node publishes; of the node's own name if it is None."""
    if not hasattr(node, "describers"):
        raise InvalidArgumentException(
            "a broadcaster takes a Node, as in TransformBroadcaster(node), not "
            f"{type(node).__name__}"
        )
    return NodeStreams.of(node).get(node, name or node.name)
