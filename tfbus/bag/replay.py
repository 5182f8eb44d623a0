"""Replays a recording on the bus: its streams and topics as they were; services of the player."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from tfbus import messages
from tfbus.bag.player import Player
from tfbus.bag.replayed_stream import ReplayedNames, ReplayedStream, StreamEpochs
from tfbus.bag.replayed_time import (
    ReplayedClock,
    clock_topic_of,
    is_clock,
    moved,
    moved_to,
    stamps_ahead_ns,
    with_stamps,
)
from tfbus.base.errors import (
    BusError,
    DecodeError,
    InvalidArgumentException,
    InvalidNameError,
    ServiceError,
)
from tfbus.base.log import LogOnce
from tfbus.base.wording import counted, printable, quoted
from tfbus.messages import Empty, PlayNext, PlayProgress, Seek, SetRate
from tfbus.node.node import Node
from tfbus.node.topic import RawPublisher
from tfbus.recording.items import (
    ALL,
    EventItem,
    Item,
    RecordedStream,
    Selection,
    TopicItem,
    TransformItem,
)
from tfbus.recording.playhead import Pace, Playhead, Progress, Stamps
from tfbus.recording.reader import RecordingReader
from tfbus.ros.definitions import Definition
from tfbus.wire.codec import encode_map, from_map
from tfbus.wire.descriptions import FLOAT64, STREAM_VERSION, StreamDescription
from tfbus.wire.keys import ALL_STREAMS_EVERYWHERE, namespace_of_node, stream_of

# The host in the descriptions of replayed streams.
RECORDED = "recorded"


class Republisher:
    """Publishes the items that a player plays: a Stage.

    `stamps` of "now" moves the stamps of transforms by one offset, to the present;
    at another rate than 1 the times between them are scaled too. The stamps in messages of topics
    are moved as well: each `stamp_ns`, and the stamps of ROS's headers. With `clock_hz`
    it publishes the time of the recording at this rate, for nodes with simulated time.

    Raises InvalidNameError if two streams would get the same name.
    """

    def __init__(
        self,
        node: Node,
        reader: RecordingReader,
        playhead: Playhead,
        *,
        selection: Selection = ALL,
        names: ReplayedNames | None = None,
        stamps: Stamps = "now",
        clock_hz: float | None = None,
    ) -> None:
        self._node = node
        self._selection = selection
        self._names = names or ReplayedNames()
        self._stamps = stamps
        self._log_once = LogOnce(node.log)
        self._ahead_ns = stamps_ahead_ns(reader, selection, playhead.start_ns)
        self._clock = None
        if clock_hz is not None:
            self._clock = ReplayedClock(
                node,
                clock_hz,
                playhead,
                ahead_ns=self._ahead_ns,
                recorded_topic=clock_topic_of(reader),
            )
        # How far the recording lies in the past; None before it begins.
        self._past_ns: int | None = None
        # A paused recording keeps its sent messages for listeners that come late.
        self._played_ns = playhead.clock
        self._described = _descriptions(reader)
        self._epochs = StreamEpochs(_epochs(reader))
        self._streams: dict[str, ReplayedStream] = {}
        # The recorded names of streams by their names on the bus.
        self._old_names: dict[str, str] = {}
        self._statics: dict[str, tuple[object, ...]] = {}
        self._topics: dict[str, RawPublisher | None] = {}
        self._declare(reader)
        node.describers.append(self._describe_node)

    @property
    def streams(self) -> Sequence[str]:
        """The names of its streams on the bus, sorted."""
        return sorted(stream.name for stream in self._streams.values())

    @property
    def topics(self) -> Sequence[str]:
        """The names of its topics on the bus, sorted."""
        return sorted(topic.name for topic in self._topics.values() if topic is not None)

    def living(self) -> str:
        """A sentence on its streams that other processes publish now, "" if none do.

        Playing one takes the frames of a live robot over: the later of two publishers counts.
        """
        own = set(self.streams)
        keys = self._node.session.living(ALL_STREAMS_EVERYWHERE)
        living = sorted(own.intersection(map(stream_of, keys)))
        if not living:
            return ""
        names = quoted(living)
        is_one = len(living) == 1
        return (
            f"{counted(len(living), 'stream')} of the recording {'is' if is_one else 'are'} "
            f"published now too, and would be taken over: {names}; play with --prefix recorded, "
            f"or stop the other {'publisher' if is_one else 'publishers'}"
        )

    # As the stage of a player

    def begin(self, state: Sequence[Item], pace: Pace, *, is_back: bool) -> None:
        """The state comes first; after a jump back, in new epochs."""
        is_new_run = is_back or self._past_ns is None
        if self._past_ns is None:
            self._past_ns = pace.wall_ns - pace.log_ns
        if is_new_run:
            self._epochs.begin_run()
            self._statics.clear()
        if self._clock is not None:
            # First, so that followers do not take the messages for the past, or forget them.
            self._clock.begin(state)
        gone = {
            item.name
            for item in state
            if isinstance(item, EventItem) and item.kind == "stream gone"
        }
        stay_gone = set() if is_new_run else {name for name in gone if not self._is_there(name)}
        sets = {_stream_of(item): item for item in state if _is_set(item)}
        for item in state:
            if _is_set(item) and item is not sets[_stream_of(item)]:
                continue  # of a former epoch, which nobody who joins a bus gets
            # Another message than a retained one is that of the clock.
            is_clock_s = isinstance(item, TopicItem) and not item.retained
            if not is_clock_s and _stream_of(item) not in stay_gone:
                self.take(item, pace)
        if is_back:
            there = {_stream_of(item) for item in state}
            for name in self._streams.keys() - there:
                self._streams[name].withdraw(self._epochs.of(name, 0))

    def take(self, item: Item, pace: Pace) -> None:
        """Publish an item."""
        if isinstance(item, TransformItem):
            self._send(item, pace)
        elif isinstance(item, TopicItem):
            self._publish(item, pace)
        else:
            self._happen(item)

    def follow(self, progress: Progress) -> None:
        """The clock stands still, or goes at another rate."""
        if self._clock is not None:
            self._clock.follow()

    # Streams

    def _send(self, item: TransformItem, pace: Pace) -> None:
        name = item.stream.name
        stream = self._stream(item.stream)
        epoch_ns = self._epochs.of(name, item.stream.epoch_ns)
        rows = item.rows
        if item.static:
            recorded = (epoch_ns, rows.frames, rows.edges_bytes(), rows.poses_bytes())
            if self._statics.get(name) == recorded:
                return
            self._statics[name] = recorded
        if self._stamps == "now" and item.log_ns < pace.log_ns:
            # Where it was when playing begins here; its own stamp may be one that was used.
            rows = moved_to(rows, pace.wall_ns)
        elif self._stamps == "now":
            rows = moved(rows, pace, self._ahead_ns)
        try:
            (stream.send_static if item.static else stream.send)(rows, epoch_ns)
        except BusError as error:
            self._log_once.warning(("transforms", name), "Left out a message: %s", error)

    def _happen(self, event: EventItem) -> None:
        match event.kind:
            case "stream" if self._selection.takes_stream(event.name):
                self._describe(event)
            case "stream gone" if event.name in self._streams:
                self._statics.pop(event.name, None)
                self._streams[event.name].vanish()
            case "dropped":
                self._node.log.info(
                    "The recorder dropped %s here",
                    counted(event.dropped, "message"),
                )

    def _describe(self, event: EventItem) -> None:
        try:
            description = from_map(StreamDescription, event.facts)
        except DecodeError as error:
            self._log_once.warning(
                ("description", event.name),
                "The recorded description of stream '%s' cannot be read: %s",
                printable(event.name),
                error,
            )
            return
        stream = self._stream(_recorded_stream(event))
        try:
            stream.describe(self._as_replayed(event.name, description))
        except BusError as error:
            self._log_once.warning(
                ("description", event.name),
                "Left out the recorded description of stream '%s': %s",
                printable(event.name),
                error,
            )

    def _as_replayed(self, name: str, description: StreamDescription) -> StreamDescription:
        """A recorded description as it is true now."""
        namespace = namespace_of_node(description.node)
        started_ns = description.started_ns
        return replace(
            description,
            epoch=self._epochs.of(name, description.epoch),
            frames=tuple(
                row for row in description.frames if self._selection.takes_frame(row[1], namespace)
            ),
            host=RECORDED,
            session=self._node.session.id,
            # Frames that had numbers in a recorded message are in it, and are sent with names.
            poses=FLOAT64,
            # So the order in which they started holds, among them and beside living streams.
            started_ns=started_ns + (self._past_ns or 0) if started_ns else 0,
        )

    def _is_there(self, name: str) -> bool:
        return name in self._streams and self._streams[name].is_there

    def _stream(self, recorded: RecordedStream) -> ReplayedStream:
        stream = self._streams.get(recorded.name)
        if stream is None:
            stream = self._streams[recorded.name] = self._declared(recorded)
        return stream

    def _declared(self, recorded: RecordedStream) -> ReplayedStream:
        name, new_name = recorded.name, self._names.stream(recorded)
        other = self._old_names.setdefault(new_name, name)
        if other != name:
            raise InvalidNameError(
                f"the streams {other!r} and {name!r} would both be called {new_name!r}: "
                "give one another name (--remap)"
            )
        first = self._described.get(name)
        description = first or StreamDescription(
            STREAM_VERSION,
            recorded.node or self._node.full_name,
            epoch=0,
            frames=(),
            host=RECORDED,
            session=self._node.session.id,
            split=recorded.split,
        )
        key = self._names.stream_key(recorded)
        self._node.settings.check_right("nodes", key.replace("@tfbus/stream/", ""))
        return ReplayedStream(
            new_name,
            key,
            description,
            self._node,
            is_described=bool(first),
            time_ns=self._played_ns,
        )

    # Topics

    def _publish(self, item: TopicItem, pace: Pace) -> None:
        if self._is_time(item.topic, item.type_name):
            if self._clock is not None:
                self._clock.set_by(item)
            return
        if item.topic not in self._topics:
            definition = None if item.encoded is None else item.encoded[0]
            self._topics[item.topic] = self._topic(
                item.topic, item.type_name, item.retained, definition
            )
        publisher = self._topics[item.topic]
        if publisher is not None:
            try:
                publisher.publish(encode_map(self._as_now(item, pace)))
            except BusError as error:
                self._log_once.warning(("topic", item.topic), "Left out a message: %s", error)

    def _as_now(self, item: TopicItem, pace: Pace) -> Mapping[str, Any]:
        """The fields of a message, with stamps moved as the transforms' are."""
        if self._stamps != "now":
            return item.values
        try:
            values = with_stamps(item.values, pace, self._ahead_ns)
        except RecursionError as error:
            raise BusError("it is nested too deeply for its stamps to be moved") from error
        if values is item.values and item.encoded is None and not _is_supplied(item.type_name):
            self._log_once.info(
                ("stamps", item.topic),
                "Messages on topic '%s' (%s) stay as they were recorded: no stamp is known in them;"
                " where they hold times, play with --clock",
                printable(item.topic),
                printable(item.type_name) or "type unknown",
            )
        return values

    def _topic(
        self, name: str, type_name: str, retained: bool, definition: Definition | None
    ) -> RawPublisher | None:
        is_its = definition is not None and definition.name == type_name
        try:
            return self._node.create_raw_publisher(
                self._names.topic(name),
                type_name=type_name,
                retained=retained,
                definition=definition.text if definition is not None and is_its else "",
            )
        except InvalidNameError as error:
            self._log_once.warning(("topic", name), "Left out a topic: %s", error)
            return None

    def _is_time(self, topic: str, type_name: str) -> bool:
        """Whether a topic has the simulated time, and is not replayed as it is: stamps of now do
        not belong to it, and a clock of this node stands for it.
        """
        return is_clock(topic, type_name) and (self._clock is not None or self._stamps == "now")

    # Declarations

    def _declare(self, reader: RecordingReader) -> None:
        """Declare all before the first message: subscribers then know where it comes from."""
        for summary in reader.streams:
            if self._selection.takes_stream(summary.stream.name):
                self._stream(summary.stream)
        for topic in reader.topics:
            if not self._selection.takes_topic(topic.name):
                continue
            if not self._is_time(topic.name, topic.type_name):
                self._topics[topic.name] = self._topic(
                    topic.name, topic.type_name, topic.is_retained, topic.definition
                )
            elif self._clock is None:
                self._node.log.info(
                    "Topic '%s' is left out, since the stamps are those of now: --clock replays it",
                    printable(topic.name),
                )

    def _describe_node(self) -> dict[str, list[str]]:
        streams = [*self._streams.values()]
        return {
            "streams": sorted(each.name for each in streams if each.is_there),
            "unread": sorted(each.name for each in streams if each.is_unread),
        }


def _descriptions(reader: RecordingReader) -> dict[str, StreamDescription]:
    """The first description of each stream that has one."""
    found: dict[str, StreamDescription] = {}
    for event in reader.events:
        if event.kind == "stream" and event.name not in found:
            try:
                found[event.name] = from_map(StreamDescription, event.facts)
            except DecodeError:
                continue
    return found


def _epochs(reader: RecordingReader) -> set[tuple[str, int]]:
    """The streams and their epochs."""
    epochs = {(each.stream.name, each.stream.epoch_ns) for each in reader.streams}
    for event in reader.events:
        if event.kind == "stream" and isinstance(event.facts.get("epoch"), int):
            epochs.add((event.name, event.facts["epoch"]))
    return epochs


def _recorded_stream(event: EventItem) -> RecordedStream:
    return RecordedStream(event.name, namespace=event.name.rpartition("/")[0])


def _stream_of(item: Item) -> str:
    """The stream that an item is about, "" if it is about none."""
    if isinstance(item, TransformItem):
        return item.stream.name
    about_stream = isinstance(item, EventItem) and item.kind in ("stream", "stream gone")
    return item.name if isinstance(item, EventItem) and about_stream else ""


def _is_set(item: Item) -> bool:
    return isinstance(item, TransformItem) and item.static


def _is_supplied(type_name: str) -> bool:
    """Whether tfbus.messages has a type of this name."""
    return isinstance(getattr(messages, type_name, None), type)


# From each stamp to before the first, and after the last: nanoseconds of 64 bits are 292 years.
_FARTHEST_S = 2e10


def serve(node: Node, player: Player, stop: Callable[[], object]) -> None:
    """Serve `~/pause`, `resume`, `toggle_paused`, `play_next`, `seek`, `set_rate`, `progress` and
    `stop`, which calls `stop()`.
    """

    def done_by(job: Callable[[], object]) -> Callable[[Empty.Request], Empty.Response]:
        def handle(request: Empty.Request) -> Empty.Response:
            job()
            return Empty.Response()

        return handle

    def set_rate(request: SetRate.Request) -> SetRate.Response:
        try:
            player.set_rate(request.rate)
        except InvalidArgumentException as error:
            raise ServiceError(str(error)) from error
        return SetRate.Response()

    def play_next(request: PlayNext.Request) -> PlayNext.Response:
        player.step(request.messages)
        return PlayNext.Response()

    def seek(request: Seek.Request) -> Seek.Response:
        base_ns = request.log_ns or player.progress.start_ns
        offset_s = max(-_FARTHEST_S, min(request.offset_s, _FARTHEST_S))
        player.seek(base_ns + round(offset_s * 1e9))
        progress = player.progress
        return Seek.Response(progress.log_ns, progress.played_s)

    def progress(request: PlayProgress.Request) -> PlayProgress.Response:
        now = player.progress
        return PlayProgress.Response(
            now.log_ns, now.start_ns, now.end_ns, now.rate, now.is_paused, now.sent, now.loops
        )

    node.create_service(Empty, "~/pause", done_by(player.pause))
    node.create_service(Empty, "~/resume", done_by(player.resume))
    node.create_service(Empty, "~/toggle_paused", done_by(player.toggle_paused))
    node.create_service(Empty, "~/stop", done_by(stop))
    node.create_service(SetRate, "~/set_rate", set_rate)
    node.create_service(PlayNext, "~/play_next", play_next)
    node.create_service(Seek, "~/seek", seek)
    node.create_service(PlayProgress, "~/progress", progress)
