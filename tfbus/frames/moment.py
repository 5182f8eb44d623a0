"""The bus at one moment, by a listener or by a recording at a log time; every tool takes it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Protocol

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.discover.graph import Graph, ServiceInfo, TopicInfo, graph_of
from tfbus.frames.snapshot import FrameTree, Problem
from tfbus.frames.state import Fault, State, faults, silent_s, state
from tfbus.listen.info import StreamInfo
from tfbus.runtime import structs
from tfbus.wire.descriptions import NodeDescription, StreamDescription
from tfbus.wire.keys import namespace_of_node, stream_key


@dataclass(frozen=True)
class FrameStatus:
    """A frame, and how the edge to its parent comes.

    `state` is "root" (no parent), "static" or "dynamic", or the worst of its `faults`: "gone" (its
    publisher has left), "conflict" (several living publishers), "stale" (silent for longer than its
    rate allows) or "ahead" (stamped in the future). `publisher` is the stream of the last sample,
    `publishers` are all living streams that list the frame; `node` (full name) and `host` are those
    of the publisher.

    In s, None for a root or static frame and while not known: `age_s` is that of the newest stamp,
    `silent_s` the time since a sample came, `delay_s` how old samples are when they come. `rate_hz`
    is how often they come, by their stamps. `oldest_ns` and `newest_ns` are the stamps kept, in ns
    since the Unix epoch.
    """

    name: str
    parent: str | None
    state: State
    faults: tuple[Fault, ...]
    publisher: str
    publishers: tuple[str, ...]
    node: str
    host: str
    rate_hz: float | None
    age_s: float | None
    silent_s: float | None
    delay_s: float | None
    oldest_ns: int | None
    newest_ns: int | None


@dataclass(frozen=True, kw_only=True)
class BusMoment:
    """The bus at one moment, with the same contents whether it is live or recorded.

    `at_ns` is the moment, by the system's clock or as a log time, in ns since the Unix epoch, and
    `start_ns` the beginning of the recording, 0 of a live bus. `nodes` are the descriptions of
    nodes, `unanswered` the full names of others, which did not answer in time. `rejected` counts
    rejected transforms by reason, `dropped` messages that the listener dropped.
    """

    at_ns: int
    # As the listener in `namespace` has it; `elsewhere` are streams by their keys, also others.
    tree: FrameTree
    nodes: tuple[NodeDescription, ...] = ()
    unanswered: tuple[str, ...] = ()
    rejected: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    namespace: str = ""
    elsewhere: Mapping[str, StreamDescription] = field(default_factory=dict)
    start_ns: int = 0

    @property
    def now_ns(self) -> int:
        """The time with which stamps are compared, in ns: simulated, or the same as `at_ns`."""
        return self.tree.recorded_ns

    @cached_property
    def frames(self) -> Mapping[str, FrameStatus]:
        """All frames by name."""
        frames = self.tree.frames.items()
        return MappingProxyType({name: frame_status(self.tree, each) for name, each in frames})

    @property
    def streams(self) -> Mapping[str, StreamInfo]:
        """All streams by name: publishers, their clocks, and what was received of them."""
        return self.tree.streams

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """The problems of the tree of frames, the worst first."""
        return tuple(self.tree.problems())

    @property
    def conflicts(self) -> frozenset[str]:
        """The frames that two or more living streams list."""
        return self.tree.conflicts

    @property
    def clocks(self) -> Mapping[str, float]:
        """How far each publisher's clock is ahead of ours, in s, by stream, if it is known."""
        return {
            name: stream.clock_offset_s
            for name, stream in self.streams.items()
            if stream.alive and stream.clock_offset_s is not None
        }

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """The topics by name, sorted, with the nodes at their ends."""
        return self._graph.topics

    @property
    def services(self) -> Mapping[str, ServiceInfo]:
        """The services and actions by name, sorted, with the nodes at their ends."""
        return self._graph.services

    @property
    def lost(self) -> int:
        """How many messages of transforms were sent and never received, or were dropped."""
        return self.dropped + sum(stream.missed for stream in self.streams.values())

    @property
    def refused(self) -> int:
        """How many transforms were rejected, and messages that could not be read."""
        unread = sum(stream.rejected for stream in self.streams.values())
        return unread + sum(self.rejected.values())

    def since(self, before: "BusMoment") -> "BusMoment":
        """The same moment, with the counts of lost and refused transforms since an earlier one."""
        then = before.streams
        streams = {
            name: structs.replace(
                stream,
                missed=stream.missed - then[name].missed,
                rejected=stream.rejected - then[name].rejected,
            )
            if name in then
            else stream
            for name, stream in self.streams.items()
        }
        rejected = {
            reason: count - before.rejected.get(reason, 0)
            for reason, count in self.rejected.items()
            if count > before.rejected.get(reason, 0)
        }
        return replace(
            self,
            tree=replace(self.tree, streams=streams),
            rejected=rejected,
            dropped=self.dropped - before.dropped,
        )

    @property
    def node_names(self) -> frozenset[str]:
        """The full names of all nodes that are there, described or not."""
        return frozenset([*(node.name for node in self.nodes), *self.unanswered])

    def _described(self) -> dict[str, StreamDescription]:
        """The descriptions of streams by their keys: of the living ones, as far as it is known."""
        described = dict(self.elsewhere)
        for stream in self.streams.values():
            key = key_of_stream(stream.name, namespace_of_node(stream.node))
            described.pop(key, None)
            if stream.alive:
                described[key] = StreamDescription(
                    1,
                    stream.node,
                    stream.epoch_ns or 0,
                    stream.frames,
                    host=stream.host,
                    pid=stream.pid,
                )
        return described

    @cached_property
    def _graph(self) -> Graph:
        return graph_of(self.nodes, self._described(), self.namespace)


class BusView(Protocol):
    """A view of the bus that makes moments: a live listener, or a recording at a log time."""

    @property
    def buffer(self) -> Buffer:
        """The samples of the last seconds."""

    @property
    def dropped(self) -> int:
        """How many messages were dropped, since transforms came on too many keys."""

    def now_ns(self) -> int:
        """The moment, by the clock that the stamps are compared with."""

    def tree(self) -> FrameTree:
        """The tree of frames."""

    def moment(self) -> BusMoment:
        """The bus at the moment."""

    def hint(self, frame: str = "") -> str:
        """The place of a frame, or of any frame; "" if that is not known."""


def frame_status(tree: FrameTree, frame: FrameInfo) -> FrameStatus:
    """The status of a frame of this tree."""
    publisher = tree.publisher(frame)
    return FrameStatus(
        frame.name,
        frame.parent,
        state(tree, frame),
        faults(tree, frame),
        frame.authority,
        tree.publishers(frame),
        publisher.node,
        publisher.host,
        frame.rate_hz,
        tree.age_s(frame),
        silent_s(tree, frame),
        None if frame.static or frame.parent is None else publisher.delay_s,
        frame.oldest_ns,
        frame.newest_ns,
    )


def key_of_stream(name: str, namespace: str) -> str:
    """The key of a stream's description: of `robot7/sim`, of a node in `robot7`, that in there."""
    prefix = f"{namespace}/" if namespace else ""
    if not name.startswith(prefix):
        return stream_key(name)
    return prefix + stream_key(name.removeprefix(prefix))
