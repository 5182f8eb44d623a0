"""From ROS to the bus: transforms of each node of ROS, in a stream of its own; of Odometry too."""

import threading
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from tfbus.base.errors import DecodeError, InvalidArgumentException, RightsError, TfbusError
from tfbus.base.wording import counted, printable
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.ros.bridge.bridges import Bridges, CrossingRule
from tfbus.ros.bridge.common import Common
from tfbus.ros.bridge.legs import (
    TRANSFORMS_READER_DEPTH,
    Endable,
    Leg,
    OnMessage,
    RosPublisher,
    RosSender,
    RosTopic,
)
from tfbus.ros.bridge.ros_sources import RosSource, RosSources, RosStream
from tfbus.ros.bridge.routes import RateLimit, Route, Routes, chosen, invalid_rows, is_pose, route
from tfbus.ros.bridge.to_ros import ToRos
from tfbus.ros.bridge.topic_table import TopicTable
from tfbus.ros.definitions import ODOMETRY, TF_MESSAGE
from tfbus.ros.schema import MessageCodec
from tfbus.ros.tf_message import TFMessageReader

# Names come from ROS.
_MOST_STATICS = 100_000
# Of the dynamic frames of one publisher.
_MOST_FRAMES = 10_000


class FromRos:
    """Sends transforms from ROS on the bus, until `close()`."""

    def __init__(
        self,
        common: Common,
        leg: Leg,
        bridges: Bridges,
        rule: CrossingRule,
        to_ros: ToRos | None,
    ) -> None:
        self.rejected = 0
        self._node = common.node
        self._options = common.options
        self._names = common.names
        self._publishers = common.publishers
        self._crossed = common.crossed
        self._executor = common.executor
        self._once = common.once
        self._leg = leg
        self._bridges = bridges
        self._rule = rule
        self._to_ros = to_ros
        self._lock = threading.RLock()
        self._reader = TFMessageReader()
        self.sources = RosSources(
            common,
            tells_publishers=leg.tells_publishers,
            make=self._make,
            handle=self._handle,
            on_lost=self._note_that_none_crosses,
        )
        self._is_closed = False
        self._subscriptions: list[Endable] = []

    def listen(self, dynamic: RosTopic, static: RosTopic) -> None:
        """Take the messages of these topics from now on. Twice is fine."""
        if self._subscriptions:
            return
        # Of each publisher the last message with all its static transforms; some send several.
        self._subscriptions = [
            self._leg.subscribe(
                replace(topic, depth=TRANSFORMS_READER_DEPTH), partial(self._on_message, is_static)
            )
            for topic, is_static in ((static, True), (dynamic, False))
        ]

    def close(self) -> None:
        """Take nothing more, and end all streams. Twice is fine."""
        for each in self._subscriptions:
            each.close()
        with self._lock:
            self._is_closed = True
            self.sources.close()

    @property
    def streams(self) -> dict[str, int]:
        """How many frames come by each stream."""
        with self._lock:
            found = {each.name: set[str]() for each in self.sources.streams if each.is_open}
            for source in self.sources:
                if source.stream.name in found:
                    found[source.stream.name] |= source.taken
            return {name: len(children) for name, children in found.items() if children}

    # Changes

    def reconsider(self) -> None:
        """The streams of the bus have changed, or the selection for ROS."""
        with self._lock:
            for source in self.sources:
                source.routes.forget()
            self.sources.stand_by()
            self._send_statics()

    def poll(self) -> None:
        """Look for publishers; call it every second."""
        gone = self._publishers.poll()
        with self._lock:
            if self._is_closed:
                return
            self.sources.poll(gone)
            for source in self.sources:
                if self._rule.is_of_bridge(source):
                    source.routes.forget()
            self.sources.stand_by()
            self._send_statics()

    # Messages, on threads of the leg's

    def _on_message(self, static: bool, payload: bytes, gid: str) -> None:
        with self._lock:
            if self._is_closed:
                return
            if not self._options.from_ros and self._bridges.of_gid(gid) is None:
                return
            self.sources.on_message(payload, gid, static=static)

    def _make(self, gid: str, node: str, stream: RosStream) -> RosSource:
        rate_hz = self._options.rate_limit_hz
        source = RosSource(
            gid,
            node,
            stream,
            Routes(lambda rows: self._route(source, rows)),
            None
            if rate_hz is None
            else RateLimit(rate_hz, lambda rows: self._send(source, rows), self._executor),
        )
        return source

    def _note_that_none_crosses(self, source: RosSource) -> None:
        others = [each for each in self.sources if each is not source]
        left = {child for other in others for child in other.children}
        self._crossed.forget("from ROS", source.children - left)

    def _begin_again(self, source: RosSource) -> None:
        """Forget frames that come no longer, if names never end: in a new epoch."""
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

    def _handle(self, source: RosSource, payload: bytes, static: bool) -> None:
        one = None if static else self._reader.read_one(payload)
        if one is not None and self._take_one(source, *one):
            return
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

    def _take_dynamic(self, source: RosSource, rows: Columns) -> None:
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
            source.limit.pass_on(rows)
        else:
            is_taken = self._send(source, rows)
        if is_taken:
            source.taken.update(
                way.children if rows.count == len(way.children) else rows.children()
            )

    def _take_one(
        self, source: RosSource, frames: tuple[str, ...], stamp_ns: int, pose: bytes
    ) -> bool:
        """Send a transform as the last one of its frames was sent; False if it may not go the
        same way, or is not valid.
        """
        way, stream = source.routes.of_one(frames), source.stream
        if (
            way is None
            or way.rows is not None
            or way.contested
            or way.children[0] not in source.taken
            or source.limit is not None
            or not stream.is_open
            or not is_pose(pose)
        ):
            return False
        try:
            stream.send_pose(way.frames, stamp_ns, pose)
        except TfbusError as error:
            self._refuse(source, 1, error)
        return True

    def _send(self, source: RosSource, rows: Columns) -> bool:
        """Send them on the bus, if that is to be; whether the bus took them."""
        with self._lock:
            stream = source.stream
            if self._is_closed or not (stream.is_open or self.sources.may_send(stream)):
                return False
            try:
                stream.send(rows)
            except TfbusError as error:
                self._refuse(source, rows.count, error)
                return False
            return True

    def _without_invalid(self, source: RosSource, rows: Columns, wrong: Iterable[int]) -> Columns:
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

    def _route(self, source: RosSource, rows: Columns) -> Route:
        if len(source.children) > _MOST_FRAMES + len(source.statics):
            self._begin_again(source)
        to = self._names.on_bus
        on_bus = {name: to(name) for name in rows.frames}
        refused = self._refused(source, on_bus, rows)
        edges = [(rows.frames[parent], rows.frames[child]) for parent, child in rows.pairs()]
        kept = [
            at
            for at, edge in enumerate(edges)
            if edge not in refused and self._rule.crosses(source, on_bus[edge[1]])
        ]
        found = route(rows, tuple(on_bus[name] for name in rows.frames), kept)
        children = [on_bus[child] for child in found.children]
        for child in children:
            # It was static until now.
            for each in self.sources.of_stream(source.stream):
                each.statics.pop(child, None)
            source.stream.becomes_dynamic(child)
        source.children |= set(children)
        source.taken &= source.children
        self._note_names(rows.frames)
        return replace(
            found, children=children, contested=self._crossed.record("from ROS", children)
        )

    def _refused(
        self, source: RosSource, on_bus: dict[str, str], rows: Columns
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
            elif missing := self._missing_right(on_bus[child]):
                self._refuse_row(source, child, "right", missing)
            else:
                continue
            refused.add((parent, child))
        return refused

    def _missing_right(self, child: str) -> str:
        try:
            self._node.settings.check_right("frames", child)
        except RightsError as error:
            return str(error)
        return ""

    def _refuse_row(self, source: RosSource, child: str, kind: str, mistake: str) -> None:
        self.rejected += 1
        self._once.warning(
            ("refused", kind, source.node),
            "Dropped a transform of frame '%s' of %s: %s",
            printable(child, 60),
            source,
            mistake,
        )

    def _refuse(self, source: RosSource, count: int, error: Exception) -> None:
        self.rejected += count
        self._once.warning(
            ("refused", type(error).__name__, source.node),
            "Dropped %s of %s: %s",
            counted(count, "transform"),
            source,
            error,
        )

    def _note_names(self, names: Collection[str]) -> None:
        if any([self._names.met(each) for each in names]) and self._to_ros is not None:
            self._to_ros.reconsider()

    # Static transforms

    def _take_statics(self, source: RosSource, rows: Columns) -> None:
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
            if on_bus[child] in source.statics or len(source.statics) < _MOST_STATICS:
                source.statics[on_bus[child]] = transform
            else:
                self._refuse_row(
                    source, child, "statics", f"it has more than {_MOST_STATICS} static transforms"
                )
        self._note_names(rows.frames)
        self._send_statics_of(source.stream)

    def _send_statics(self) -> None:
        for stream in self.sources.streams:
            self._send_statics_of(stream)

    def _send_statics_of(self, stream: RosStream) -> None:
        """Send the static transforms of a stream that cross, as they are now."""
        found: dict[str, TransformStamped] = {}
        crossings = []
        for source in self.sources.of_stream(stream):
            crossing = self._crossing_statics(source)
            source.children |= crossing.keys()
            crossings.append((source, crossing))
            self._crossed.record("from ROS", crossing)
            found |= crossing
        if not crossings or (found and not (stream.is_open or self.sources.may_send(stream))):
            return
        try:
            stream.set_statics(found)
        except TfbusError as error:
            self._refuse(crossings[-1][0], len(found), error)
            return
        for source, crossing in crossings:
            source.taken |= crossing.keys()

    def _crossing_statics(self, source: RosSource) -> dict[str, TransformStamped]:
        return {
            child: transform
            for child, transform in source.statics.items()
            if self._rule.static_crosses(source, child, transform)
        }


class OdometryFrames:
    """A leg in whose `/tf` are also the poses of the Odometry on some topics, by their publishers.

    `topics` are their full names in ROS.
    """

    def __init__(self, leg: Leg, topics: Sequence[str]) -> None:
        self._leg = leg
        self._topics = tuple(topics)
        # That of transforms, once it is subscribed to.
        self._tf = ""

    @property
    def name(self) -> str:
        return self._leg.name

    @property
    def tells_publishers(self) -> bool:
        return self._leg.tells_publishers

    def publisher(self, topic: RosTopic) -> RosSender:
        return self._leg.publisher(topic)

    def subscribe(self, topic: RosTopic, on_message: OnMessage) -> Endable:
        if topic.definition != TF_MESSAGE or topic.retained:
            return self._leg.subscribe(topic, on_message)
        self._tf = topic.name
        return _Both(self._leg, topic, self._topics, on_message)

    def publishers(self, topic: str) -> Sequence[RosPublisher]:
        found = list(self._leg.publishers(topic))
        if topic == self._tf:
            known = {each.gid for each in found}
            for name in self._topics:
                found += [each for each in self._leg.publishers(name) if each.gid not in known]
        return found

    def lost(self) -> Mapping[str, int]:
        return self._leg.lost()

    def warnings(self) -> Sequence[str]:
        return self._leg.warnings()

    def close(self) -> None:
        self._leg.close()


def with_odometry_frames(leg: Leg, table: TopicTable, ros_namespace: str) -> Leg:
    """The leg with the frames of the topics that the table has as Odometry."""
    above = f"/{ros_namespace}" if ros_namespace else ""
    names = [
        f"{above}/{name}"
        for name, line in table.names.items()
        if line.ros_type == ODOMETRY.name and line.comes_from_ros
    ]
    return OdometryFrames(leg, names)


class _Both:
    """Subscriptions of transforms and of Odometry, whose callbacks come one at a time."""

    def __init__(
        self, leg: Leg, topic: RosTopic, odometry: Sequence[str], on_message: OnMessage
    ) -> None:
        lock = threading.Lock()
        codec = MessageCodec.of_definition(ODOMETRY)
        transforms = MessageCodec.of_definition(TF_MESSAGE)

        def take(payload: bytes, gid: str) -> None:
            with lock:
                on_message(payload, gid)

        def take_odometry(payload: bytes, gid: str) -> None:
            try:
                values = codec.decode(payload)
            except DecodeError:
                return  # the bridge of topics reads it as well, and says so
            pose = values["pose"]["pose"]
            transform = {
                "header": values["header"],
                "child_frame_id": values["child_frame_id"],
                "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
            }
            message = transforms.encode({"transforms": [transform]})
            if message is not None:
                take(message, gid)

        self._parts = [leg.subscribe(topic, take)]
        for name in odometry:
            self._parts.append(leg.subscribe(RosTopic(name, ODOMETRY), take_odometry))

    def close(self) -> None:
        for part in self._parts:
            part.close()
