"""The contents of foreign files, as the items of a recording."""

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field

from tfbus.core.packed import EDGE_SIZE, POSE_SIZE, STAMP_SIZE
from tfbus.errors import DecodeError, InvalidNameError
from tfbus.geometry.columns import Columns
from tfbus.recording.foreign.foxglove import ns_of
from tfbus.recording.foreign.messages import (
    ForeignChannel,
    ForeignMessage,
    ValuesDecoder,
    transforms_decoder,
    values_decoder,
)
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.selection import ALL, Selection
from tfbus.ros.counterparts import counterpart_of_ros
from tfbus.wire.keys import (
    CLOCK_TOPIC,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    check_namespace,
    check_no_transforms,
    check_topic,
)
from tfbus.wording import stamp_text

_NS_PER_S = 1_000_000_000
_CLOCK = "rosgraph_msgs/msg/Clock"

_Read = Callable[[ForeignMessage], Item | None]


@dataclass
class Imported:
    """Counts what was imported. `left_out` says by topic why none of its messages was, `failed` how
    many of a topic could not be read or written, and `why_failed` the first reason; `refused` is
    how many were read and not written. `topics` are all that the files have.
    """

    transforms: int = 0
    static_transforms: int = 0
    topic_messages: int = 0
    topics: set[str] = field(default_factory=set)
    left_out: dict[str, str] = field(default_factory=dict)
    failed: Counter[str] = field(default_factory=Counter)
    why_failed: dict[str, str] = field(default_factory=dict)
    refused: int = 0

    def add(self, item: Item) -> None:
        """Count an item."""
        self._add(item, 1)

    def refuse(self, item: Item, reason: str) -> None:
        """Note that an item, which was counted, could not be written."""
        self._add(item, -1)
        self.refused += 1
        if not isinstance(item, EventItem):
            self.fail(item.topic if isinstance(item, TopicItem) else item.stream.name, reason)

    def fail(self, topic: str, reason: str) -> None:
        """Note that a message of a topic is left out."""
        self.failed[topic] += 1
        self.why_failed.setdefault(topic, reason)

    def _add(self, item: Item, number: int) -> None:
        if isinstance(item, TopicItem):
            self.topic_messages += number
        elif isinstance(item, TransformItem) and item.static:
            self.static_transforms += number * item.rows.count
        elif isinstance(item, TransformItem):
            self.transforms += number * item.rows.count


def imported(
    messages: Iterable[ForeignMessage],
    counts: Imported,
    *,
    selection: Selection = ALL,
    topics: Collection[str] = (),
    only_transforms: bool = False,
    default_stream: str = "",
) -> Iterator[Item]:
    """The messages as items, in the same order.

    Transforms come as one stream for each publisher if the file names it, as rosbag1 does, and
    else as one stream `ros` or `foxglove`, or `default_stream`. Those of `/robot7/tf` are in the
    namespace `robot7`. Leading slashes of frames are removed, as tf2 does. A static transform stays
    until another one of its child comes on the same stream.

    Of other topics, `topics` alone if it names any, and none with `only_transforms`.
    """
    importer = _Importer(counts, selection, frozenset(topics), default_stream)
    importer.only_transforms = only_transforms
    return importer.items(messages)


class _Importer:
    def __init__(
        self, counts: Imported, selection: Selection, topics: frozenset[str], default_stream: str
    ) -> None:
        self._counts = counts
        self._selection = selection
        self._topics = topics
        self.only_transforms = False
        self._default_stream = default_stream
        self._reads: dict[ForeignChannel, _Read | None] = {}
        self._epochs: dict[str, int] = {}
        self._statics: dict[str, _StaticSet] = {}

    def items(self, messages: Iterable[ForeignMessage]) -> Iterator[Item]:
        for message in messages:
            channel = message.channel
            if channel not in self._reads:
                self._counts.topics.add(channel.topic.lstrip("/"))
                self._reads[channel] = self._read_of(channel)
            read = self._reads[channel]
            if read is None:
                continue
            try:
                item = read(message)
            except DecodeError as error:
                self._counts.fail(channel.topic, str(error))
                continue
            taken = None if item is None else self._selection.taken_of(item)
            if taken is not None:
                self._counts.add(taken)
                yield taken

    def _read_of(self, channel: ForeignChannel) -> _Read | None:
        """The maker of items of a channel's messages; None if it is left out, which is noted."""
        try:
            columns_of = transforms_decoder(channel)
            if columns_of is not None:
                return self._transforms_of(channel, columns_of)
            if self.only_transforms:
                return None
            topic = check_no_transforms(check_topic(channel.topic.lstrip("/")))
            if self._topics and topic not in self._topics:
                return None
            if not self._selection.takes_topic(topic):
                return None
            return _topic_of(channel, topic, values_decoder(channel))
        except (DecodeError, InvalidNameError) as error:
            self._counts.left_out.setdefault(channel.topic, str(error))
            return None

    def _transforms_of(
        self, channel: ForeignChannel, columns_of: Callable[[bytes], Columns]
    ) -> _Read | None:
        name, namespace, is_static = self._place_of(channel)
        if not self._selection.takes_transforms(name, static=is_static):
            return None
        node = f"/{channel.publisher.strip('/')}" if channel.publisher else ""

        def read(message: ForeignMessage) -> TransformItem | None:
            rows = _without_slashes(columns_of(message.data))
            _check_stamps(rows)
            epoch_ns = self._epochs.setdefault(name, message.log_ns)
            stream = RecordedStream(name, node, namespace, epoch_ns)
            if not is_static:
                return TransformItem(message.log_ns, stream, rows)
            statics = self._statics.setdefault(name, _StaticSet())
            if not statics.take(rows):
                return None
            return TransformItem(message.log_ns, stream, statics.rows(), static=True)

        return read

    def _place_of(self, channel: ForeignChannel) -> tuple[str, str, bool]:
        """The stream's name and namespace, and whether its transforms are static."""
        above, _, last = channel.topic.strip("/").rpartition("/")
        is_static = last == STATIC_TRANSFORMS
        source = "foxglove" if "foxglove" in channel.type_name else "ros"
        own = channel.publisher.strip("/").replace("/", "_") or self._default_stream or source
        if not is_static and last != TRANSFORMS:
            # Transforms on a topic that is not tf2's: apart from those, and named after the topic.
            return channel.topic.strip("/").replace("/", "_") or own, "", False
        namespace = check_namespace(above)
        return (f"{namespace}/{own}" if namespace else own), namespace, is_static


def _topic_of(channel: ForeignChannel, topic: str, decode: ValuesDecoder) -> _Read:
    is_clock = channel.type_name == _CLOCK and topic.rpartition("/")[2] == CLOCK_TOPIC

    counterpart = counterpart_of_ros(channel.type_name, "", topic)

    def read(message: ForeignMessage) -> TopicItem:
        values, encoded = decode(message.data)
        if is_clock:
            # ROS's simulated time says neither rate nor pause.
            clock = {"stamp_ns": ns_of(values["clock"]), "rate": 1.0, "paused": False}
            return TopicItem(message.log_ns, topic, "Clock", clock)
        type_name, is_retained = channel.type_name, channel.retained
        if counterpart is not None and encoded is not None:
            type_name, values = counterpart.type_name, counterpart.of_ros(dict(values))
            # Its publisher retains it, whatever the file says.
            is_retained |= type_name == "RobotDescription"
        return TopicItem(message.log_ns, topic, type_name, values, encoded, is_retained)

    return read


def _check_stamps(rows: Columns) -> None:
    """Raises DecodeError for a stamp that no message of ROS 2, and so no recording, can hold."""
    for stamp_ns in rows.stamps_as_ints():
        if not -(2**31) <= stamp_ns // _NS_PER_S < 2**31:
            raise DecodeError(
                f"the stamp {stamp_text(stamp_ns)} s is not between 1901 and 2038, as recordings "
                "can hold"
            )


def _without_slashes(rows: Columns) -> Columns:
    if not any(frame.startswith("/") for frame in rows.frames):
        return rows
    return rows.with_frames(tuple(frame.lstrip("/") for frame in rows.frames))


class _StaticSet:
    """The static transforms of a stream. ROS sends some of them at a time: the last of each child
    counts.
    """

    def __init__(self) -> None:
        self._row_of: dict[str, tuple[str, bytes, bytes]] = {}

    def take(self, rows: Columns) -> bool:
        """Take rows; whether any differs from what was there."""
        stamps, poses = rows.stamps_bytes(), rows.poses_bytes()
        is_new = False
        for at, (parent, child) in enumerate(rows.pairs()):
            row = (
                rows.frames[parent],
                stamps[STAMP_SIZE * at : STAMP_SIZE * (at + 1)],
                poses[POSE_SIZE * at : POSE_SIZE * (at + 1)],
            )
            name = rows.frames[child]
            is_new = is_new or self._row_of.get(name) != row
            self._row_of[name] = row
        return is_new

    def rows(self) -> Columns:
        """All of them."""
        index_of: dict[str, int] = {}
        edges = bytearray()
        for child, (parent, _, _) in self._row_of.items():
            for name in (parent, child):
                edges += index_of.setdefault(name, len(index_of)).to_bytes(
                    EDGE_SIZE // 2, sys.byteorder
                )
        return Columns.of_bytes(
            tuple(index_of),
            bytes(edges),
            b"".join([stamp for _, stamp, _ in self._row_of.values()]),
            b"".join([pose for _, _, pose in self._row_of.values()]),
        )
