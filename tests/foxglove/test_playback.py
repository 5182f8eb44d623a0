"""A recording as Foxglove's bar plays it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap", reason="needs mcap: the extra bag")
pytest.importorskip("websockets", reason="needs websockets: pip install websockets")

from tests.builders import S, moved
from tests.buses import eventually
from tests.foxglove.client import Client
from tests.foxglove.playing import watching_transforms
from tfbus import Fleet, TransformStamped
from tfbus.foxglove.front import Serving
from tfbus.foxglove.playback import PlaybackBridge
from tfbus.foxglove.protocol import PlaybackControl
from tfbus.geometry.columns import Columns
from tfbus.messages import LaserScan
from tfbus.recording.items import EventItem, Item, RecordedStream, TopicItem, TransformItem
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.tf_message import TFMessageReader
from tfbus.wire.codec import decode_map, encode_message

START = 1670400300 * S
END = START + 10 * S
SIM = RecordedStream("sim", "/sim", "", 1)
LIDAR = RecordedStream("lidar", "/lidar", "", 1)
PLAYING, PAUSED, ENDED = 0, 1, 3


def item(
    stream: RecordedStream, log_ns: int, *rows: TransformStamped, static: bool = False
) -> Item:
    """A message of transforms."""
    return TransformItem(log_ns, stream, Columns.of_transforms(rows), static, None if static else 1)


def record(path: Path, items: list[Item]) -> Path:
    """A recording of these items."""
    with RecordingWriter(path) as writer:
        for each in sorted(items, key=lambda each: each.log_ns):
            writer.write(each)
    return path


NODE = {
    "name": "/sim",
    "host": "robot",
    "pid": 1,
    "version": "1",
    "session": "a",
    "started_ns": 1,
    "streams": ["sim"],
    "parameters": [{"name": "speed", "value": 1.5, "type": "number"}],
    "publishes": {"turtle1/pose": "Pose"},
    "subscribes": {},
    "serves": {},
    "calls": {},
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds: a laser on a base that moves by 1 m in a second, ten messages a second, with the
    time as a topic.
    """
    items: list[Item] = [
        EventItem(START, "node", "/sim", NODE),
        item(LIDAR, START, moved(START, "base_link", "laser", 0.25), static=True),
    ]
    for tenth in range(101):
        at_ns = START + tenth * S // 10
        items.append(item(SIM, at_ns, moved(at_ns, "world", "base_link", tenth / 10), static=False))
        items.append(TopicItem(at_ns, "battery", "Battery", {"volts": tenth / 10}))
    scan = LaserScan(START, "laser", 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 9.0, np.array([1.0, 2.0]))
    values = decode_map(encode_message(scan))
    items.append(TopicItem(START + S, "scan", "sensor_msgs/msg/LaserScan", values))
    items.sort(key=lambda each: each.log_ns)
    return record(tmp_path_factory.mktemp("playback") / "run.mcap", items)


@pytest.fixture
def client(recording: Path) -> Iterator[Client]:
    """A client that watches all transforms of the recording."""
    with watching(PlaybackBridge([recording], (START, END), Serving(port=0))) as client:
        yield client


@contextmanager
def watching(bridge: PlaybackBridge) -> Iterator[Client]:
    """A client that watches all transforms of a bridge, and has the static ones."""
    with watching_transforms(bridge) as client:
        eventually(lambda: client.of("/tf_static"))
        yield client


def x_of(client: Client, topic: str = "/tf") -> list[float]:
    """The x of all transforms that came on a topic."""
    return [each.transform.x for data in client.of(topic) for each in TFMessageReader().read(data)]


def test_it_stands_at_the_beginning_with_its_statics(client: Client) -> None:
    """Foxglove gets its span, and decides when it plays."""
    info = client.texts_of("serverInfo")[0]
    assert {"playbackControl", "time"} <= set(info["capabilities"])
    assert info["dataStartTime"] == {"sec": START // S, "nsec": 0}
    assert info["dataEndTime"] == {"sec": END // S, "nsec": 0}
    assert set(x_of(client, "/tf_static")) == {0.25}
    eventually(lambda: client.playback)
    assert client.playback[0].status == PAUSED and client.playback[0].time_ns == START


def test_it_plays_as_it_was_recorded(client: Client) -> None:
    """Each message once, at its log time, to the end; and again from there."""
    state = client.control(play=True, speed=50.0, request="play")
    assert (state.status, state.speed, state.did_seek) == (PLAYING, 50.0, False)
    eventually(lambda: client.playback[-1].status == ENDED)
    assert client.playback[-1].time_ns == END
    assert x_of(client)[-100:] == [tenth / 10 for tenth in range(1, 101)]
    times = [log_ns for topic, log_ns, _ in client.messages if topic == "/tf"]
    assert times[-100:] == [START + tenth * S // 10 for tenth in range(1, 101)]
    state = client.control(play=True, speed=50.0, request="again")
    assert state.did_seek and state.time_ns == START


def test_a_message_of_a_sensor_is_served_as_it_is_in_the_file(client: Client) -> None:
    """By ROS's definition; rosbags reads it."""
    typesys = pytest.importorskip("rosbags.typesys", reason="needs rosbags: the extra bags")
    channel = client.subscribe("/scan")
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "sensor_msgs/msg/LaserScan")
    client.control(play=False, seek_ns=START + 2 * S, request="seek")
    eventually(lambda: client.of("/scan"))
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    read = store.deserialize_cdr(client.of("/scan")[0], "sensor_msgs/msg/LaserScan")
    assert (read.header.frame_id, read.ranges.tolist()) == ("laser", [1.0, 2.0])


def test_a_seek_shows_where_everything_was(client: Client) -> None:
    """Also while it stands: the frames, static ones too, and the last message of each topic."""
    client.messages.clear()
    state = client.control(play=False, seek_ns=START + 5 * S, request="seek")
    assert (state.status, state.did_seek, state.time_ns) == (PAUSED, True, START + 5 * S)
    eventually(lambda: x_of(client)[-1:] == [5.0])
    eventually(lambda: x_of(client, "/tf_static")[-1:] == [0.25])
    eventually(lambda: "/battery" in client.channels)


def test_a_seek_is_answered_where_it_goes(recording: Path) -> None:
    """Not where the player comes to before: it was on the way there."""
    bridge = PlaybackBridge([recording], (START, END), Serving(port=0))
    with Client(bridge.front.port) as client:
        eventually(lambda: client.channels)
        bridge.control(PlaybackControl(False, 1.0, START + 5 * S, "a"))
        with watching_transforms(bridge):
            [answer] = eventually(lambda: [it for it in client.playback if it.request_id == "a"])
        assert answer.time_ns == START + 5 * S


def test_a_seek_back_while_it_plays_goes_on_from_there(client: Client) -> None:
    """The answer comes before what follows it."""
    client.control(play=True, speed=10.0, seek_ns=START + 6 * S, request="there")
    eventually(lambda: max(x_of(client), default=0.0) > 7.0)
    client.messages.clear()
    client.control(play=True, speed=10.0, seek_ns=START + 1 * S, request="back")
    eventually(lambda: any(1.5 < x < 3.0 for x in x_of(client)))


def test_pause_holds_it(client: Client) -> None:
    """At the time that its answer says."""
    client.control(play=True, request="play")
    eventually(lambda: len(x_of(client)) > 3)
    state = client.control(play=False, request="pause")
    assert state.status == PAUSED
    held = client.control(play=False, request="still")
    assert held.time_ns == state.time_ns


def test_a_late_client_sees_where_everything_is(recording: Path) -> None:
    """While it stands too; and how it plays."""
    bridge = PlaybackBridge([recording], (START, END), Serving(port=0))
    with watching(bridge) as client:
        client.control(play=False, seek_ns=START + 5 * S, request="seek")
        with Client(bridge.front.port) as late:
            late.subscribe("/tf")
            eventually(lambda: x_of(late))
            assert x_of(late)[0] == pytest.approx(5.0, abs=0.1)
            eventually(lambda: late.playback)
            assert late.playback[-1].status == PAUSED


def test_nodes_and_their_parameters_are_those_of_the_moment(client: Client) -> None:
    """They can be read, not set."""
    client.send("subscribeConnectionGraph")
    eventually(lambda: client.published.get("/turtle1/pose") == ["/sim"])
    client.send("getParameters", parameterNames=[], id="all")
    eventually(lambda: client.parameters == {"/sim.speed": 1.5})
    client.send("setParameters", parameters=[{"name": "/sim.speed", "value": 2}])
    eventually(lambda: client.said())
    [said] = client.said()
    assert said.startswith("/sim.speed is not set: ") and "a recording" in said


def test_the_frames_of_a_fleet_have_their_namespace_in_front(tmp_path: Path) -> None:
    """As a listener with a fleet names them."""
    items = [
        item(
            RecordedStream(f"robot{number}/base", f"/robot{number}/base", f"robot{number}", 1),
            START,
            moved(START, "map", "base_link", float(number)),
            static=True,
        )
        for number in (3, 7)
    ]
    path = record(tmp_path / "fleet.mcap", items)
    bridge = PlaybackBridge([path], (START, START), Serving(port=0), fleet=Fleet(("map",)))
    with watching(bridge) as client:
        eventually(
            lambda: (
                {
                    each.child_frame_id
                    for data in client.of("/tf_static")
                    for each in TFMessageReader().read(data)
                }
                == {"robot3/base_link", "robot7/base_link"}
            )
        )


def test_a_speed_that_is_none_is_ignored(client: Client) -> None:
    """Clients are programs of others."""
    state = client.control(play=False, speed=float("nan"), request="nan")
    assert state.speed == 1.0
    state = client.control(play=False, speed=-3.0, request="negative")
    assert state.speed == pytest.approx(0.001)
