"""Messages of epochs that are not confirmed yet."""

from tfbus.listen.held import Held


def test_messages_of_the_confirmed_epoch_are_received_in_their_order() -> None:
    """Those of other epochs of the stream are thrown away, those of other streams stay."""
    held = Held()
    received: list[bytes] = []
    for stream, epoch_ns, payload in (
        ("a", 2, b"1"),
        ("a", 3, b"2"),
        ("b", 2, b"3"),
        ("a", 2, b"4"),
    ):
        held.keep(stream, epoch_ns, received.append, payload)
    held.release("a", 2)
    assert received == [b"1", b"4"]
    held.release("a", 3)
    held.release("b", 2)
    assert received == [b"1", b"4", b"3"]


def test_the_oldest_go_first_where_there_are_too_many() -> None:
    """Of a flood only the last are kept."""
    held = Held(most_bytes=5_000)
    received: list[bytes] = []
    for number in range(100):
        held.keep("a", 1, received.append, bytes([number]) * 700)
    held.release("a", 1)
    assert [payload[0] for payload in received] == [95, 96, 97, 98, 99]
