"""Large messages of topics on a network that carries few of them."""

from typing import Any

import pytest
from zenoh import Priority

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import BusError
from tfbus.bus.network_session import LARGE_BYTES, UNDECLARED
from tfbus.messages import Image
from tfbus.testing.zenoh_session import ZenohSession

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
