"""Messages of epochs that are not confirmed yet."""

import logging

from tests.builders import S, at, payload, x_of
from tests.streams.received import Received
from tfbus import Buffer
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.streams.stream_facts import OF_EPOCH, PendingMessages, Receive, ReceptionHooks
from tfbus.wire.transforms import TransformReader


def test_messages_of_the_confirmed_epoch_are_received_in_their_order() -> None:
    """Messages of other epochs of the stream are thrown away, messages of other streams stay."""
    held = PendingMessages()
    received: list[bytes] = []
    for stream, epoch_ns, data in (
        ("a", 2, b"1"),
        ("a", 3, b"2"),
        ("b", 2, b"3"),
        ("a", 2, b"4"),
    ):
        held.add(stream, epoch_ns, received.append, data)
    held.release("a", 2)
    assert received == [b"1", b"4"]
    held.release("a", 3)
    held.release("b", 2)
    assert received == [b"1", b"4", b"3"]


def test_messages_of_a_later_epoch_wait_on_where_it_may_not_be_the_last() -> None:
    """Its description is still to come. Messages of earlier epochs are thrown away."""
    held = PendingMessages()
    received: list[bytes] = []
    for epoch_ns in (1, 2, 3):
        held.add("a", epoch_ns, received.append, bytes([epoch_ns]))
    held.release("a", 2, is_last=False)
    held.release("a", 1, is_last=False)
    held.release("a", 3, is_last=False)
    assert received == [b"\2", b"\3"] and not held.has("a")


def test_the_oldest_go_first_where_there_are_too_many() -> None:
    """Of a flood only the last are kept."""
    held = PendingMessages(most_bytes=5_000)
    received: list[bytes] = []
    for number in range(100):
        held.add("a", 1, received.append, bytes([number]) * 700)
    held.release("a", 1)
    assert [data[0] for data in received] == [95, 96, 97, 98, 99]


def test_a_message_whose_epoch_is_confirmed_while_it_is_being_kept_is_received() -> None:
    """The confirmation comes between the verdict and the keeping, on another thread."""

    class ConfirmedMeanwhile(PendingMessages):
        def add(
            self, name: str, epoch_ns: int, receive: Receive, payload: bytes, of: str = OF_EPOCH
        ) -> str:
            stream.describe(epoch_ns, frozenset({"robot"}), frozenset({"post"}), confirmed=True)
            return super().add(name, epoch_ns, receive, payload, of)

    buffer = Buffer()
    around = ReceptionHooks(logging.getLogger("test"))
    around.pending = ConfirmedMeanwhile()
    stream = StreamReception(
        "sim",
        buffer,
        logging.getLogger("test"),
        lambda: 9 * S,
        TransformReader(),
        around=around,
    )
    stream.describe(1, frozenset({"robot"}), frozenset({"post"}), confirmed=True)
    stream.statics.receive(payload([at(2, "post")], 2))
    DynamicReception(stream).receive(payload([at(4, "robot", S)], 3))
    assert (x_of(buffer, "world", "post"), x_of(buffer, "world", "robot")) == (2, 4)


def test_a_flood_of_another_epoch_asks_the_publisher_once_a_second() -> None:
    """Each of its messages would ask."""
    received, asked = Received(), []
    received.stream.around.on_dispute = lambda stream, _: asked.append((stream, received.time_s))
    received.stream.describe(1, frozenset({"robot"}), confirmed=True)
    for second in (0.0, 0.5, 0.99, 1.0, 1.9, 2.0):
        received.time_s = second
        received.send(at(4, "robot", S), epoch_ns=2)
    assert asked == [("sim", 0.0), ("sim", 1.0), ("sim", 2.0)]
