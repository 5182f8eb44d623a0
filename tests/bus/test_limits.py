"""Messages larger than the limit of their kind are dropped unread, named and counted."""

import json
import logging
import re

import pytest

from tests.buses import eventually, send_until
from tests.simulated_bus import Bus
from tfbus import BusError, Node, NodeSettings, SettingsError
from tfbus.bus.query import Answer, Query
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.wire.codec import encode_map
from tfbus.wire.limits import Limits

SMALL = Limits(topic=1000, service=1000, transforms=1000, description=100_000, parameter=1000)


def small(bus: Bus, name: str) -> Node:
    """A node that reads small messages only."""
    return bus.node(name, limits=SMALL)


def test_a_large_message_is_dropped_named_and_counted(
    bus: Bus, sender: Node, caplog: pytest.LogCaptureFixture
) -> None:
    """The subscription hears small messages only; the log names the topic and how to raise it."""
    reader = small(bus, "reader")
    reader.log.addHandler(caplog.handler)
    received: list[bytes] = []
    reader.create_raw_subscription("image", received.append)
    publisher = sender.create_raw_publisher("image")

    def publish() -> None:
        publisher.publish(b"x" * 1001)
        publisher.publish(b"small")

    send_until(publish, lambda: len(received) > 2)
    assert set(received) == {b"small"}
    assert reader.session.callbacks.too_large["image"] > 1
    (line,) = caplog.messages
    assert re.search("'image' unread: .*LIMITS=topic=2kB", line)


def test_a_large_message_cannot_be_sent(bus: Bus) -> None:
    """The sender learns that no node would read it."""
    publisher = small(bus, "sender").create_raw_publisher("image")
    publisher.publish(b"x" * 1000)
    with pytest.raises(BusError, match=r"image: .*LIMITS=topic=2kB"):
        publisher.publish(b"x" * 1001)


def test_a_large_query_is_refused_unread(bus: Bus, sender: Node) -> None:
    """The asker gets a sentence, and the server's callback is not called."""
    called: list[Query] = []
    small(bus, "server").session.queryable("add", called.append)
    answers: list[Answer] = []

    def ask() -> None:
        answers.extend(sender.session.ask("add", b"x" * 1001))

    send_until(ask, lambda: bool(answers))
    assert re.match("the query was .*1 kB", str(answers[0].refusal))
    assert not called


def test_a_large_answer_is_a_refusal(
    bus: Bus, sender: Node, caplog: pytest.LogCaptureFixture
) -> None:
    """The asker reads only answers within its limits, and its log names the first."""

    def answer(query: Query) -> None:
        query.answer("add", b"x" * 1001)
        query.close()

    sender.session.queryable("add", answer)
    asker = small(bus, "asker")
    asker.log.addHandler(caplog.handler)
    answers = eventually(lambda: list(asker.session.ask("add")))
    assert re.match("the answer was .*1 kB", str(answers[0].refusal))
    assert asker.session.callbacks.too_large["service"] > 0
    assert re.match("Dropped an .*'add' .*1 kB", caplog.messages[0])


def test_a_large_query_and_a_large_answer_cannot_be_sent(bus: Bus) -> None:
    """Both ends know the limit."""
    node = small(bus, "node")

    def answer(query: Query) -> None:
        with query.answering("the service"):
            query.answer("add", b"x" * 1001)

    node.session.queryable("add", answer)
    with pytest.raises(BusError, match=r"query add: .*1 kB"):
        node.session.ask("add", b"x" * 1001)
    answers = eventually(lambda: list(node.session.ask("add")))
    assert re.match("the answer cannot .*1 kB", str(answers[0].refusal))


def test_a_refusal_of_a_stranger_can_be_printed(bus: Bus, sender: Node) -> None:
    """Control characters are escaped, and a long text is cut."""

    def refuse(query: Query) -> None:
        query.refuse("no\x1b[2J" + "x" * 10_000)
        query.close()

    sender.session.queryable("add", refuse)
    answers = eventually(lambda: list(bus.node("asker").session.ask("add")))
    assert str(answers[0].refusal).startswith("no\\x1b[2Jxxx")
    assert len(str(answers[0].refusal)) < 1100


@pytest.mark.real
def test_zenoh_keeps_what_is_much_too_large(bus: Bus) -> None:
    """Zenoh itself drops a message of more than twice the largest limit."""
    received = json.loads(zenoh_config(NodeSettings("sim")).get_json("transport/link/rx"))
    assert received["max_message_size"] == 64_065_536
    limits = Limits(topic=2_000_000_000)
    received = json.loads(
        zenoh_config(NodeSettings("sim", limits=limits)).get_json("transport/link/rx")
    )
    assert received["max_message_size"] == 4_000_065_536


def test_limits_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """One variable sets them for all processes of a machine; a mistake names it."""
    monkeypatch.setenv("TFBUS_LIMITS", "topic=64MB")
    assert NodeSettings("sim").limits == Limits(topic=64_000_000)
    monkeypatch.setenv("TFBUS_LIMITS", "images=64MB")
    with pytest.raises(SettingsError, match="TFBUS_LIMITS: 'images=64MB'"):
        NodeSettings("sim")


def test_a_large_message_of_transforms_is_dropped_unread(
    bus: Bus, sender: Node, caplog: pytest.LogCaptureFixture
) -> None:
    """The keys of transforms have a limit of their own."""
    reader = small(bus, "reader")
    reader.log.addHandler(caplog.handler)
    received: list[str] = []
    reader.session.subscriber("tf/**", lambda key, payload: received.append(key))
    large = sender.session.publisher("tf/large")
    little = sender.session.publisher("tf/small")

    def publish() -> None:
        large.put(encode_map({"x": bytes(1000)}))
        little.put(b"")

    send_until(publish, lambda: len(received) > 2)
    assert set(received) == {"tf/small"}
    assert "limit of transforms" in caplog.messages[0]
    assert caplog.records[0].levelno == logging.WARNING
