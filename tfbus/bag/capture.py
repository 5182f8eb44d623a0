"""Capture of all that is on the bus, or of a part: bytes into a queue, and events."""

import socket
from collections.abc import Callable
from functools import partial
from hashlib import blake2b
from itertools import chain
from typing import Any, Literal

from tfbus.bag.raw_queue import EVENTS, FullNames, RawQueue, TopicSource, TransformSource
from tfbus.base.errors import InvalidNameError
from tfbus.base.log import LogOnce
from tfbus.base.wording import is_printable
from tfbus.bus.graph import TopicInfo, graph_of
from tfbus.bus.graph_watch import GraphWatch
from tfbus.bus.network_session import Declaration
from tfbus.bus.retained import declare_retained_subscriber
from tfbus.bus.ros_types import RosTypes
from tfbus.node.node import Node
from tfbus.node.topic import RawSubscription
from tfbus.recording.items import EventItem, EventKind, Selection, is_of_transforms
from tfbus.ros.schema import MessageCodec
from tfbus.streams.info import MOST_GONE, StreamState
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import as_map, decode_message, is_of_ros
from tfbus.wire.descriptions import (
    NodeDescription,
    StreamDescription,
    facts_of_stream,
    read_description,
)
from tfbus.wire.keys import (
    ALL_STATIC_TRANSFORMS,
    ALL_STATIC_TRANSFORMS_EVERYWHERE,
    ALL_TRANSFORMS,
    ALL_TRANSFORMS_EVERYWHERE,
    STATIC_TRANSFORMS,
    check_no_transforms,
    is_foreign,
    namespace_of,
    relative,
    static_transforms_key_beside,
    stream_of,
    transforms_key_beside,
)
from tfbus.wire.limits import kind_of
from tfbus.wire.transforms import TransformReader

# Keys and names come from the bus: at most as many are recorded, and remembered as not recorded.
MOST_KEYS = 200_000
_MOST_REFUSED = 10_000
_MOST_TOPICS = 10_000


class Capture:
    """Puts the selected messages and events into a queue, from its construction until `close()`.

    It takes the streams, nodes and topics of the node's namespace, with `everywhere` also of
    all namespaces below. Streams and nodes become events as they come, change and go. It takes all
    topics that nodes publish or receive, or that the selection names.
    `on_stream(state)` is called after each change of a stream that is taken, and
    `on_lost(name, is_here)` for the full name of a stream or node that is gone, and whether its
    host has the name of this one.
    """

    def __init__(
        self,
        node: Node,
        queue: RawQueue,
        selection: Selection,
        *,
        everywhere: bool = False,
        on_stream: Callable[[StreamState], None] = lambda state: None,
    ) -> None:
        self.names = FullNames(node.namespace)
        # By the full names of streams and topics.
        self.described: dict[str, StreamDescription] = {}
        self.types: dict[str, str] = {}
        self.codecs: dict[str, MessageCodec] = {}
        self.on_lost: Callable[[str, bool], object] = lambda name, is_here: None
        self._nodes: set[str] = set()
        self._node = node
        self._queue = queue
        self._selection = selection
        self._on_stream = on_stream
        self._once = LogOnce(node.log)
        self._ros_types = RosTypes(node.session)
        self._reader = TransformReader()
        self._sources: dict[str, TransformSource] = {}
        # Keys whose messages are not recorded.
        self._refused: set[str] = set()
        self._last_statics: dict[str, bytes] = {}
        self._states: dict[str, StreamState] = {}
        self._declarations: list[Declaration] = []
        # Of the streams that are subscribed to one by one, by their full names.
        self._subscribed: dict[str, list[Declaration]] = {}
        self._topics: dict[str, RawSubscription] = {}
        self._topic_sources: dict[str, TopicSource] = {}
        for topic in selection.topics:
            if not is_of_transforms(topic):
                self._subscribe_topic(f"/{topic}", topic, "")
        self._is_narrow = selection != Selection()
        if not self._is_narrow:
            dynamic, static = (
                (ALL_TRANSFORMS_EVERYWHERE, ALL_STATIC_TRANSFORMS_EVERYWHERE)
                if everywhere
                else (ALL_TRANSFORMS, ALL_STATIC_TRANSFORMS)
            )
            self._declarations = self._subscribe(dynamic, static)
        self._streams = StreamWatch(
            node.session, self._on_state, everywhere=everywhere, log=node.log
        )
        self._graph = GraphWatch(
            node.session, node.log, everywhere=everywhere, on_change=self._on_node
        )

    def close(self) -> None:
        """Take nothing further. Twice is fine."""
        self._streams.close()
        self._graph.close()
        for declaration in chain(self._declarations, *self._subscribed.values()):
            declaration.close()
        for topic in self._topics.values():
            topic.close()

    def source(self, key: str, *, static: bool = False) -> TransformSource | None:
        """The kind of the messages of a key of transforms; None if they are not recorded."""
        found = self._sources.get(key)
        if found is not None or key in self._refused:
            return found
        source = self._meet(key, static)
        if source is not None:
            self._sources[key] = source
            return source
        if len(self._refused) >= _MOST_REFUSED:
            self._refused.clear()
        self._refused.add(key)
        return None

    # Messages of before, from who has kept them

    def knows(self, name: str) -> bool:
        """Whether a stream or node of this full name is there."""
        if name.startswith("/"):
            return name in self._nodes
        return name in self._states and self._states[name].alive

    def late_source(self, key: str) -> TransformSource | TopicSource | None:
        """The kind of the messages of any key; None if they are not recorded."""
        kind = kind_of(key)
        if kind == "transforms":
            return self.source(key, static=STATIC_TRANSFORMS in key.split("/"))
        name = self.names.full(key)
        if kind != "topic" or not is_printable(name) or not self._selection.takes_topic(name):
            return None
        if name not in self._topic_sources and len(self._topic_sources) >= 2 * _MOST_TOPICS:
            return None
        return self._topic_source(name)

    def late_facts(
        self, kind: Literal["stream", "node"], name: str, payload: bytes
    ) -> dict[str, Any]:
        """The facts of a description of before, which is noted if there is none. Raises DecodeError
        if it cannot be read.
        """
        if kind == "stream":
            stream, _ = read_description(payload)
            if len(self.described) < MOST_KEYS:
                self.described.setdefault(name, stream)
            return facts_of_stream(stream)
        node = decode_message(NodeDescription, payload)
        for topic, type_name in node.publishes.items():
            if len(self.types) < _MOST_TOPICS:
                self.types.setdefault(topic.removeprefix("/"), type_name)
        return as_map(node)

    def _topic_source(self, name: str, *, retained: bool = False) -> TopicSource:
        source = self._topic_sources.get(name)
        if source is None or source.is_essential is not retained:
            source = self._topic_sources[name] = TopicSource(
                name, self.types, self.codecs, retained=retained, on_unfit=self._on_unfit
            )
        return source

    # Transforms

    def _subscribe(self, dynamic: str, static: str) -> list[Declaration]:
        """Subscribe to keys of dynamic and static transforms; "" for none."""
        session = self._node.session
        declared: list[Declaration] = []
        if static:
            declared.append(declare_retained_subscriber(session, static, self._on_static))
        if dynamic:
            declared.append(session.subscriber(dynamic, self._on_transforms))
        return declared

    def _on_transforms(self, key: str, payload: bytes) -> None:
        source = self._sources.get(key)
        if source is None and not is_of_ros(payload):
            source = self.source(key)
        if source is not None:
            self._queue.put(source, payload)

    def _on_static(self, key: str, payload: bytes) -> None:
        source = self.source(key, static=True)
        # A retained set comes again when a link is back.
        if source is None:
            return
        digest = blake2b(payload, digest_size=16).digest()
        if self._last_statics.get(key) != digest and self._queue.put(source, payload):
            self._last_statics[key] = digest

    def _meet(self, key: str, static: bool) -> TransformSource | None:
        if is_foreign(key):
            return None
        name = stream_of(key)
        if not is_printable(name):
            self._once.warning(
                "name", "Did not record a stream: its name %r cannot be shown", name[:300]
            )
            return None
        if not self._selection.takes_transforms(self.names.full(name), static=static):
            return None
        if len(self._sources) >= MOST_KEYS:
            self._forget_undescribed()
        if len(self._sources) >= MOST_KEYS:
            self._once.warning(
                "keys", "Did not record %r: transforms come on more than %d keys", key, MOST_KEYS
            )
            return None
        return TransformSource(
            self.names.full(name),
            self.names.namespace(namespace_of(key)),
            self.described,
            self._reader,
            static=static,
        )

    # Streams

    def _on_state(self, state: StreamState) -> None:
        name = self.names.full(state.name)
        if not self._selection.takes_stream(name):
            return
        former = self._states.get(name, StreamState(name))
        if len(self._states) > 2 * MOST_GONE:
            self._forget_gone()
        self._states[name] = state
        if state.description is not None:
            self.described[name] = state.description
        if self._is_narrow and state.alive:
            self._subscribe_stream(name, state.key)
        if state.alive and state.description is not None:
            if not former.alive or former.description != state.description:
                self._enqueue_event("stream", name, state.description)
        elif former.alive and former.description is not None:
            self._enqueue_event("stream gone", name)
            self.on_lost(name, former.description.host == socket.gethostname())
        self._on_stream(state)

    def _subscribe_stream(self, name: str, key: str) -> None:
        if name not in self._subscribed:
            takes = partial(self._selection.takes_transforms, name)
            self._subscribed[name] = self._subscribe(
                f"{transforms_key_beside(key)}/**" if takes(static=False) else "",
                static_transforms_key_beside(key) if takes(static=True) else "",
            )

    def _forget_gone(self) -> None:
        """Forget the streams that are gone, as the watch does if they are many."""
        for name in [name for name, state in self._states.items() if not state.alive]:
            del self._states[name]
            self.described.pop(name, None)
            for declaration in self._subscribed.pop(name, []):
                declaration.close()
        self._forget_undescribed()

    def _forget_undescribed(self) -> None:
        self._refused.clear()
        for key, source in list(self._sources.items()):
            if source.name not in self.described:
                self._sources.pop(key, None)
                self._last_statics.pop(key, None)

    def _enqueue_event(
        self,
        kind: EventKind,
        name: str,
        description: StreamDescription | NodeDescription | None = None,
    ) -> None:
        if isinstance(description, StreamDescription):
            facts = facts_of_stream(description)
        else:
            facts = {} if description is None else as_map(description)
        self._queue.put(EVENTS, EventItem(0, kind, name, facts))

    # Nodes and topics

    def _on_node(self, name: str, description: NodeDescription | None) -> None:
        if description is None:
            self._enqueue_event("node gone", name)
            self._nodes.discard(name)
            self.on_lost(name, False)
            return
        self._nodes.add(name)
        self._enqueue_event("node", name, description)
        graph = graph_of([description], {}, self._node.namespace)
        self._ros_types.forget(name)
        taken = [
            (self.names.full(topic), info)
            for topic, info in graph.topics.items()
            if self._take_topic(topic, info)
        ]
        # Messages wait for the types, which take a moment.
        for topic, info in taken:
            self._note_type(topic, info)

    def _take_topic(self, topic: str, info: TopicInfo) -> bool:
        """Subscribe to a topic if it is selected; whether it is."""
        name = self.names.full(topic)
        if not self._selection.takes_topic(name):
            return False
        self._subscribe_topic(topic, name, _type_of(info), retained=info.retained)
        return name in self._topics

    def _note_type(self, name: str, info: TopicInfo) -> None:
        type_name = _type_of(info)
        for end in info.publishers:
            if (codec := self._ros_types.codec(end.node, end.type)) is not None:
                self.codecs[name] = codec
        if type_name or name not in self.types:
            self.types[name] = type_name

    def _on_unfit(self, name: str) -> None:
        self._once.warning(
            ("unfit", name),
            "A message on topic %r is not of its type %s: recorded with the fields that it has",
            name,
            self.types.get(name, ""),
        )

    def _subscribe_topic(
        self, topic: str, name: str, type_name: str, *, retained: bool = False
    ) -> None:
        known = self._topics.get(name)
        if known is not None and known.retained >= retained:
            known.type_name = known.type_name or type_name
            return
        if known is not None:
            # Its publisher came after its subscribers, and says now that it is retained.
            self._topics.pop(name).close()
        if len(self._topics) >= _MOST_TOPICS:
            self._once.warning(
                "topics", "Did not record topic %r: there are more than %d", name, _MOST_TOPICS
            )
            return
        put = partial(self._queue.put, self._topic_source(name, retained=retained))
        try:
            topic = check_no_transforms(relative(topic, self._node.namespace))
            self._topics[name] = self._node.create_raw_subscription(
                topic, put, type_name=type_name, retained=retained
            )
        except InvalidNameError as error:
            self._once.warning("topic", "Did not record a topic: %s", error)


def _type_of(info: TopicInfo) -> str:
    """The type that its first publisher says, else its first subscriber."""
    return next((end.type for end in (*info.publishers, *(info.subscribers or ()))), "")
