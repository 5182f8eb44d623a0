"""Publishers in ROS that have sent transforms, and their streams on the bus."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from tfbus.base import scheduler
from tfbus.base.errors import RightsError
from tfbus.base.wording import is_printable, printable, quoted
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.node.node import Node
from tfbus.ros.bridge.common import Common
from tfbus.ros.bridge.routes import RateLimit, Routes
from tfbus.streams.sender import StreamOptions, TransformSender
from tfbus.streams.stream import NodeStreams, Stream
from tfbus.streams.stream_facts import lines_of
from tfbus.wire.keys import escape


class RosStream:
    """The transforms of one node of ROS, as a stream of the bus; used by one thread at a time.

    It begins with the first transform. `gids` are the publishers that have sent.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self.gids: set[str] = set()
        self._node = node
        self._streams = NodeStreams.of_node(node)
        self._stream: Stream | None = None
        self._sender: TransformSender | None = None
        self._statics: dict[str, TransformStamped] = {}
        self._origin: tuple[str, ...] = ()

    @property
    def is_open(self) -> bool:
        """Whether it is on the bus."""
        return self._stream is not None

    @property
    def since(self) -> tuple[int, str]:
        """When it began, in ns, later than any other if it has not; and the session."""
        session = self._node.session.id
        return (2**63 if self._stream is None else self._stream.started_ns, session)

    def say_origin(self, gids: tuple[str, ...]) -> None:
        """Say on the bus which publishers it stands for."""
        self._origin = gids
        if self._stream is not None:
            self._stream.origin = gids

    def send(self, rows: Columns) -> None:
        """Send dynamic transforms. Raises TfbusError if they cannot be sent."""
        self._sending().send(rows)

    def send_pose(self, frames: tuple[str, ...], stamp_ns: int, pose: bytes) -> None:
        """Send a dynamic transform, as `TransformSender.send_pose`. Raises as `send`."""
        (self._sender or self._sending()).send_pose(frames, stamp_ns, pose)

    def set_statics(self, transforms: Mapping[str, TransformStamped]) -> None:
        """Send these static transforms, by their child frames, in place of the former ones. Raises
        TfbusError if they cannot be sent.
        """
        new = {
            child: each for child, each in transforms.items() if self._statics.get(child) != each
        }
        left = self._statics.keys() - transforms.keys()
        if new:
            self._opened().send_static(new.values())
            self._statics |= new
        if left and self._stream is not None:
            for child in left:
                del self._statics[child]
            self._stream.remove_static(*left)

    def becomes_dynamic(self, child: str) -> None:
        """A static frame comes as a dynamic one now."""
        self._statics.pop(child, None)

    def close(self) -> None:
        """Its node is gone: listeners mark its frames so. Twice is fine; sending opens it again."""
        if self._stream is not None:
            self._streams.close(self.name)
            self._stream = self._sender = None
            self._statics.clear()

    def _sending(self) -> TransformSender:
        if self._sender is None:
            self._sender = self._opened().sender(StreamOptions())
        return self._sender

    def _opened(self) -> Stream:
        if self._stream is None:
            # With its origin from the first description on: without, another bridge would take it
            # for one that does not come from ROS.
            self._stream = self._streams.reopen(self._node, self.name, self._origin)
        return self._stream


def stream_name(node: Node, ros_node: str) -> str:
    """The name of the stream for a node of ROS, by its full name: "ros2/robot_state_publisher".

    The name of the bridge's node alone if ROS does not tell, or the name cannot be shown or may not
    be used on this bus.
    """
    name = _own_name(node, ros_node)
    return name if name and not lacks_right(node, ros_node) else node.name


def lacks_right(node: Node, ros_node: str) -> str:
    """The name that the stream for a node of ROS would have, but that this identity may not use;
    "" if it may.
    """
    name = _own_name(node, ros_node)
    if name:
        try:
            node.settings.check_right("nodes", escape(name))
        except RightsError:
            return name
    return ""


def _own_name(node: Node, ros_node: str) -> str:
    name = f"{node.name}/{ros_node.strip('/')}"
    return name if ros_node.strip("/") and is_printable(name) else ""


# A message may come before ROS says who publishes it: this many are kept, for this long.
_UNKNOWN_S = 2.0
_MOST_UNKNOWN = 100

# Publishers and names come from ROS: further publishers share the stream of the bridge.
_MOST_PUBLISHERS = 1000
# Of publishers that ROS does not list, whose gids may be made up.
_MOST_UNLISTED = 100

# One that ROS does not list is gone when it has sent nothing for this long. It may send static
# transforms only, and is listed at last: by DDS after 10 s, with or without a name.
_UNLISTED_S = 20.0


@dataclass(eq=False)
class RosSource:
    """A publisher in ROS, or two of one node's, as the middleware tells them apart by `gid`."""

    gid: str
    node: str
    stream: RosStream
    routes: Routes
    limit: RateLimit | None
    # As they came last, by the names of the bus.
    statics: dict[str, TransformStamped] = field(default_factory=dict)
    children: set[str] = field(default_factory=set)
    # The children of which a transform was taken; numbers may be refused.
    taken: set[str] = field(default_factory=set)
    # When the last message came.
    heard_s: float = 0.0

    def __str__(self) -> str:
        return f"ROS node {printable(self.node)}" if self.node else "ROS"


@dataclass
class _Unknown:
    since_s: float
    messages: list[tuple[bytes, bool]] = field(default_factory=list)


class RosSources:
    """The sources; each call holds a lock of the caller's.

    `make(gid, node, stream)` is called when a publisher sends for the first time,
    `handle(source, payload, static)` with each message once it is known whose it is, and
    `on_lost(source)` when a publisher sends no longer. `tells_publishers` is whether ROS says by
    which gid a message comes; if it does not, all come by the gid "".
    """

    def __init__(
        self,
        common: Common,
        *,
        tells_publishers: bool,
        make: Callable[[str, str, RosStream], RosSource],
        handle: Callable[[RosSource, bytes, bool], object],
        on_lost: Callable[[RosSource], object],
    ) -> None:
        self._node = common.node
        self._publishers = common.publishers
        self._bus = common.bus
        self._once = common.once
        self._tells_publishers = tells_publishers
        self._make_source = make
        self._handle = handle
        self._on_lost = on_lost
        self._lines = lines_of(common.node.log)
        self._sources: dict[str, RosSource] = {}
        self.unknown: dict[str, _Unknown] = {}
        # The gids of sources that ROS did not list when they were made.
        self._unlisted: set[str] = set()
        self._streams: dict[str, RosStream] = {}
        self._alone_looks = 0
        self._standing_by: set[str] = set()

    def __iter__(self) -> Iterator[RosSource]:
        return iter([*self._sources.values()])

    @property
    def streams(self) -> Iterable[RosStream]:
        """The streams, open or not."""
        return self._streams.values()

    def of_stream(self, stream: RosStream) -> list[RosSource]:
        """The sources that share a stream."""
        return [each for each in self if each.stream is stream]

    def on_message(self, payload: bytes, gid: str, *, static: bool) -> None:
        """Hand a message over with its source, now or once ROS says whose it is."""
        source = self._sources.get(gid) or self._meet(gid)
        if source is None:
            messages = self.unknown[gid].messages
            if len(messages) < _MOST_UNKNOWN:
                messages.append((payload, static))
            else:
                self._once.warning(
                    ("unknown", gid),
                    "Dropped messages of publisher %s, which ROS does not name yet: %d are kept",
                    printable(gid, 60),
                    _MOST_UNKNOWN,
                )
        else:
            self._hand_over(source, payload, static)

    def poll(self, gone: Collection[str]) -> None:
        """Update the sources, of which these publishers are gone; call it every second."""
        self._lose(gone)
        self._lose(self._silent())
        for gid in [*self.unknown]:
            self._meet(gid)
        self._take_late_names()
        self._look_whether_alone()
        self._say_origins()

    def stand_by(self) -> None:
        """Another bridge that was there first carries some of the publishers: this one need not."""
        for stream in self._streams.values():
            if stream.is_open and not self.may_send(stream):
                stream.close()

    def may_send(self, stream: RosStream) -> bool:
        """Whether no other bridge, which was there first, carries the publishers of a stream."""
        other = self._bus.imported_by_another(stream.gids - {""}, stream.since)
        if not other:
            self._standing_by.discard(stream.name)
        elif stream.name not in self._standing_by:
            self._standing_by.add(stream.name)
            self._node.log.info(
                "Stream %r of another bridge brings what this one would as %r: it stands by",
                other,
                stream.name,
            )
        return not other

    def close(self) -> None:
        """End all streams."""
        for source in self:
            self._drop(source.gid)

    # Who comes

    def _meet(self, gid: str) -> RosSource | None:
        """A publisher that is new; None if ROS does not tell yet whose it is."""
        node: str | None = ""
        unknown = self.unknown.get(gid)
        is_kept = bool(gid)
        if gid:
            is_full = len(self.unknown) + len(self._unlisted) >= _MOST_UNLISTED
            may_wait = unknown is not None or not is_full
            node = self._publishers.find_node(gid) if may_wait else self._publishers.nodes.get(gid)
            is_kept = len(self._sources) < _MOST_PUBLISHERS and (node is not None or may_wait)
        if is_kept and node is None:
            if unknown is None:
                unknown = self.unknown[gid] = _Unknown(scheduler.monotonic())
            if scheduler.monotonic() < unknown.since_s + _UNKNOWN_S:
                return None
            self._unlisted.add(gid)
        self.unknown.pop(gid, None)
        if is_kept:
            source = self._make(gid, node or "")
        else:
            source = self._sources.get("") or self._make("", "")
        for payload, static in unknown.messages if unknown else ():
            self._hand_over(source, payload, static)
        return source

    def _hand_over(self, source: RosSource, payload: bytes, static: bool) -> None:
        source.heard_s = scheduler.monotonic()
        self._handle(source, payload, static)

    def _make(self, gid: str, node: str) -> RosSource:
        name = stream_name(self._node, node)
        if unused := lacks_right(self._node, node):
            self._once.warning(
                "right",
                "This identity may not publish stream '%s': nodes of ROS share stream '%s'. Give "
                "it nodes: ['%s*'] in rights.yaml",
                printable(unused, 60),
                name,
                name,
            )
        former = self._streams.get(name)
        if former is not None and node:
            for each in self._publishers.replaced_by(gid, former.gids - {""}):
                self._drop(each)
        stream = self._streams.setdefault(name, RosStream(self._node, name))
        stream.gids.add(gid)
        source = self._sources[gid] = self._make_source(gid, node, stream)
        self._say_origins()
        return source

    def _take_late_names(self) -> None:
        """The name of a node may come long after its messages: then they get its stream."""
        nodes = self._publishers.nodes
        for source in self:
            node = nodes.get(source.gid)
            if source.node or not source.gid or not node:
                continue
            former = source.stream
            if stream_name(self._node, node) == former.name:
                source.node = node
                continue
            self._drop(source.gid)
            if former.gids:
                # Its frames leave that stream: other transforms there go on in a new epoch.
                former.close()
            named = self._make(source.gid, node)
            named.statics, named.heard_s = source.statics, source.heard_s

    def _say_origins(self) -> None:
        nodes = self._publishers.nodes
        own: dict[str, set[str]] = {}
        for gid, node in nodes.items():
            own.setdefault(stream_name(self._node, node), set()).add(gid)
        for name, stream in self._streams.items():
            all_of_it = nodes.keys() if "" in stream.gids and not self._tells_publishers else ()
            gids = stream.gids | own.get(name, set()) | set(all_of_it)
            stream.say_origin(tuple(sorted(gids - {""})))

    # Who goes

    def _silent(self) -> list[str]:
        """The publishers that ROS does not list, and that send nothing."""
        nodes = self._publishers.nodes
        self._unlisted -= nodes.keys()
        before_s = scheduler.monotonic() - _UNLISTED_S
        found = [gid for gid in self._unlisted if self._sources[gid].heard_s < before_s]
        shared = self._sources.get("")
        # With a listed one that has no source of its own it may stand for that.
        if shared and self._tells_publishers and nodes.keys() <= self._sources.keys():
            found += [""] if shared.heard_s < before_s else []
        return found

    def _look_whether_alone(self) -> None:
        """If messages do not tell their publishers, they are gone when all are."""
        if "" in self._sources and not self._tells_publishers:
            self._alone_looks = 0 if self._publishers.nodes else self._alone_looks + 1
            if self._alone_looks == 2:
                self._drop("")

    def _lose(self, gids: Collection[str]) -> None:
        """Drop gone publishers; transforms of others of the same node go on in a new epoch."""
        lost: dict[str, tuple[RosSource, set[str]]] = {}
        for gid in gids:
            self.unknown.pop(gid, None)
            source = self._sources.get(gid)
            if source is not None:
                self._drop(gid)
                _, children = lost.setdefault(source.stream.name, (source, set()))
                children |= source.taken
        for source, children in lost.values():
            if source.stream.gids:
                source.stream.close()
            elif children:
                self._lines.warning(
                    ("gone", source.node),
                    "%s is gone; its last transforms stay, marked as gone: %s",
                    source,
                    quoted(sorted(children)),
                )

    def _drop(self, gid: str) -> None:
        source = self._sources.pop(gid, None)
        if source is None:
            return
        self._unlisted.discard(gid)
        if source.limit is not None:
            source.limit.close()
        stream = source.stream
        stream.gids.discard(gid)
        self._on_lost(source)
        if not stream.gids:
            stream.close()
            self._streams.pop(stream.name, None)
