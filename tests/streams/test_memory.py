"""The memory of a listener for streams that have left."""

import pytest

from tests.builders import at, payload, x_of
from tests.buses import eventually
from tests.simulated_bus import Bus
from tests.streams.received import receive
from tfbus import Buffer, StaticTransformBroadcaster, TransformListener
from tfbus.streams.registry import Budget


def test_streams_that_have_left_are_forgotten_with_their_frames(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Streams of a flood go by themselves once it is over, and the streams that are there stay."""
    monkeypatch.setattr("tfbus.streams.registry.MOST_GONE", 10)
    monkeypatch.setattr("tfbus.streams.listener._TIDY_EVERY_S", 0.05)
    buffer, budget = Buffer(), Budget()
    monkeypatch.setattr("tfbus.streams.listener.Budget", lambda: budget)
    with TransformListener(buffer, bus.node("receiver")) as listener:
        StaticTransformBroadcaster(bus.node("sim")).send_transform(at(2, "post"))
        eventually(lambda: x_of(buffer, "world", "post") == 2)
        for number in range(100):
            receive(listener, f"tf_static/ghost{number}", payload([at(1, f"ghost{number}")]))
        monkeypatch.setattr("tfbus.streams.registry._SILENT_NS", 0)
        eventually(lambda: len(listener.streams()) < 20)
        eventually(lambda: len(buffer.frames()) < 22)
        assert x_of(buffer, "world", "post") == 2
        assert 0 < budget.bytes < 100_000
