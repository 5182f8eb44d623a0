"""Large messages of topics on a network that carries few of them."""

import random
import zlib
from collections.abc import Callable
from typing import Any

import pytest
from zenoh import Priority

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import BusError, Node
from tfbus.bus.large_messages import ReadingSubscriber
from tfbus.bus.network_session import LARGE_BYTES, UNDECLARED
from tfbus.bus.query import Query
from tfbus.messages import Image
from tfbus.testing.zenoh_session import ZenohSession
from tfbus.wire.codec import encode_map

SMALL, LARGE = bytes(100), bytes(LARGE_BYTES)


@pytest.mark.parametrize(("profile", "low"), [("wifi", True), ("mobile", True), ("lan", False)])
def test_a_topic_with_large_messages_gives_way_on_a_bad_network(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, profile: str, low: bool
) -> None:
    """From its first large message on all of it comes after other topics, so that none of its own
    messages overtakes another; on a LAN it has their priority.
    """
    priorities: list[Any] = []
    put = ZenohSession.put

    def note(self: ZenohSession, key: str, payload: Any, **how: Any) -> None:
        if str(key) == "camera":
            priorities.append(how["priority"])
        put(self, key, payload, **how)

    monkeypatch.setattr(ZenohSession, "put", note)
    received: list[int] = []
    driver = bus.node("driver", network=profile)
    publisher = driver.create_publisher(Image, "camera")._publisher
    viewer = bus.node("viewer", network=profile)
    subscription = viewer.session.subscriber(
        "camera", lambda key, payload: received.append(len(payload))
    )
    eventually(lambda: publisher.heard)
    sent = [SMALL, LARGE, SMALL, LARGE]
    for payload in sent:
        publisher.put(payload)
    eventually(lambda: len(received) == len(sent))
    assert received == [len(payload) for payload in sent]
    assert priorities == [Priority.DATA] + 3 * [Priority.DATA_LOW if low else Priority.DATA]
    subscription.close()


def test_a_topic_with_large_messages_ends_as_others_do(bus: Bus) -> None:
    """A publisher that was closed sends nothing more, also of large messages."""
    publisher = bus.node("driver", network="wifi").create_publisher(Image, "camera")
    bytes_publisher = publisher._publisher
    bytes_publisher.put(LARGE)
    publisher.close()
    with pytest.raises(BusError, match=UNDECLARED):
        bytes_publisher.put(LARGE)


NEWEST = random.Random(1).randbytes(40_000)


def part_of(payload: bytes, at: int, **changed: Any) -> bytes:
    """The answer with a part of a message, of which some is changed."""
    crc, part = zlib.crc32(payload), payload[at : at + 16_000]
    return encode_map({"crc": crc, "size": len(payload), "at": at, "part": part, **changed})


class Server:
    """Answers questions for the newest message of the topic `camera`, or for a part of it."""

    def __init__(self, node: Node, name: str, answer: Callable[[int], bytes], newest: bytes):
        self.asked = 0
        self._answer = answer
        self._has = str(zlib.crc32(newest))
        key = f"camera/@adv/parts/{name}"
        node.session.queryable(key, self._on_query, long=True)
        node.session.token(key)

    def _on_query(self, query: Query) -> None:
        with query.answering("the newest"):
            self.asked += 1
            is_known = self._has in (query.parameter("has") or "").split(",")
            at = int(query.parameter("from") or 0)
            query.answer(query.key, encode_map({}) if is_known else self._answer(at))


@pytest.mark.parametrize(
    "answer",
    [
        lambda at: b"no map",
        lambda at: encode_map({"crc": 1}),
        lambda at: part_of(NEWEST, at, crc=1),
        lambda at: part_of(NEWEST, at, size=-1),
        lambda at: part_of(NEWEST, at, size=10**9),
        lambda at: part_of(NEWEST, at, at=7),
        lambda at: part_of(NEWEST, at, part=b"x"),
        lambda at: part_of(NEWEST, at, part="text"),
        lambda at: part_of(NEWEST, at, older=["x"]),
        lambda at: part_of(NEWEST, 0),
        lambda at: encode_map({}) if at else part_of(NEWEST, 0),
    ],
)
def test_parts_that_make_no_message_are_dropped(bus: Bus, answer: Callable[[int], bytes]) -> None:
    """Whoever sends them is asked again later, and holds up no other publisher."""
    received: list[bytes] = []
    mistaken = Server(bus.node("mistaken"), "mistaken", answer, NEWEST)
    right = bytes(reversed(NEWEST))
    Server(bus.node("right"), "right", lambda at: part_of(right, at), right)
    viewer = bus.node("viewer", network="mobile")
    ReadingSubscriber(
        viewer.session, "camera", lambda key, payload: received.append(payload), others=False
    )
    eventually(lambda: received and mistaken.asked > 2)
    assert received == [right]


def test_a_message_that_comes_late_by_itself_is_dropped(bus: Bus) -> None:
    """The answer names the message that was asked for, and the messages before it."""
    received: list[bytes] = []
    late, later = LARGE, LARGE[1:] + b"x"
    older = [zlib.crc32(late)]
    Server(bus.node("camera"), "one", lambda at: part_of(NEWEST, at, older=older), NEWEST)
    viewer = bus.node("viewer", network="mobile")
    ReadingSubscriber(
        viewer.session, "camera", lambda key, payload: received.append(payload), others=False
    )
    eventually(lambda: received)
    publisher = bus.node("driver").session.publisher("camera")
    eventually(lambda: publisher.heard)
    for payload in (late, NEWEST, later):
        publisher.put(payload)
    eventually(lambda: later in received)
    assert received == [NEWEST, later]


def test_a_question_that_makes_no_sense_is_refused(bus: Bus) -> None:
    """The answer says why; of a message that is not kept there is nothing."""
    driver = bus.node("driver", network="mobile")
    driver.create_publisher(Image, "camera")._publisher.put(LARGE)
    (key,) = eventually(lambda: bus.node("viewer").session.living("camera/@adv/parts/*"))

    def answers(parameters: str) -> list[tuple[bytes, str | None]]:
        found = driver.session.ask(f"{key}?{parameters}")
        return [(each.payload, each.refusal) for each in found]

    for mistaken in ("of=x", "of=1;from=-1", "of=12345678901"):
        ((payload, refusal),) = answers(mistaken)
        assert payload == b"" and refusal is not None and "not a number" in refusal
    assert answers("of=1") == [(encode_map({}), None)]
