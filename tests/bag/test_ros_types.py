"""ROS's types on the bus: a recording that is played and recorded again is as before."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.builders import S
from tests.buses import eventually
from tests.fakes import InAThread, Lines
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.bag.capture import Capture
from tfbus.bag.player import Player
from tfbus.bag.raw_queue import RawQueue
from tfbus.bag.replay import Republisher
from tfbus.bus.ros_types import RosTypes
from tfbus.bus.session import Session
from tfbus.recording.items import Selection, TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.recording.writer import RecordingWriter
from tfbus.ros.definitions import FOLDERS_VARIABLE, Definition, completed, standard_definition
from tfbus.ros.schema import MessageCodec
from tfbus.wire.codec import encode_map, type_name

pytest.importorskip("mcap")
pytest.importorskip("rosbags", reason="needs rosbags: the extra bags")

BEGAN_NS = 1_700_000_000 * S

# Of a package that no one else has.
GRIPPER = Definition(
    "hand_msgs/msg/Gripper", "float32[] gaps\nuint8 OPEN=1\nuint8 state\nstring<=5 name\n"
)


class Recorded:
    """What is recorded on a bus, until `close()`."""

    def __init__(self, bus: Bus) -> None:
        self.node = bus.node("recorder")
        self.queue = RawQueue(10_000_000)
        self.capture = Capture(self.node, self.queue, Selection())
        self.came: list[TopicItem] = []

    def items(self, topic: str) -> list[TopicItem]:
        """The messages of a topic that came once its type was known."""
        for raw in self.queue.drain(0.0):
            if raw.source.is_described(raw.payload):
                item = raw.item()
                if isinstance(item, TopicItem):
                    self.came.append(item)
        return [item for item in self.came if item.topic == topic]


@pytest.fixture
def recorded(bus: Bus) -> Iterator[Recorded]:
    """What is recorded."""
    recorded = Recorded(bus)
    yield recorded
    recorded.capture.close()


def sent(node: Node, recorded: Recorded, type_: str, values: dict[str, object]) -> TopicItem:
    """A message of a standard type as it is recorded."""
    publisher = node.create_raw_publisher("topic", type_name=type_)

    def is_recorded() -> bool:
        publisher.publish(encode_map(values))
        return any(item.type_name for item in recorded.items("topic"))

    eventually(is_recorded)
    return recorded.items("topic")[-1]


@pytest.mark.parametrize("is_standard", [True, False], ids=["standard", "own"])
def test_a_type_of_ros_survives_the_bus(
    bus: Bus, recorded: Recorded, tmp_path: Path, *, is_standard: bool
) -> None:
    """Played from one file and recorded into another, a message has its type, definition and bytes
    again, also one of a package that only the first file knows.
    """
    definition = standard_definition("sensor_msgs/msg/Imu") if is_standard else GRIPPER
    assert definition is not None
    codec = MessageCodec.of_definition(definition)
    filled = {"gaps": [0.5, 0.25], "state": 1, "name": "left"}
    data = codec.encode_fitted({} if is_standard else filled)
    assert data is not None
    values = codec.decode(data)
    with RecordingWriter(tmp_path / "first.mcap") as writer:
        for n in range(5):
            item = TopicItem(BEGAN_NS + n * S, "hand", definition.name, values, (definition, data))
            writer.write(item)
    with RecordingReader(tmp_path / "first.mcap") as reader:
        player = Player(reader, paused=True, at_end="loop", rate=50.0)
        replay = Republisher(bus.node("player"), reader, player, stamps="recorded")
        run = InAThread(lambda: player.run(replay))
        player.resume()
        eventually(lambda: recorded.items("hand"))
        player.stop()
        assert run.result() is None
    with RecordingWriter(tmp_path / "second.mcap") as writer:
        writer.write(recorded.items("hand")[-1])
    with RecordingReader(tmp_path / "second.mcap") as reader:
        [again] = reader.items()
        [topic] = reader.topics
    assert isinstance(again, TopicItem)
    assert topic.type_name == definition.name
    assert again.encoded == (definition, data)
    assert again.values == values


def test_a_program_s_numbers_are_made_to_fit(sender: Node, recorded: Recorded) -> None:
    """Floats are rounded as ROS has them, and fields that are not there are zero."""
    item = sent(sender, recorded, "std_msgs/msg/ColorRGBA", {"a": 1, "r": 0.1})
    definition = standard_definition("std_msgs/msg/ColorRGBA")
    assert definition is not None and item.encoded is not None
    assert item.encoded[0] == definition
    values = MessageCodec.of_definition(definition).decode(item.encoded[1])
    assert values == {"r": 0.10000000149011612, "g": 0.0, "b": 0.0, "a": 1.0}


def test_a_message_of_another_type_is_recorded_as_it_is(sender: Node, recorded: Recorded) -> None:
    """With all its fields, and a word."""
    lines = Lines(recorded.node.log)
    item = sent(sender, recorded, "std_msgs/msg/ColorRGBA", {"red": 1})
    assert item.encoded is None and item.values == {"red": 1}
    assert [line for line in lines.lines if re.search("its type .*ColorRGBA", line)]


def test_a_class_says_the_name_of_its_type() -> None:
    """A class of ROS's is announced by that name, one of tfbus's by its own."""

    class LaserScan:
        __msgtype__ = "sensor_msgs/msg/LaserScan"

    class Narrow(LaserScan):
        pass

    assert type_name(LaserScan) == "sensor_msgs/msg/LaserScan"
    assert type_name(Narrow).endswith("Narrow")


def test_a_definition_of_ones_own_that_is_invalid_stops_nothing(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its type is as one that nobody knows."""
    file = tmp_path / "bad_msgs" / "msg" / "Bad.msg"
    file.parent.mkdir(parents=True)
    file.write_text("absent_msgs/Nothing nothing\n")
    monkeypatch.setenv(FOLDERS_VARIABLE, str(tmp_path))
    assert RosTypes(bus.node("asks").session).codec("/nobody", "bad_msgs/msg/Bad") is None


def test_a_node_is_asked_once_for_all_its_types(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for standard ones; for one that it publishes later it is asked again."""
    sender = bus.node("sender")
    types = RosTypes(bus.node("asks").session)
    asked: list[str] = []
    ask = Session.ask

    def counted(session: Session, selector: str, *values: object, **options: object) -> object:
        asked.append(selector)
        return ask(session, selector, *values, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Session, "ask", counted)
    own = "std_msgs/Header header\nfloat32 width\n"
    text = completed(Definition("my_msgs/msg/Gripper", own)).text
    sender.create_raw_publisher("gripper", type_name="my_msgs/msg/Gripper", definition=text)
    for name in ("Imu", "LaserScan"):
        sender.create_raw_publisher(name, type_name=f"sensor_msgs/msg/{name}")
    assert types.codec("/sender", "my_msgs/msg/Gripper") is not None
    for name in ("Imu", "LaserScan"):
        assert types.codec("/sender", f"sensor_msgs/msg/{name}") is not None
    assert len(asked) == 1
    assert types.codec("/sender", "sensor_msgs/msg/Range") is not None
    assert len(asked) == 2
