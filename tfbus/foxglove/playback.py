"""A recording as Foxglove shows it: its bar plays, pauses, seeks, and changes the speed."""

import math
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tfbus.bag.player import Player
from tfbus.base.errors import DecodeError, ParameterError, TfbusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce, open_log
from tfbus.base.signals import StopSignals, Wakeup
from tfbus.foxglove.client import Requests
from tfbus.foxglove.front import Front, Serving
from tfbus.foxglove.nodes import Connections, NodeParameters, absolute, connections
from tfbus.foxglove.protocol import (
    Capability,
    PlaybackControl,
    PlaybackState,
    PlaybackStatus,
    ShownParameter,
)
from tfbus.foxglove.robots import GivenRobot, ShownRobots
from tfbus.foxglove.server import Server
from tfbus.foxglove.topics import ServedTopic, TransformChannels, is_description
from tfbus.frames.recorded import RecordedFrames
from tfbus.recording.items import EventItem, Item, Selection, TopicItem, TransformItem
from tfbus.recording.playhead import AtEnd, Pace, Progress, nearest_rate
from tfbus.recording.reader import RecordingReader, TopicSummary
from tfbus.robot.robot import Robot
from tfbus.ros.definitions import Definition
from tfbus.ros.schema import MessageCodec, MessageCodecs
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import NodeDescription, ParameterDescription, StreamDescription
from tfbus.wire.fleet import Fleet

_S = 1_000_000_000

# After a seek, topics show their last message of this time before, and frames where they were.
_LOOK_BACK_S = 2.0

# How often the time is sent: as messages come, and where none does.
_TIME_APART_NS = 16_000_000
_TIME_EVERY_S = 0.1


class PlaybackBridge(Requests):
    """Serves Foxglove a recording, until `close()`; it stands at `span[0]` until a client plays it.

    `span` are the log times, in ns, of its beginning and end. A client that seeks while it stands
    sees where the frames were. With a fleet the frames of robots in namespaces have these in front;
    without one only the namespace counts that all are in, or none.

    Robots that were described are shown, or with a `robot` that one alone. Their meshes are looked
    for on this machine, also in `package_path`.

    Raises TfbusError if it cannot listen, or the files are no recording.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        span: tuple[int, int],
        serving: Serving,
        *,
        log_level: str = "info",
        fleet: Fleet | None = None,
        rate: float = 1.0,
        at_end: AtEnd = "wait",
        robot: Robot | None = None,
        package_path: Sequence[Path] = (),
    ) -> None:
        self.log = open_log("/foxglove", "foxglove", log_level)
        self._once = LogOnce(self.log)
        # One reads ahead, the other looks back.
        self._reader, self._past = RecordingReader(*paths), RecordingReader(*paths)
        self._frames = RecordedFrames(self._past, fleet=fleet, cache_time_s=_LOOK_BACK_S)
        self._looking_back = threading.Lock()
        self._told = 0
        self._request_id: str | None = None
        self._error: TfbusError | None = None
        self._has_begun = False
        self._connections = Connections()
        self._nodes: dict[str, NodeDescription] = {}
        self._streams: dict[str, StreamDescription] = {}
        start_ns, end_ns = span
        self.player = Player(
            self._reader, start_ns=start_ns, end_ns=end_ns, rate=rate, paused=True, at_end=at_end
        )
        capabilities = [
            Capability.GRAPH,
            Capability.PARAMETERS,
            Capability.PLAYBACK,
            Capability.TIME,
        ]
        name = f"tfbus {paths[0].name}"
        self._server = Server(name, self, capabilities, self.log, time_range_ns=span)
        self._transforms = TransformChannels(self._server, lambda: start_ns, self._once)
        self._parameters = NodeParameters(
            _refuse_to_set, self._server.publish_parameters, self._server.say
        )
        codecs = MessageCodecs(exact=False)
        self._topics = {
            topic.name: ServedTopic(
                self._server,
                # Descriptions are also sent on another thread.
                MessageCodecs() if is_description(topic.name, topic.type_name) else codecs,
                absolute(topic.name),
                topic.type_name,
                _ros_codec(topic),
            )
            for topic in self._reader.topics
            if topic.is_readable
            and (robot is None or not is_description(topic.name, topic.type_name))
        }
        # The last ones that were sent, for clients that come later.
        self._described: dict[str, TopicItem] = {}
        self._describing = threading.Lock()
        self._robots = ShownRobots(self._once, package_path)
        self._robot = None if robot is None else GivenRobot(self._server, self._robots, robot)
        self._executor = Executor("foxglove playback", self.log)
        self._executor.every(_TIME_EVERY_S, self._tell_time)
        self.front = Front(serving, self._server, self._on_refused)

    def run(self) -> None:
        """Play as clients ask for, until Ctrl-C or SIGTERM, in the main thread.

        Raises DecodeError if a file is damaged.
        """
        player = threading.Thread(target=self._play, name="foxglove player", daemon=True)
        signals = StopSignals()
        try:
            with Wakeup() as self._at_end:
                player.start()
                signals.wait(wakeup=self._at_end)
                self.player.stop()
                player.join()
        finally:
            signals.uninstall()
        if self._error is not None:
            raise self._error

    def _play(self) -> None:
        try:
            self.player.run(self)
        except TfbusError as error:
            self._error = error
        finally:
            self._at_end.wake()

    def stop(self) -> None:
        """Make `run` return; from any thread."""
        self.player.stop()

    def close(self) -> None:
        """Stop serving; `run` must have returned."""
        self.front.close()
        self._executor.close()
        self._server.close()
        self._reader.close()
        self._past.close()

    # Requests of clients, on the server's threads

    def subscribed(self, channel_id: int) -> None:
        """Send a late client static transforms, and the pose of each frame."""
        if self._transforms.have(channel_id):
            self._executor.submit("transforms", self._send_present, limit=1)
        elif self._robot is not None and self._robot.have(channel_id):
            self._executor.submit("robot", self._send_robot, limit=1)
        else:
            self._executor.submit("robots", self._send_described, limit=1)
        self._executor.submit("state", self._tell_state, limit=1)

    def asset(self, uri: str) -> bytes:
        return self._robots.asset(uri)

    def get_parameters(self, names: Sequence[str]) -> list[ShownParameter]:
        return self._parameters.get(names)

    def set_parameters(self, given: Sequence[ShownParameter]) -> list[ShownParameter]:
        return self._parameters.set(given)

    def parameters_subscribed(self, names: Sequence[str]) -> None:
        self._executor.submit("parameters", self._parameters.publish, names, limit=100)

    def control(self, request: PlaybackControl) -> PlaybackState | None:
        """The answer to a seek follows once the recording is there, before its messages."""
        player, progress = self.player, self.player.progress
        speed = request.speed
        if math.isfinite(speed) and speed != progress.rate:
            player.set_rate(nearest_rate(speed))
        seek_ns = request.seek_ns
        if seek_ns is None and request.is_play and progress.is_at_end:
            seek_ns = player.start_ns
        if seek_ns is None:
            (player.resume if request.is_play else player.pause)()
            return _state_of(player.progress, request_id=request.request_id)
        with player.changed:
            self._request_id = request.request_id
            player.seek(seek_ns, paused=not request.is_play)
        return None

    # As a stage of the player, on its thread

    def begin(self, state: Sequence[Item], pace: Pace, *, is_back: bool) -> None:
        """Send the state in force, and the poses just before."""
        request_id, progress = self._arrived(), self.player.progress
        self._server.tell_time(pace.log_ns)
        self._server.tell_playback(
            _state_of(progress, did_seek=self._has_begun, request_id=request_id, at_ns=pace.log_ns)
        )
        self._has_begun = True
        self._nodes.clear()
        self._streams.clear()
        for item in state:
            if isinstance(item, EventItem):
                self._take_event(item)
            elif isinstance(item, TopicItem):  # retained, as a robot's description is
                self._send_message(item, pace.log_ns)
        self._tell_nodes()
        with self._looking_back:
            self._send_past(pace.log_ns)

    def _arrived(self) -> str | None:
        """The request that it has come here by; a later one is answered elsewhere."""
        with self.player.changed:
            if self.player.is_seeking:
                return None
            request_id, self._request_id = self._request_id, None
            return request_id

    def take(self, item: Item, pace: Pace) -> None:
        """Send an item."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._told + _TIME_APART_NS:
            self._told = now_ns
            self._server.tell_time(item.log_ns)
        if isinstance(item, TransformItem):
            self._send_transforms(item)
        elif isinstance(item, TopicItem):
            self._send_message(item, item.log_ns)
        else:
            self._take_event(item)
            self._tell_nodes()

    def follow(self, progress: Progress) -> None:
        """It was paused or resumed, has another speed, or has come to its end."""
        self._server.tell_time(progress.log_ns)
        self._server.tell_playback(_state_of(progress))

    # Sending

    def _send_transforms(self, item: TransformItem) -> None:
        stream, viewpoint = item.stream, self._frames.viewpoint
        if viewpoint.called(stream.name, stream.namespace) is None:
            return
        names = viewpoint.names(stream.namespace).all_outside(item.rows.frames)
        rows = item.rows.with_frames(names)
        self._transforms.send(rows, static=item.static, log_ns=item.log_ns)

    def _send_message(self, item: TopicItem, log_ns: int) -> None:
        channel = self._topics.get(item.topic)
        if channel is None:
            return
        if is_description(item.topic, item.type_name):
            with self._describing:
                self._described[item.topic] = item
                self._send_description(channel, item, log_ns)
        else:
            self._send_values(channel, item, item.values, log_ns, item.encoded)

    def _send_description(self, channel: ServedTopic, item: TopicItem, log_ns: int) -> None:
        namespace = item.topic.strip("/").rpartition("/")[0]
        names = self._frames.viewpoint.names(namespace)
        self._send_values(channel, item, self._robots.shown(item.values, names, namespace), log_ns)

    def _send_values(
        self,
        channel: ServedTopic,
        item: TopicItem,
        values: Mapping[str, Any],
        log_ns: int,
        encoded: tuple[Definition, bytes] | None = None,
    ) -> None:
        try:
            channel.send(values, log_ns, encoded)
        except ValueError as error:
            self._once.warning(
                ("topic", item.topic), "Left out a message on topic %r: %s", item.topic, error
            )

    def _send_past(self, at_ns: int) -> None:
        """Send the poses of all frames at a time, and the messages before it: it may stand still
        there, or play the messages of this time next.
        """
        self._frames.seek(at_ns)
        self._transforms.send_present(self._frames.buffer, at_ns)
        if not self._topics:
            return
        last: dict[str, TopicItem] = {}
        from_ns = at_ns - round(_LOOK_BACK_S * _S)
        for item in self._past.items(from_ns, at_ns - 1, Selection(topics=tuple(self._topics))):
            if isinstance(item, TopicItem):
                last[item.topic] = item
        for item in last.values():
            self._send_message(item, at_ns)

    def _send_present(self) -> None:
        with self._looking_back:
            at_ns = self.player.progress.log_ns
            self._frames.seek(at_ns)
            self._transforms.send_present(self._frames.buffer, at_ns)

    def _send_described(self) -> None:
        """Send the last descriptions; of a robot that comes later the first."""
        with self._looking_back:
            found = [self._first(topic) for topic in self._undescribed()]
        with self._describing:
            first = {item.topic: item for item in found if item is not None}
            self._described = {**first, **self._described}
            for topic, item in self._described.items():
                self._send_description(self._topics[topic], item, self.player.progress.log_ns)

    def _undescribed(self) -> list[str]:
        """The topics of descriptions of which none was sent yet."""
        found = self._reader.topics
        names = [each.name for each in found if is_description(each.name, each.type_name)]
        return [name for name in names if name in self._topics and name not in self._described]

    def _first(self, topic: str) -> TopicItem | None:
        items = self._past.items(selection=Selection(topics=(topic,)))
        return next((each for each in items if isinstance(each, TopicItem)), None)

    def _send_robot(self) -> None:
        if self._robot is not None:
            self._robot.send(self.player.progress.log_ns)

    def _tell_time(self) -> None:
        progress = self.player.progress
        if not progress.is_paused:
            self._server.tell_time(progress.log_ns)

    def _tell_state(self) -> None:
        self._server.tell_playback(_state_of(self.player.progress))

    # Nodes

    def _take_event(self, event: EventItem) -> None:
        try:
            match event.kind:
                case "node":
                    self._nodes[event.name] = from_map(NodeDescription, event.facts)
                case "node gone":
                    self._nodes.pop(event.name, None)
                case "stream":
                    self._streams[event.name] = from_map(StreamDescription, event.facts)
                case "stream gone":
                    self._streams.pop(event.name, None)
        except DecodeError as error:
            self._once.warning("event", "Left out a description: %s", error)

    def _tell_nodes(self) -> None:
        nodes = list(self._nodes.values())
        self._parameters.update(nodes)
        found = connections(nodes, self._streams.values())
        if found != self._connections:
            self._connections = found
            self._server.publish_graph(found)

    def _on_refused(self, reason: str) -> None:
        self._once.warning(("refused", reason), "Refused a client: %s", reason)


def _ros_codec(topic: TopicSummary) -> MessageCodec | None:
    """The codec of a topic that has a type of ROS's, and its fields."""
    definition = topic.definition
    if definition is None or definition.name != topic.type_name:
        return None
    return MessageCodec.of_definition(definition)


def _state_of(
    progress: Progress,
    *,
    did_seek: bool = False,
    request_id: str | None = None,
    at_ns: int | None = None,
) -> PlaybackState:
    status = PlaybackStatus.PAUSED if progress.is_paused else PlaybackStatus.PLAYING
    if progress.is_at_end:
        status = PlaybackStatus.ENDED
    return PlaybackState(
        status,
        progress.log_ns if at_ns is None else at_ns,
        progress.rate,
        did_seek,
        request_id,
    )


def _refuse_to_set(node: str, name: str, value: object) -> ParameterDescription:
    raise ParameterError("parameters of a recording cannot be set")
