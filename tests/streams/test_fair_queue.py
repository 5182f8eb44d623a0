"""Descriptions that wait to be read."""

from tfbus.streams.description_queries import FairQueue, Received


def received(sender: str, key: str = "k", payload: bytes = b"") -> Received:
    return Received(key, payload, sender)


def dequeued(queue: FairQueue) -> list[Received]:
    return list(iter(queue.dequeue, None))


def test_descriptions_of_a_sender_keep_their_order() -> None:
    """None is left out: what one description lists, and the next does not, was removed."""
    queue = FairQueue()
    sent = [received("a", payload=bytes([number])) for number in range(100)]
    for each in sent:
        queue.enqueue(each)
    assert dequeued(queue) == sent


def test_senders_have_their_turns() -> None:
    """However many keys one writes to, another waits for one description at most."""
    queue = FairQueue()
    for number in range(1000):
        queue.enqueue(received("flood", f"k{number}"))
    queue.enqueue(received("honest"))
    assert [each.sender for each in dequeued(queue)[:3]] == ["flood", "honest", "flood"]


def test_there_is_room_for_so_many_bytes() -> None:
    """The oldest of the sender with the most bytes goes, never one of another."""
    queue = FairQueue(most_bytes=10_000)
    queue.enqueue(received("honest", payload=bytes(1000)))
    for number in range(100):
        queue.enqueue(received("flood", f"k{number}", bytes(500)))
    left = dequeued(queue)
    assert [each.key for each in left if each.sender == "flood"] == [
        f"k{n}" for n in range(92, 100)
    ]
    assert [each.sender for each in left].count("honest") == 1


def test_the_taking_begins_once_and_goes_on() -> None:
    """A received that comes while another is read is read after it, without a second reader."""
    queue = FairQueue()
    assert queue.enqueue(received("a"))
    assert queue.dequeue() == received("a")
    assert not queue.enqueue(received("b"))
    assert queue.has_more()
    assert queue.dequeue() == received("b")
    assert not queue.has_more()
    assert queue.enqueue(received("a"))
