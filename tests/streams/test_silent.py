"""Networks on which a lost link is not the end: a publisher is silent before it is gone."""

from collections.abc import Iterator

import pytest

from tests.buses import eventually, keep_sending, tell_token
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, TransformListener
from tfbus.base import scheduler
from tfbus.bus.settings import NETWORKS

GONE_AFTER_S = NETWORKS["wifi"].gone_after_s


class Listened:
    """A listener on Wi-Fi, and what it takes for gone or back, with the times."""

    def __init__(self, bus: Bus) -> None:
        self.publisher = bus.node("sim")
        keep_sending(self.publisher, "world", "robot")
        self.node: Node = bus.node("listener", network="wifi")
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self.node)
        self.changes: list[tuple[str, float]] = []
        eventually(lambda: "robot" in self.buffer.frames())
        eventually(lambda: [each.alive for each in self.listener.streams()] == [True])
        self.buffer.on_change(
            lambda change: self.changes.append((change.kind, scheduler.monotonic()))
        )

    @property
    def is_silent(self) -> bool:
        """Whether it takes the stream for silent."""
        return self.listener.streams()[0].silent


@pytest.fixture
def listened(bus: Bus) -> Iterator[Listened]:
    listened = Listened(bus)
    yield listened
    listened.listener.close()


def test_a_token_that_is_back_in_time_was_never_gone(listened: Listened, bus: Bus) -> None:
    """A stream whose token is lost is silent, and as before once the token is back."""
    listened.publisher.executor.close()
    tell_token(listened.node, alive=False)
    eventually(lambda: listened.is_silent)
    assert listened.listener.streams()[0].alive
    bus.network.run(GONE_AFTER_S / 2)
    tell_token(listened.node, alive=True)
    eventually(lambda: not listened.is_silent)
    bus.network.run(2 * GONE_AFTER_S)
    assert listened.changes == []


def test_a_stream_is_gone_after_its_silence(listened: Listened) -> None:
    """A publisher that has ended is gone once the time of its network has passed."""
    ended_s = scheduler.monotonic()
    listened.publisher.close()
    eventually(lambda: listened.buffer.frame("robot").gone)
    [(kind, at_s)] = listened.changes
    assert kind == "publisher gone"
    assert at_s - ended_s >= GONE_AFTER_S
    assert not listened.is_silent


def test_a_stream_that_sends_is_not_gone(listened: Listened, bus: Bus) -> None:
    """A stream without a token is silent, and not gone as long as its messages come."""
    tell_token(listened.node, alive=False)
    eventually(lambda: listened.is_silent)
    bus.network.run(5 * GONE_AFTER_S)
    assert listened.changes == []
    listened.publisher.close()
    eventually(lambda: listened.buffer.frame("robot").gone)
