"""The nodes as Foxglove's panels show them: the graph of topics and services, and parameters."""

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from dataclasses import dataclass, field
from typing import Any

from tfbus.base.callbacks import Workers
from tfbus.base.errors import TfbusError
from tfbus.base.wording import printable
from tfbus.bus.graph import graph_of
from tfbus.foxglove.protocol import ShownParameter, text
from tfbus.streams.info import StreamInfo
from tfbus.wire.descriptions import NodeDescription, ParameterDescription, StreamDescription

Ends = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Connections:
    """The full names of the nodes at the ends of topics and services."""

    published: Ends = field(default_factory=dict)
    subscribed: Ends = field(default_factory=dict)
    served: Ends = field(default_factory=dict)


def connections(
    nodes: Collection[NodeDescription], streams: Iterable[StreamDescription | StreamInfo]
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


def graph_update(former: Connections, now: Connections) -> str:
    """The changes from one graph to another, as a message."""
    topics = former.published.keys() | former.subscribed.keys()
    left = now.published.keys() | now.subscribed.keys()
    return text(
        "connectionGraphUpdate",
        publishedTopics=_changed(former.published, now.published, left, "publisherIds"),
        subscribedTopics=_changed(former.subscribed, now.subscribed, left, "subscriberIds"),
        advertisedServices=_changed(former.served, now.served, now.served.keys(), "providerIds"),
        removedTopics=sorted(topics - left),
        removedServices=sorted(former.served.keys() - now.served.keys()),
    )


def _changed(
    former: Mapping[str, Sequence[str]],
    now: Mapping[str, Sequence[str]],
    left: Collection[str],
    ids: str,
) -> list[dict[str, object]]:
    """The names whose ends changed; a topic that has lost one kind of ends has none of it."""
    names = sorted((former.keys() | now.keys()) & set(left))
    return [
        {"name": name, ids: list(now.get(name, ()))}
        for name in names
        if former.get(name, ()) != now.get(name, ())
    ]


def absolute(name: str) -> str:
    """The name of a topic or service as ROS, Foxglove and recordings have it: `/turtle1/pose`."""
    return f"/{name.lstrip('/')}"


def _sorted(ends: Mapping[str, set[str]]) -> Ends:
    return {name: sorted(nodes) for name, nodes in sorted(ends.items())}


# A client gets its answer by then: a later one is published.
_WAIT_S = 0.2

_AT_A_TIME = 4
_WAITING = 64


class NodeParameters:
    """The parameters of nodes by names like `/sim.background_r`, as of the last `update`.

    `set_one(node, name, value)` sets one and returns it; it may take a moment, and raises
    TfbusError if it cannot. `publish(parameters)` gets changed ones, `say(text)` why one is not
    set.
    """

    def __init__(
        self,
        set_one: Callable[[str, str, object], ParameterDescription],
        publish: Callable[[Sequence[ShownParameter]], None],
        say: Callable[[str], None],
    ) -> None:
        self._set_one = set_one
        self._publish = publish
        self._say = say
        self._workers = Workers("foxglove parameters", threads=_AT_A_TIME, waiting=_WAITING)
        self._lock = threading.Lock()
        self._known: dict[str, tuple[str, ParameterDescription]] = {}

    def update(self, nodes: Iterable[NodeDescription]) -> None:
        """Take the parameters from the descriptions of all nodes; publish changed ones."""
        known = {
            f"{node.name}.{each.name}": (node.name, each)
            for node in nodes
            for each in node.parameters
        }
        with self._lock:
            former, self._known = self._known, known
        changed = [name for name, now in known.items() if former.get(name) != now]
        gone = [ShownParameter(name) for name in former.keys() - known.keys()]
        if changed or gone:
            self._publish([*(_shown(name, known[name][1]) for name in changed), *gone])

    def get(self, names: Sequence[str]) -> list[ShownParameter]:
        """These parameters; all if no name is given. Unknown ones are left out."""
        known = self._present()
        return [
            _shown(name, known[name][1])
            for name in (dict.fromkeys(names) if names else sorted(known))
            if name in known
        ]

    def publish(self, names: Sequence[str]) -> None:
        """Publish the parameters of these names; unknown names are left out."""
        if found := self.get(names) if names else []:
            self._publish(found)

    def set(self, given: Sequence[ShownParameter]) -> list[ShownParameter]:
        """Set parameters; returns the new values from nodes that answer soon."""
        until_s = time.monotonic() + _WAIT_S
        if len(given) > _WAITING:
            self._say(f"at most {_WAITING} parameters are set at a time, not {len(given)}")
            return []
        answers = [self._begin(each) for each in given]
        done = []
        for answer in answers:
            try:
                found = answer.result(max(0.0, until_s - time.monotonic()))
            except LateError:
                answer.add_done_callback(self._publish_late)
                continue
            if found is not None:
                done.append(found)
        return done

    def _begin(self, given: ShownParameter) -> "Future[ShownParameter | None]":
        answer: Future[ShownParameter | None] = Future()
        if not self._workers.do(lambda: answer.set_result(self._set(given))):
            self._say(f"{printable(given.name)} is not set: too many parameters at once")
            answer.set_result(None)
        return answer

    def _set(self, given: ShownParameter) -> ShownParameter | None:
        """Set one; returns it as it is then, None if it is not known."""
        name = given.name
        if name not in self._present():
            self._say(f"there is no parameter {printable(name)}")
            return None
        node, described = self._present()[name]
        try:
            value = _typed(given.value, described)
            described = self._set_one(node, described.name, value)
        except (TfbusError, OverflowError, TypeError, ValueError) as error:
            # Clients show the value that they asked for until they get the present one.
            self._say(f"{name} is not set: {error}")
        with self._lock:
            self._known = {**self._known, name: (node, described)}
        return _shown(name, described)

    def _publish_late(self, answer: "Future[ShownParameter | None]") -> None:
        """Parameters returned in time the server publishes itself."""
        if (found := answer.result()) is not None:
            self._publish([found])

    def _present(self) -> Mapping[str, tuple[str, ParameterDescription]]:
        with self._lock:
            return self._known


def _typed(value: Any, described: ParameterDescription) -> Any:
    """The value, as an integer if it is a whole number and the parameter is one."""
    whole = isinstance(value, float) and value.is_integer() and described.type == "integer"
    return int(value) if whole else value


def _shown(name: str, described: ParameterDescription) -> ShownParameter:
    try:
        return ShownParameter(name, value=described.value)
    except (OverflowError, TypeError, ValueError, UnicodeError):
        return ShownParameter(name, value=printable(repr(described.value), 1000))
