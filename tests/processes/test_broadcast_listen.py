"""Broadcasters and listeners: the transforms of one node are in the buffers of all others."""

import os
import socket

import msgpack
import numpy as np
import pytest

from tests.builders import STAMP_NS, S, at, x_of
from tests.buses import eventually, send_until
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    BusError,
    InvalidArgumentException,
    Node,
    StaticTransformBroadcaster,
    TransformBatch,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.streams.registry import Budget
from tfbus.streams.watch import StreamWatch
from tfbus.wire.descriptions import StreamDescription


def test_a_transform_that_is_sent_is_in_the_listeners_buffer(sender: Node, buffer: Buffer) -> None:
    """What is broadcast can be looked up elsewhere, with its stamp and the stream it came in."""
    broadcaster = TransformBroadcaster(sender)
    send_until(
        lambda: broadcaster.send_transform(at(1.5, stamp_ns=STAMP_NS)),
        lambda: buffer.can_transform("world", "turtle1"),
    )
    found = buffer.lookup_transform("world", "turtle1")
    assert (found.stamp_ns, found.frame_id, found.child_frame_id) == (STAMP_NS, "world", "turtle1")
    assert found.transform.xyz.tolist() == [1.5, 0, 0]
    assert buffer.frame("turtle1").authority == "sender"


def test_the_listener_may_start_last(bus: Bus, sender: Node) -> None:
    """A listener that starts after the broadcaster receives the next transform."""
    broadcaster = TransformBroadcaster(sender)
    broadcaster.send_transform(at(1))
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late")):
        send_until(lambda: broadcaster.send_transform(at(2)), lambda: x_of(buffer) == 2)


def test_the_broadcaster_may_start_last(bus: Bus, buffer: Buffer) -> None:
    """A broadcaster that starts after the listener is heard."""
    broadcaster = TransformBroadcaster(bus.node("late"))
    send_until(lambda: broadcaster.send_transform(at(2)), lambda: x_of(buffer) == 2)


def test_what_is_sent_in_one_call_goes_in_one_message(sender: Node, receiver: Node) -> None:
    """However many transforms a call sends, they arrive together."""
    payloads: list[bytes] = []
    receiver.session.subscriber("tf/sender", lambda key, payload: payloads.append(payload))
    broadcaster = TransformBroadcaster(sender)
    transforms = [at(1), at(2, "drone", parent="turtle1")]
    send_until(lambda: broadcaster.send_transform(transforms), lambda: bool(payloads))
    assert msgpack.unpackb(payloads[0])["frames"] == ["world", "turtle1", "drone"]


def test_one_several_or_columns_may_be_sent(sender: Node, buffer: Buffer) -> None:
    """A broadcaster takes one transform, any iterable of them, or a batch of columns."""
    broadcaster = TransformBroadcaster(sender)
    batch = TransformBatch(
        ("world", "d"),
        np.uint32([[0, 1]]),
        np.array([S]),
        np.array([[4.0, 0, 0, 0, 0, 0, 1]]),
    )

    def send_all() -> None:
        broadcaster.send_transform(at(1, child="a"))
        broadcaster.send_transform([at(2, child="b")])
        broadcaster.send_transform(at(3, child=child) for child in "c")
        broadcaster.send_transform(batch)
        broadcaster.send_transform([])

    send_until(send_all, lambda: x_of(buffer, source="d") == 4)
    assert [x_of(buffer, source=child) for child in "abcd"] == [1, 2, 3, 4]


def test_statics_reach_those_who_come_later(bus: Bus, sender: Node) -> None:
    """Static transforms are sent once and reach listeners that start at any time later."""
    StaticTransformBroadcaster(sender).send_transform(at(1, child="camera"))
    for name in ("late", "later"):
        buffer = Buffer()
        with TransformListener(buffer, bus.node(name)):
            eventually(lambda buffer=buffer: x_of(buffer, source="camera") == 1)
            assert buffer.lookup_transform("world", "camera", 123).transform.xyz[0] == 1
            assert buffer.frame("camera").static


def test_statics_of_one_node_are_one_set(bus: Bus, sender: Node) -> None:
    """Two static broadcasters of a node do not replace each other's transforms."""
    StaticTransformBroadcaster(sender).send_transform(at(1, child="camera"))
    StaticTransformBroadcaster(sender).send_transform([at(2, child="lidar")])
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late")):
        eventually(lambda: x_of(buffer, source="lidar") == 2)
        assert x_of(buffer, source="camera") == 1


def test_a_corrected_static_replaces_the_first(bus: Bus, sender: Node, buffer: Buffer) -> None:
    """A static transform that is sent again replaces the one of the same child, for all."""
    broadcaster = StaticTransformBroadcaster(sender)
    broadcaster.send_transform([at(1, child="camera"), at(2, child="lidar")])
    eventually(lambda: x_of(buffer, source="camera") == 1)
    broadcaster.send_transform(at(3, child="camera"))
    eventually(lambda: x_of(buffer, source="camera") == 3)
    late = Buffer()
    with TransformListener(late, bus.node("late")):
        eventually(lambda: x_of(late, source="camera") == 3)
        assert x_of(late, source="lidar") == 2


def test_a_stream_can_be_named(bus: Bus, sender: Node, buffer: Buffer) -> None:
    """A broadcaster may have a stream of its own, of any name."""
    broadcaster = TransformBroadcaster(sender, stream="arm/left *")
    send_until(lambda: broadcaster.send_transform(at(1)), lambda: x_of(buffer) == 1)
    assert buffer.frame("turtle1").authority == "arm/left *"
    assert "@tfbus/stream/arm%2Fleft %2A" in sender.session.living("@tfbus/stream/*")


def test_a_stream_describes_its_frames(sender: Node, receiver: Node) -> None:
    """Early and late listeners learn a stream's node, epoch and frames without its data."""
    early = StreamWatch(receiver.session, lambda state: None)
    TransformBroadcaster(sender).send_transform([at(1), at(2, "drone", parent="turtle1")])
    StaticTransformBroadcaster(sender).send_transform(at(3, child="camera"))
    wanted = StreamDescription(
        v=1,
        node="/sender",
        epoch=sender.started_ns,
        frames=(
            ("world", "turtle1", False),
            ("turtle1", "drone", False),
            ("world", "camera", True),
        ),
        host=socket.gethostname(),
        pid=os.getpid(),
        session=sender.session.id,
        history_s=10.0,
        started_ns=sender.started_ns,
    )

    def is_known(watch: StreamWatch) -> bool:
        states = watch.streams()
        return "sender" in states and states["sender"].description == wanted

    eventually(lambda: is_known(early))
    late = StreamWatch(receiver.session, lambda state: None)
    eventually(lambda: is_known(late))


def test_a_message_that_cannot_be_read_is_reported_once(sender: Node, receiver: Node) -> None:
    """A bad message is counted by its stream and reported once; the good ones go on."""
    log = Lines(receiver.log)
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        publisher = sender.session.publisher("tf/sender")
        send_until(lambda: publisher.put(b"nonsense"), lambda: listener.rejected["sender"] >= 3)
        broadcaster = TransformBroadcaster(sender)
        send_until(lambda: broadcaster.send_transform(at(1)), lambda: x_of(buffer) == 1)
    [line] = log.lines
    assert "stream 'sender': not msgpack (ExtraData: " in line


def test_a_message_of_a_later_version_is_reported(sender: Node, receiver: Node) -> None:
    """A message of another version is refused, and a log line says which side to update."""
    log = Lines(receiver.log)
    with TransformListener(Buffer(), receiver):
        publisher = sender.session.publisher("tf/sender")
        send_until(lambda: publisher.put(msgpack.packb({"v": 3})), lambda: bool(log.lines))
    [line] = log.lines
    assert "stream 'sender': " in line and "version 3; " in line
    assert "versions 1 and 2: update" in line


def test_a_transform_that_the_buffer_refuses_is_reported_once(sender: Node, receiver: Node) -> None:
    """An invalid pose is counted and logged once; the others of its message are kept."""
    log = Lines(receiver.log)
    buffer = Buffer()
    poses = np.array([[np.nan, 0, 0, 0, 0, 0, 1], [7.0, 0, 0, 0, 0, 0, 1]])
    batch = TransformBatch(
        ("world", "bad", "turtle1"), np.uint32([[0, 1], [0, 2]]), np.full(2, S), poses
    )
    with TransformListener(buffer, receiver):
        broadcaster = TransformBroadcaster(sender)
        send_until(lambda: broadcaster.send_transform(batch), lambda: buffer.rejected.total() >= 3)
    assert x_of(buffer) == 7
    [line] = log.lines
    assert line.startswith("Refused a transform ") and "stream 'sender': " in line


def test_namespaces_keep_trees_apart(bus: Bus) -> None:
    """Two robots that broadcast the same frames in two namespaces do not disturb each other."""
    buffers = {name: Buffer() for name in ("robot7", "robot8")}
    for name, buffer in buffers.items():
        TransformListener(buffer, bus.node("listener", namespace=name))
    broadcasters = {name: TransformBroadcaster(bus.node("sim", namespace=name)) for name in buffers}

    def send_all() -> None:
        for x, broadcaster in enumerate(broadcasters.values()):
            broadcaster.send_transform(at(x))

    send_until(send_all, lambda: all(x_of(buffer) is not None for buffer in buffers.values()))
    assert {name: x_of(buffer) for name, buffer in buffers.items()} == {"robot7": 0, "robot8": 1}


def test_a_closed_listener_keeps_its_buffer(sender: Node, receiver: Node) -> None:
    """A closed listener receives nothing; what it has received stays. Twice is fine."""
    buffer, other = Buffer(), Buffer()
    listener = TransformListener(buffer, receiver)
    TransformListener(other, receiver)
    broadcaster = TransformBroadcaster(sender)
    send_until(lambda: broadcaster.send_transform(at(1)), lambda: x_of(buffer) == 1)
    listener.close()
    listener.close()
    later = at(2, stamp_ns=S + 1)
    send_until(lambda: broadcaster.send_transform(later), lambda: x_of(other) == 2)
    assert x_of(buffer) == 1


def test_a_frame_cannot_be_its_own_parent(sender: Node) -> None:
    """What no buffer would take is refused where it is sent."""
    with pytest.raises(InvalidArgumentException, match=r"'world' .*own parent"):
        TransformBroadcaster(sender).send_transform(at(1, "world"))


def test_sending_after_the_node_is_closed_is_a_bus_error(sender: Node) -> None:
    """A broadcaster of a node that is closed says so."""
    broadcaster, static = TransformBroadcaster(sender), StaticTransformBroadcaster(sender)
    sender.close()
    with pytest.raises(BusError, match=r"publish tf/sender: .*closed"):
        broadcaster.send_transform(at(1))
    with pytest.raises(BusError, match="publish tf_static/sender"):
        static.send_transform(at(1))


def test_streams_without_a_node_are_not_counted_for_ever(
    sender: Node, receiver: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Streams without a token are forgotten when they take too much; those of a node stay."""
    budget = Budget(most_bytes=120_000, most_bytes_a_peer=60_000)
    monkeypatch.setattr("tfbus.streams.listener.Budget", lambda: budget)
    buffer = Buffer()
    with TransformListener(buffer, receiver) as listener:
        StaticTransformBroadcaster(sender).send_transform(at(1))
        eventually(lambda: x_of(buffer) == 1)
        eventually(lambda: any(info.session for info in listener.streams()))
        seen: set[str] = set()

        def put() -> bool:
            sender.session.zenoh.put(f"tf/ghost{len(seen)}", b"nonsense")
            names = {info.name for info in listener.streams()}
            seen.update(names)
            return len(seen) > 50

        eventually(put)
        eventually(lambda: put() and len(listener.streams()) <= 20)
        assert "sender" in {info.name for info in listener.streams()}
