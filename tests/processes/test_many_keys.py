"""Transforms on more keys than a listener takes."""

import pytest

import tfbus.streams.registry
from tests.builders import at
from tests.buses import eventually
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformListener,
)


def test_frames_that_come_and_go_leave_room_for_others(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The key of a frame that a split stream has taken out is not counted any more."""
    monkeypatch.setattr(tfbus.streams.registry, "MOST_KEYS", 4)
    buffer = Buffer()
    with TransformListener(buffer, bus.node("receiver")) as listener:
        broadcaster = TransformBroadcaster(bus.node("sender"), split=True)

        def arrives(child: str) -> bool:
            broadcaster.send_transform(at(1, child))
            return child in buffer.frames()

        for number in range(8):
            child = f"object{number}"
            eventually(lambda child=child: arrives(child))
            broadcaster.remove(child)
            eventually(lambda child=child: child not in buffer.frames())
        assert listener.dropped == 0


def test_what_is_static_comes_however_many_keys_there_are(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dynamic transforms on too many keys are dropped, counted and logged once; static are kept."""
    monkeypatch.setattr(tfbus.streams.registry, "MOST_KEYS", 2)
    buffer, sender, receiver = Buffer(), bus.node("sender"), bus.node("receiver")
    log = Lines(receiver.log)
    with TransformListener(buffer, receiver) as listener:
        broadcaster = TransformBroadcaster(sender, split=True)

        def are_dropped() -> bool:
            broadcaster.send_transform([at(1, "a"), at(1, "b"), at(1, "c")])
            return listener.dropped > 3

        eventually(are_dropped)
        assert receiver.describe()["buffers"][0]["dropped"] > 3
        assert len(buffer.frames()) == 3
        static = StaticTransformBroadcaster(sender)
        for x in (1, 2):
            static.send_transform(at(x, "camera"))
            eventually(
                lambda x=x: (
                    buffer.can_transform("world", "camera")
                    and buffer.lookup_transform("world", "camera").transform.x == x
                )
            )
    (line,) = (line for line in log.lines if line.startswith("Dropped"))
    assert "more than 2 keys" in line and "not split streams" in line
