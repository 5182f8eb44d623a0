"""Streams whose frames have numbers, and whose poses take fewer bytes, in a simulated network."""

import math
from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgpack
import pytest

from tests.builders import x_of
from tests.buses import eventually
from tests.simulated_bus import Bus
from tests.streams.received import Received
from tfbus import (
    Buffer,
    InvalidArgumentException,
    Node,
    NodeSettings,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base import scheduler
from tfbus.frames.named import NamedMessages
from tfbus.recording.items import TransformItem
from tfbus.recording.reader import RecordingReader
from tfbus.streams.info import StreamInfo, StreamState
from tfbus.streams.stream_facts import PendingMessages
from tfbus.streams.watch import StreamWatch
from tfbus.testing.network import Network
from tfbus.wire.numbered import FrameNumbers

FRAMES = 50


def pose(number: int, t: float) -> Transform:
    """A pose that differs for each frame and time."""
    return Transform((number + 0.001 * math.sin(t), 0.5, t), (0.0, 0.0, math.sin(t), math.cos(t)))


def send(broadcaster: TransformBroadcaster, node: Node, t: float, count: int = FRAMES) -> int:
    """Send so many frames of now; returns their stamp."""
    stamp_ns = node.now_ns()
    broadcaster.send_transform(
        [TransformStamped(stamp_ns, "base", f"link{i}", pose(i, t)) for i in range(count)]
    )
    return stamp_ns


def is_as_sent(buffer: Buffer, t: float, stamp_ns: int, count: int = FRAMES) -> bool:
    """Whether the buffer answers each frame within the precision of compact poses."""
    for i in range(count):
        found = buffer.lookup_transform("base", f"link{i}", stamp_ns).transform
        sent = pose(i, t)
        if sent.distance(found) > 1e-4 or sent.angle(found, degrees=True) > 0.01:
            return False
    return True


def listening(bus: Bus, name: str, **given: float) -> tuple[Buffer, TransformListener]:
    """A buffer and its listener in a node of its own."""
    buffer = Buffer()
    return buffer, TransformListener(buffer, bus.node(name), **given)


def heard(node: Node) -> None:
    """Wait until what a node sends has a listener."""
    eventually(lambda: node.name not in node.describe()["unread"])


def info(listener: TransformListener, name: str = "arm") -> StreamInfo:
    """What the listener says of a stream."""
    return next(each for each in listener.streams() if each.name == name)


@pytest.mark.parametrize("poses", ["float32", "compact"])
@pytest.mark.parametrize("split", [False, True])
def test_lookups_answer_what_was_sent_within_the_precision(
    bus: Bus, poses: str, split: bool
) -> None:
    """The first message too, which comes before its frames are described; also to a listener that
    joins late, with what the stream has kept.
    """
    arm = bus.node("arm")
    buffer, listener = listening(bus, "viewer")
    broadcaster = TransformBroadcaster(arm, poses=poses, split=split)
    heard(arm)
    first_ns = send(broadcaster, arm, 0.1)
    eventually(lambda: buffer.can_transform("base", "link49", first_ns))
    assert is_as_sent(buffer, 0.1, first_ns)
    second_ns = send(broadcaster, arm, 0.9)
    eventually(lambda: buffer.can_transform("base", "link49", second_ns))
    assert is_as_sent(buffer, 0.9, second_ns)
    assert info(listener).poses == poses
    late, _ = listening(bus, "late", history_s=10.0)
    eventually(lambda: late.can_transform("base", "link49", first_ns))
    assert is_as_sent(late, 0.1, first_ns) and is_as_sent(late, 0.9, second_ns)


def test_a_frame_that_comes_later_does_not_hold_up_the_others(bus: Bus) -> None:
    """Rows whose names are known are stored at once; the rest when the description comes."""
    arm = bus.node("arm")
    buffer, listener = listening(bus, "viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    heard(arm)
    send(broadcaster, arm, 0.1, 2)
    eventually(lambda: buffer.can_transform("base", "link1"))
    stamp_ns = send(broadcaster, arm, 0.2, 3)
    eventually(lambda: buffer.can_transform("base", "link1", stamp_ns))
    eventually(lambda: buffer.can_transform("base", "link2", stamp_ns))
    assert is_as_sent(buffer, 0.2, stamp_ns, 3)
    assert info(listener).unnamed <= 2


def test_names_that_a_link_loses_are_asked_for(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """No description comes by itself."""
    monkeypatch.setattr(StreamWatch, "_on_description", lambda *_: None)
    arm = bus.node("arm")
    buffer, _ = listening(bus, "viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    heard(arm)
    for count in (1, 2):
        eventually(
            lambda count=count: (
                send(broadcaster, arm, 0.1, count)
                and buffer.can_transform("base", f"link{count - 1}")
            ),
            every_s=1.0,
        )


def test_a_frame_that_is_removed_and_sent_again_has_another_number(bus: Bus) -> None:
    """It is gone in between, and its new poses are those that are sent then."""
    arm = bus.node("arm")
    buffer, _ = listening(bus, "viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    heard(arm)
    send(broadcaster, arm, 0.1, 3)
    eventually(lambda: buffer.can_transform("base", "link1"))
    broadcaster.remove("link1")
    eventually(lambda: not buffer.can_transform("base", "link1"))
    stamp_ns = send(broadcaster, arm, 0.7, 3)
    eventually(lambda: buffer.can_transform("base", "link1", stamp_ns))
    assert is_as_sent(buffer, 0.7, stamp_ns, 3)


def test_a_frame_with_two_parents_by_turns_is_received_from_both(bus: Bus) -> None:
    """Each pair of parent and child has a number of its own."""
    arm = bus.node("arm")
    buffer, _ = listening(bus, "viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    heard(arm)
    for turn in range(6):
        parent = ("table", "gripper")[turn % 2]
        at = TransformStamped(arm.now_ns(), parent, "cup", Transform((turn, 0, 0)))
        broadcaster.send_transform(at)
        eventually(lambda parent=parent, turn=turn: x_of(buffer, parent, "cup") == turn)


def test_a_restart_never_mixes_the_numbers_of_two_epochs(bus: Bus) -> None:
    """The new process gives the same numbers to other frames; its stamps go back, too."""
    buffer, _ = listening(bus, "viewer")
    for names in (["a", "b", "c"], ["c", "a", "b"], ["b", "c"]):
        with Node("arm") as arm:
            broadcaster = TransformBroadcaster(arm, poses="compact")
            heard(arm)
            for back_ns in (0, 5_000_000_000):
                stamp_ns = arm.now_ns() - back_ns
                broadcaster.send_transform(
                    [
                        TransformStamped(stamp_ns, "base", name, Transform((ord(name), 0, back_ns)))
                        for name in names
                    ]
                )
                eventually(lambda s=stamp_ns, n=names[-1]: buffer.can_transform("base", n, s))
                for name in names:
                    found = buffer.lookup_transform("base", name, stamp_ns).transform
                    assert (found.x, found.z) == (ord(name), back_ns)


def test_two_publishers_have_numbers_of_their_own(bus: Bus) -> None:
    """Number 0 of one stream is not that of another."""
    buffer, _ = listening(bus, "viewer")
    nodes = [bus.node("left"), bus.node("right")]
    senders = [TransformBroadcaster(node, poses="compact") for node in nodes]
    heard(nodes[0])
    heard(nodes[1])
    for x in (1.0, 2.0):
        for node, sender in zip(nodes, senders, strict=True):
            frame = TransformStamped(node.now_ns(), "base", node.name, Transform((x, 0, 0)))
            sender.send_transform(frame)
        eventually(lambda x=x: all(x_of(buffer, "base", each.name) == x for each in nodes))


def numbered(count: int, epoch_ns: int = 1) -> bytes:
    """A message of numbers from 0, each at the origin of its frame."""
    columns = {"stamps": 5, "forms": b"\0", "poses": b""}
    payload: bytes = msgpack.packb({"v": 2, "epoch": epoch_ns, "runs": [0, count], **columns})
    return payload


def numbers_of(count: int) -> FrameNumbers:
    """So many frames with numbers from 0, each at x = 1."""
    named = [(number, "world", f"link{number}") for number in range(count)]
    return FrameNumbers(1, count, named, array("d", [1, 0, 0, 0, 0, 0, 1] * count).tobytes())


def epoch_of(sender: Node, listener: Node, broadcaster: TransformBroadcaster) -> int:
    """The epoch of the messages of a node, which has sent one frame then."""
    payloads: list[bytes] = []
    listener.session.subscriber("tf/arm", lambda _, payload: payloads.append(payload))
    heard(sender)
    send(broadcaster, sender, 0.1, 1)
    eventually(lambda: payloads)
    epoch_ns: int = msgpack.unpackb(payloads[0])["epoch"]
    return epoch_ns


def test_a_message_waits_on_where_the_first_description_is_older() -> None:
    """Its frame is in the next one."""
    received = Received()
    received.key.receive(numbered(2))
    for count in (1, 1, 2):
        received.stream.describe(1, frozenset({"link0", "link1"}), numbers=numbers_of(count))
    assert received.x_of("link1") == 1


def test_a_message_whose_names_never_come_does_not_wait_for_ever(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It is dropped after three descriptions, and the log says so once."""
    received = Received()
    received.key.receive(numbered(2))
    received.key.receive(numbered(2))
    for _ in range(4):
        received.stream.describe(1, frozenset({"link0"}), numbers=numbers_of(1))
    assert not received.stream.around.pending.has("sim")
    assert received.x_of("link0") == 1
    assert len([line for line in caplog.messages if "has no names" in line]) == 1


def test_tools_show_a_message_once_all_its_frames_have_names(bus: Bus) -> None:
    """A message newer than the description waits for the next one."""
    arm, viewer = bus.node("arm"), bus.node("viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    came: list[int] = []
    named = NamedMessages(viewer, lambda key, message, size: came.append(len(message.rows)))
    epoch_ns = epoch_of(arm, viewer, broadcaster)
    named.decode("tf/arm", numbered(1, epoch_ns))
    eventually(lambda: came == [1])
    named.decode("tf/arm", numbered(2, epoch_ns))
    broadcaster.send_transform(TransformStamped(arm.now_ns(), "base", "link1", Transform()))
    eventually(lambda: came == [1, 2])
    named.close()


def test_tools_show_what_came_before_a_restart_was_described(bus: Bus) -> None:
    """Though the process of before, which had other names, went meanwhile."""
    former, viewer = bus.node("arm"), bus.node("viewer")
    came: list[int] = []
    named = NamedMessages(viewer, lambda key, message, size: came.append(message.epoch_ns))
    epoch_ns = epoch_of(former, viewer, TransformBroadcaster(former, poses="compact"))
    named.decode("tf/arm", numbered(1, epoch_ns))
    eventually(lambda: came == [epoch_ns])
    states: list[StreamState] = []
    watch = StreamWatch(viewer.session, states.append)
    eventually(lambda: states and states[-1].alive)
    arm = bus.node("arm")
    named.decode("tf/arm", numbered(1, arm.started_ns))
    former.close()
    eventually(lambda: states[-1].alive is False)
    watch.close()
    broadcaster = TransformBroadcaster(arm, poses="compact")
    broadcaster.send_transform(TransformStamped(arm.now_ns(), "base", "link0", Transform()))
    eventually(lambda: arm.started_ns in came)
    named.close()


@pytest.mark.parametrize(
    ("described_ns", "of"), [(1, "with the names of their frames"), (2, "of their epoch")]
)
def test_a_listener_says_once_for_what_too_many_messages_wait(
    caplog: pytest.LogCaptureFixture, described_ns: int, of: str
) -> None:
    """For names that its stream's description does not have, or for the description of another
    epoch than the one that is there.
    """
    received = Received()
    received.stream.around.pending = PendingMessages(most_bytes=500)
    received.stream.numbers = FrameNumbers(described_ns, 0, (), b"")
    for _ in range(4):
        received.key.receive(numbered(2))
    [line] = (line for line in caplog.messages if "too many wait" in line)
    assert f"a description {of}: " in line


def test_tools_that_close_while_they_begin_to_watch_leave_nothing_open(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watch that is made just then is closed, too."""
    ended, closed = scheduler.Event(), scheduler.Event()

    class ClosedMeanwhile(StreamWatch):
        def __init__(self, *given: Any, **named_: Any) -> None:
            super().__init__(*given, **named_)
            named.close()
            ended.set()

        def close(self) -> None:
            super().close()
            closed.set()

    viewer = bus.node("viewer")
    named = NamedMessages(viewer, lambda key, message, size: None)
    monkeypatch.setattr("tfbus.frames.named.StreamWatch", ClosedMeanwhile)
    named.decode("tf/arm", numbered(1))
    assert ended.wait(5.0) and closed.wait(5.0)


def test_a_message_behind_the_end_of_a_tool_starts_no_thread(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that is received just then: nothing would end it."""
    named = NamedMessages(bus.node("viewer"), lambda key, message, size: None)
    named.close()
    begun: list[str] = []
    monkeypatch.setattr("tfbus.frames.named.Executor", lambda name, log: begun.append(name))
    named.decode("tf/arm", numbered(1))
    assert begun == []


def test_tools_say_once_that_names_never_came(bus: Bus, capsys: pytest.CaptureFixture[str]) -> None:
    """They show the rows that have names."""
    arm, viewer = bus.node("arm"), bus.node("viewer")
    broadcaster = TransformBroadcaster(arm, poses="compact")
    came: list[int] = []
    named = NamedMessages(viewer, lambda key, message, size: came.append(len(message.rows)))
    epoch_ns = epoch_of(arm, viewer, broadcaster)
    sent = iter(range(1, 100))

    def describe_again() -> bool:
        send(broadcaster, arm, 0.1, next(sent))
        return len(came) == 2

    named.decode("tf/arm", numbered(1000, epoch_ns))
    named.decode("tf/arm", numbered(1000, epoch_ns))
    eventually(describe_again)
    assert capsys.readouterr().err.count("has no names") == 1
    named.close()


def test_frames_come_over_a_link_that_loses_a_fifth(network: Network) -> None:
    """Of messages and of descriptions: none is taken for another, and nearly all are answered."""
    robot, base = network.host("robot"), network.host("base")
    network.path(robot, base, delay_s=0.05, loss=0.2)
    sent: dict[int, float] = {}

    def arm() -> None:
        with Node(settings=NodeSettings("arm", network="wifi", poses="compact")) as node:
            broadcaster = TransformBroadcaster(node)

            def tick() -> None:
                t = len(sent) / 10
                sent[send(broadcaster, node, t, 5 + len(sent) // 40)] = t

            node.create_timer(0.1, tick)
            node.spin()

    network.start(robot, "arm", arm)
    with network.process(base, "viewer"):
        node = Node(settings=NodeSettings("viewer", network="wifi"))
        buffer = Buffer()
        TransformListener(buffer, node)
    eventually(lambda: buffer.can_transform("base", "link4"))
    begun = len(sent)
    eventually(lambda: len(sent) > begun + 90)
    came = [
        (stamp_ns, t)
        for stamp_ns, t in [*sent.items()][begun + 2 : begun + 80]
        if buffer.can_transform("base", "link4", stamp_ns)
    ]
    assert len(came) > 70
    newest_ns, t = came[-1]
    assert is_as_sent(buffer, t, newest_ns, 5)
    eventually(lambda: buffer.can_transform("base", "link7"))
    node.close()


def test_frames_that_are_sent_all_the_time_outlast_many_that_are_not(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once more than 50,000 frames, here 1,000, have had numbers, all get other ones, also in
    messages that are sent as before.
    """
    monkeypatch.setattr("tfbus.streams.sender._MOST_EDGES", 1_000)
    arm = bus.node("arm")
    broadcaster = TransformBroadcaster(arm, poses="compact", history_s=0.0)

    def see(numbers: Iterable[int]) -> None:
        stamp_ns = arm.now_ns()
        broadcaster.send_transform(
            [TransformStamped(stamp_ns, "base", f"seen{i}", Transform()) for i in numbers]
        )

    see(range(500))
    see(reversed(range(500)))
    send(broadcaster, arm, 0.1, 3)
    see(range(500, 1_000))
    see([1_000])
    buffer, _ = listening(bus, "viewer")
    heard(arm)
    stamp_ns = send(broadcaster, arm, 0.2, 3)
    eventually(lambda: buffer.can_transform("base", "link2", stamp_ns))
    assert is_as_sent(buffer, 0.2, stamp_ns, 3)


def test_all_broadcasters_of_a_stream_have_the_same_poses(bus: Bus) -> None:
    """Another one is refused, and so is a word that is none."""
    arm = bus.node("arm", poses="compact")
    TransformBroadcaster(arm)
    with pytest.raises(InvalidArgumentException, match="poses=compact"):
        TransformBroadcaster(arm, poses="float64")
    with pytest.raises(InvalidArgumentException, match="float64, float32, compact"):
        TransformBroadcaster(bus.node("other"), poses="tiny")


def test_tools_and_recordings_have_the_decoded_values(bus: Bus, tmp_path: Path) -> None:
    """`topic echo` with the names of frames, `topic info` says the precision, and a recording is
    read as any other.
    """
    arm = bus.node("arm", poses="compact")
    broadcaster = TransformBroadcaster(arm)
    path = tmp_path / "arm.mcap"
    recorder = bus.start("bag", "record", "-o", str(path))
    sent: dict[int, float] = {}
    arm.create_timer(0.1, lambda: sent.update({send(broadcaster, arm, len(sent), 3): len(sent)}))
    eventually(lambda: len(sent) > 20)
    assert "link2" in bus.run("topic", "echo", "--once", "tf/arm").stdout
    assert "Poses: compact" in bus.run("topic", "info", "tf/arm", "--verbose").stdout
    eventually(lambda: path.exists())
    recorder.stop()
    with RecordingReader(path) as reader:
        items = [item for item in reader.items() if isinstance(item, TransformItem)]
    rows = [row for item in items for row in item.rows]
    assert len(rows) > 30
    for row in rows:
        expected = pose(int(row.child_frame_id[-1]), sent[row.stamp_ns])
        assert expected.distance(row.transform) < 1e-4
        assert expected.angle(row.transform, degrees=True) < 0.01
