"""From ROS to the bus: transforms of each node of ROS, in a stream of its own."""

import threading
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from functools import partial

from tfbus.bridge.bridges import Bridges
from tfbus.bridge.bus_streams import BusStreams
from tfbus.bridge.crossed import Crossed
from tfbus.bridge.frame_names import FrameNames
from tfbus.bridge.leg import Closing, Leg, RosTopic
from tfbus.bridge.options import BridgeOptions
from tfbus.bridge.rate_limit import RateLimit
from tfbus.bridge.ros_publishers import RosPublishers
from tfbus.bridge.ros_streams import RosStream, stream_name
from tfbus.bridge.routes import Route, Routes, chosen, route
from tfbus.bridge.valid_rows import invalid_rows
from tfbus.errors import DecodeError, InvalidArgumentException, TfbusError
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.listen.claims import name_some
from tfbus.listen.reception import lines_of
from tfbus.node.node import Node
from tfbus.ros.ros_names import is_bridge
from tfbus.ros.tf_message import TFMessageReader
from tfbus.runtime.executor import Executor
from tfbus.runtime.log_once import LogOnce
from tfbus.wording import counted, printable

# A message may come before ROS says who publishes it: this many are kept, for this long.
_UNKNOWN_S = 2.0
_MOST_UNKNOWN = 100

# Publishers and names come from ROS: further publishers share the stream of the bridge.
_MOST_PUBLISHERS = 1000
# Of those that ROS does not list, whose gids may be made up.
_MOST_UNLISTED = 100

# One that ROS does not list is gone when it has sent nothing for this long. It may send static
# transforms only, and is listed at last: by DDS after 10 s, with or without a name.
_UNLISTED_S = 20.0

# Names come from ROS as well.
_MOST_STATICS = 100_000
# Of the dynamic frames of one publisher.
_MOST_FRAMES = 10_000

# A frame that another bridge sends may be one of this bus that is not known here yet.
_GRACE_S = 2.0

# A bridge that was here first sends what it has sent within this time.
_STILL_SENT_S = 3.0


@dataclass(eq=False)
class _Source:
    """A publisher in ROS, or two of one node's, as the middleware tells them apart by `gid`."""

    gid: str
    node: str
    stream: RosStream
    routes: Routes
    # As they came last, by the names of the bus.
    statics: dict[str, TransformStamped] = field(default_factory=dict)
    children: set[str] = field(default_factory=set)
    # Those of the children of which a transform was taken; numbers may be refused.
    taken: set[str] = field(default_factory=set)
    limit: RateLimit | None = None
    # When the last message came.
    heard_s: float = 0.0

    def __str__(self) -> str:
        return f"ROS node {printable(self.node)}" if self.node else "ROS"


@dataclass
class _Unknown:
    since_s: float
    messages: list[tuple[bytes, bool]] = field(default_factory=list)


class FromRos:
    """Sends on the bus what comes from ROS, until `close()`.

    `sent_there(child)` is whether this bridge sends a frame of the bus to ROS, and
    `static_there(child)` the static transform of it that it sends there.
    """

    def __init__(
        self,
        node: Node,
        leg: Leg,
        options: BridgeOptions,
        names: FrameNames,
        publishers: RosPublishers,
        bus: BusStreams,
        bridges: Bridges,
        crossed: Crossed,
        executor: Executor,
        once: LogOnce,
        *,
        sent_there: Callable[[str], bool],
        static_there: Callable[[str], TransformStamped | None],
        on_names: Callable[[], object],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.rejected = 0
        self._node = node
        self._leg = leg
        self._options = options
        self._names = names
        self._publishers = publishers
        self._bus = bus
        self._bridges = bridges
        self._crossed = crossed
        self._executor = executor
        self._once = once
        self._lines = lines_of(node.log)
        self._sent_there = sent_there
        self._static_there = static_there
        self._on_names = on_names
        self._clock_s = clock_s
        self._lock = threading.RLock()
        self._reader = TFMessageReader()
        self._sources: dict[str, _Source] = {}
        self._unknown: dict[str, _Unknown] = {}
        # The gids of sources that ROS did not list when they were made.
        self._unlisted: set[str] = set()
        self._streams: dict[str, RosStream] = {}
        # Frames that other bridges have sent: since when.
        self._met_s: dict[str, float] = {}
        # Frames that a bridge of this bus, which was there first, sends to ROS: when last.
        self._of_seniors_s: dict[str, float] = {}
        self._alone_looks = 0
        self._standing_by: set[str] = set()
        self._is_closed = False
        self._subscriptions: list[Closing] = []

    def listen(self, dynamic: RosTopic, static: RosTopic) -> None:
        """Take what comes on these topics from now on. Twice is fine."""
        if self._subscriptions:
            return
        # Of each publisher the last message with all its static transforms; some send several.
        late = replace(static, depth=100)
        self._subscriptions = [
            self._leg.subscribe(late, partial(self._on_message, True)),
            self._leg.subscribe(dynamic, partial(self._on_message, False)),
        ]

    def close(self) -> None:
        """Take nothing more, and end all streams. Twice is fine."""
        for each in self._subscriptions:
            each.close()
        with self._lock:
            self._is_closed = True
            for source in [*self._sources.values()]:
                self._drop(source.gid)

    @property
    def streams(self) -> dict[str, int]:
        """How many frames come by each stream."""
        with self._lock:
            found = {name: set[str]() for name, each in self._streams.items() if each.is_open}
            for source in self._sources.values():
                if source.stream.name in found:
                    found[source.stream.name] |= source.taken
            return {name: len(children) for name, children in found.items() if children}

    def sent_by_senior(self, child: str) -> bool:
        """Whether another bridge of this bus, which was there first, sends a frame to ROS."""
        last_s = self._of_seniors_s.get(child)
        return last_s is not None and self._clock_s() < last_s + _STILL_SENT_S

    # What changes

    def reconsider(self) -> None:
        """What is on the bus has changed, or what goes to ROS."""
        with self._lock:
            for source in self._sources.values():
                source.routes.forget()
            self._stand_by()
            self._send_statics()

    def look(self) -> None:
        """Look who is there; call it every second."""
        gone = self._publishers.look()
        with self._lock:
            if self._is_closed:
                return
            self._lose(gone)
            self._lose(self._silent())
            self._look_for_unknown()
            self._take_late_names()
            self._look_whether_alone()
            for source in self._sources.values():
                if self._is_of_bridge(source):
                    source.routes.forget()
            self._say_origins()
            self._stand_by()
            self._send_statics()

    def _look_whether_alone(self) -> None:
        """Where messages do not tell their publishers, they are gone when all are."""
        if "" in self._sources and not self._leg.tells_publishers:
            self._alone_looks = 0 if self._publishers.nodes else self._alone_looks + 1
            if self._alone_looks == 2:
                self._drop("")

    def _silent(self) -> list[str]:
        """The publishers that ROS does not list, and that send nothing."""
        nodes = self._publishers.nodes
        self._unlisted -= nodes.keys()
        before_s = self._clock_s() - _UNLISTED_S
        found = [gid for gid in self._unlisted if self._sources[gid].heard_s < before_s]
        shared = self._sources.get("")
        # With a listed one that has no source of its own it may stand for that.
        if shared and self._leg.tells_publishers and nodes.keys() <= self._sources.keys():
            found += [""] if shared.heard_s < before_s else []
        return found

    def _take_late_names(self) -> None:
        """The name of a node may come long after its messages: then they get its stream."""
        nodes = self._publishers.nodes
        for source in [*self._sources.values()]:
            node = nodes.get(source.gid)
            if source.node or not source.gid or not node:
                continue
            former = source.stream
            if stream_name(self._node, node) == former.name:
                source.node = node
                continue
            self._drop(source.gid)
            if former.gids:
                # Its frames leave that stream: what others send there goes on in a new epoch.
                former.close()
            named = self._make(source.gid, node)
            named.statics, named.heard_s = source.statics, source.heard_s

    def _look_for_unknown(self) -> None:
        for gid in [*self._unknown]:
            self._meet(gid)

    def _say_origins(self) -> None:
        nodes = self._publishers.nodes
        own: dict[str, set[str]] = {}
        for gid, node in nodes.items():
            own.setdefault(stream_name(self._node, node), set()).add(gid)
        for name, stream in self._streams.items():
            all_of_it = nodes.keys() if "" in stream.gids and not self._leg.tells_publishers else ()
            gids = stream.gids | own.get(name, set()) | set(all_of_it)
            stream.say_origin(tuple(sorted(gids - {""})))

    def _stand_by(self) -> None:
        """Another bridge that was there first carries some of the publishers: this one need not."""
        for stream in self._streams.values():
            if stream.is_open and self._other_bridge_of(stream):
                stream.close()

    def _other_bridge_of(self, stream: RosStream) -> str:
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
        return other

    # Messages, on threads of the leg's

    def _on_message(self, static: bool, payload: bytes, gid: str) -> None:
        with self._lock:
            if self._is_closed:
                return
            if not self._options.from_ros and self._bridges.of_gid(gid) is None:
                return
            source = self._sources.get(gid) or self._meet(gid)
            if source is None:
                messages = self._unknown[gid].messages
                if len(messages) < _MOST_UNKNOWN:
                    messages.append((payload, static))
            else:
                self._take(source, payload, static)

    def _meet(self, gid: str) -> _Source | None:
        """A publisher that is new; None where ROS does not tell yet whose it is."""
        node: str | None = ""
        unknown = self._unknown.get(gid)
        is_kept = bool(gid)
        if gid:
            is_full = len(self._unknown) + len(self._unlisted) >= _MOST_UNLISTED
            may_wait = unknown is not None or not is_full
            node = self._publishers.look_for(gid) if may_wait else self._publishers.nodes.get(gid)
            is_kept = len(self._sources) < _MOST_PUBLISHERS and (node is not None or may_wait)
        if is_kept and node is None:
            if unknown is None:
                unknown = self._unknown[gid] = _Unknown(self._clock_s())
            if self._clock_s() < unknown.since_s + _UNKNOWN_S:
                return None
            self._unlisted.add(gid)
        self._unknown.pop(gid, None)
        if is_kept:
            source = self._make(gid, node or "")
        else:
            source = self._sources.get("") or self._make("", "")
        for payload, static in unknown.messages if unknown else ():
            self._take(source, payload, static)
        return source

    def _make(self, gid: str, node: str) -> _Source:
        name = stream_name(self._node, node)
        former = self._streams.get(name)
        if former is not None and node:
            for each in self._publishers.replaced_by(gid, former.gids - {""}):
                self._drop(each)
        stream = self._streams.setdefault(name, RosStream(self._node, name))
        stream.gids.add(gid)
        source = _Source(gid, node, stream, Routes(lambda rows: self._route(source, rows)))
        if self._options.rate_limit_hz is not None:
            source.limit = RateLimit(
                self._options.rate_limit_hz, partial(self._send, source), self._executor
            )
        self._sources[gid] = source
        self._say_origins()
        return source

    def _lose(self, gids: Collection[str]) -> None:
        """Publishers are gone; what others of the same node send goes on in a new epoch."""
        lost: dict[str, tuple[_Source, set[str]]] = {}
        for gid in gids:
            self._unknown.pop(gid, None)
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
                    name_some(sorted(children)),
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
        self._note_that_none_crosses(source)
        if not stream.gids:
            stream.close()
            self._streams.pop(stream.name, None)

    def _note_that_none_crosses(self, source: _Source) -> None:
        others = [each for each in self._sources.values() if each is not source]
        left = {child for other in others for child in other.children}
        self._crossed.stays("from ROS", source.children - left)

    def _begin_again(self, source: _Source) -> None:
        """Forget frames that come no longer, where names never end: in a new epoch."""
        self._once.info(
            ("many", source.node),
            "%s has sent more than %d frames: its stream begins again with those that still come",
            source,
            _MOST_FRAMES,
        )
        self._note_that_none_crosses(source)
        source.children, source.taken = set(), set()
        source.routes.forget()
        source.stream.close()

    def _take(self, source: _Source, payload: bytes, static: bool) -> None:
        source.heard_s = self._clock_s()
        try:
            rows = self._reader.read(payload)
        except DecodeError as error:
            self.rejected += 1
            topic = self._options.topic("tf_static" if static else "tf")
            self._once.warning(
                ("unreadable", source.node),
                "Dropped a message of %s on %s: %s",
                source,
                topic,
                error,
            )
            return
        if static:
            self._take_statics(source, rows)
        elif rows.count:
            self._take_dynamic(source, rows)

    # Dynamic transforms

    def _take_dynamic(self, source: _Source, rows: Columns) -> None:
        way = source.routes.of(rows)
        if way.rows is not None and not way.rows:
            return
        rows = way.renamed(rows)
        if wrong := invalid_rows(rows):
            rows = self._without_invalid(source, rows, wrong)
        if way.contested:
            kept = self._crossed.crosses("from ROS", rows)
            rows = rows if len(kept) == rows.count else chosen(rows, kept)
        if not rows.count:
            return
        is_taken = True
        if source.limit is not None:
            source.limit.take(rows)
        else:
            is_taken = self._send(source, rows)
        if is_taken:
            source.taken.update(
                way.children if rows.count == len(way.children) else rows.children()
            )

    def _send(self, source: _Source, rows: Columns) -> bool:
        """Send them on the bus, where that is to be; whether the bus took them."""
        with self._lock:
            stream = source.stream
            if self._is_closed or (not stream.is_open and self._other_bridge_of(stream)):
                return False
            try:
                stream.send(rows)
            except TfbusError as error:
                self._refuse(source, rows.count, error)
                return False
            return True

    def _without_invalid(self, source: _Source, rows: Columns, wrong: Iterable[int]) -> Columns:
        which = set(wrong)
        pairs = rows.pairs()
        for at in sorted(which):
            self._refuse_row(
                source,
                rows.frames[pairs[at][1]],
                "numbers",
                "a number is not finite, or the norm of the quaternion is not 1",
            )
        return chosen(rows, [at for at in range(rows.count) if at not in which])

    def _route(self, source: _Source, rows: Columns) -> Route:
        if len(source.children) > _MOST_FRAMES + len(source.statics):
            self._begin_again(source)
        to = self._names.on_bus
        on_bus = {name: to(name) for name in rows.frames}
        refused = self._refused(source, on_bus, rows)
        found = route(
            rows,
            on_bus.__getitem__,
            lambda parent, child: (
                (parent, child) not in refused and self._crosses(source, on_bus[child])
            ),
        )
        children = [on_bus[child] for child in found.children]
        for child in children:
            # It was static until now.
            for each in self._sources.values():
                if each.stream is source.stream:
                    each.statics.pop(child, None)
            source.stream.becomes_dynamic(child)
        source.children |= set(children)
        source.taken &= source.children
        self._note_names(rows.frames)
        return replace(found, children=children, contested=self._crossed.note("from ROS", children))

    def _refused(
        self, source: _Source, on_bus: dict[str, str], rows: Columns
    ) -> set[tuple[str, str]]:
        """The edges that no buffer would take; of each node the first of a kind is logged."""
        refused = set()
        for parent_at, child_at in rows.pairs():
            parent, child = rows.frames[parent_at], rows.frames[child_at]
            if parent.startswith("/") or child.startswith("/"):
                self._once.info(
                    ("slash", source.node),
                    "%s names frames with a leading slash, such as '%s': on the bus they have none",
                    source,
                    printable(child if child.startswith("/") else parent, 60),
                )
            mistake = self._names.mistake_in(child) or self._names.mistake_in(parent)
            if mistake:
                self._refuse_row(source, child, "name", f"a name of a frame {mistake}")
            elif on_bus[parent] == on_bus[child]:
                self._refuse_row(source, child, "own parent", "it is its own parent")
            else:
                continue
            refused.add((parent, child))
        return refused

    def _refuse_row(self, source: _Source, child: str, kind: str, mistake: str) -> None:
        self.rejected += 1
        self._once.warning(
            ("refused", kind, source.node),
            "Dropped a transform of frame '%s' of %s: %s",
            printable(child, 60),
            source,
            mistake,
        )

    def _refuse(self, source: _Source, count: int, error: Exception) -> None:
        self.rejected += count
        self._once.warning(
            ("refused", type(error).__name__, source.node),
            "Dropped %s of %s: %s",
            counted(count, "transform"),
            source,
            error,
        )

    # Which frames cross

    def _note_names(self, names: Collection[str]) -> None:
        if any([self._names.met(each) for each in names]):
            self._on_names()

    def _is_of_bridge(self, source: _Source) -> bool:
        """Whether another bridge sends it, or may."""
        if source.node:
            return is_bridge(source.node)
        return any(map(is_bridge, self._publishers.nodes.values()))

    def _crosses(self, source: _Source, child: str) -> bool:
        bridge = self._bridges.of_gid(source.gid) if source.gid else None
        if bridge is not None:
            # It comes from this bus.
            if self._bridges.is_senior(bridge):
                if len(self._of_seniors_s) >= _MOST_STATICS:
                    self._of_seniors_s.clear()
                self._of_seniors_s[child] = self._clock_s()
            return False
        if not self._options.from_ros or not self._options.takes(child):
            return False
        if not self._leg.tells_publishers and self._sent_there(child):
            return False
        if not self._is_of_bridge(source):
            return True
        gids = source.stream.gids | ({*self._publishers.nodes} if not source.gid else set())
        if self._bus.has_from_elsewhere(child, gids):
            return False
        if len(self._met_s) >= _MOST_STATICS:
            self._met_s.clear()
        now_s = self._clock_s()
        return now_s >= self._met_s.setdefault(child, now_s) + _GRACE_S

    # Static transforms

    def _take_statics(self, source: _Source, rows: Columns) -> None:
        on_bus = {name: self._names.on_bus(name) for name in rows.frames}
        refused = self._refused(source, on_bus, rows)
        for at, (parent_at, child_at) in enumerate(rows.pairs()):
            parent, child = rows.frames[parent_at], rows.frames[child_at]
            if (parent, child) in refused:
                continue
            one = chosen(rows, [at]).with_frames(tuple([on_bus[each] for each in rows.frames]))
            try:
                if invalid_rows(one):
                    raise InvalidArgumentException("its numbers are no transform")
                (transform,) = one
            except InvalidArgumentException as error:
                self._refuse_row(source, child, "numbers", str(error))
                continue
            if len(source.statics) < _MOST_STATICS:
                source.statics[on_bus[child]] = transform
        self._note_names(rows.frames)
        self._send_statics_of(source.stream)

    def _send_statics(self) -> None:
        for stream in self._streams.values():
            self._send_statics_of(stream)

    def _send_statics_of(self, stream: RosStream) -> None:
        """Send the static transforms of a stream that cross, as they are now."""
        found: dict[str, TransformStamped] = {}
        last = None
        crossings = []
        for source in self._sources.values():
            if source.stream is stream:
                last = source
                crossing = self._crossing_statics(source)
                source.children |= crossing.keys()
                crossings.append((source, crossing))
                self._crossed.note("from ROS", crossing)
                found |= crossing
        if last is None or (found and not stream.is_open and self._other_bridge_of(stream)):
            return
        try:
            stream.set_statics(found)
        except TfbusError as error:
            self._refuse(last, len(found), error)
            return
        for source, crossing in crossings:
            source.taken |= crossing.keys()

    def _crossing_statics(self, source: _Source) -> dict[str, TransformStamped]:
        return {
            child: transform
            for child, transform in source.statics.items()
            if self._crosses(source, child) and not self._has_come_back(child, transform)
        }

    def _has_come_back(self, child: str, transform: TransformStamped) -> bool:
        """Whether the bridge itself sends the same static transform to ROS."""
        there = self._static_there(child)
        return (
            there is not None
            and there.frame_id == transform.frame_id
            and there.transform == transform.transform
        )
