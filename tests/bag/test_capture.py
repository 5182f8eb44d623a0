"""Messages that come from the bus by themselves: keys and tokens of any number, from any peer."""

import logging
from collections import Counter

import pytest

from tests import simulated_bus
from tests.builders import at, description
from tests.buses import eventually
from tests.fakes import Lines
from tests.live_bus import Bus
from tests.ros2_on_zenoh import Ros2
from tfbus import TransformBroadcaster
from tfbus.bag import capture as capture_module
from tfbus.bag.capture import Capture
from tfbus.bag.raw_queue import EVENTS, RawQueue, TransformSource
from tfbus.messages import Clock
from tfbus.recording.items import Selection
from tfbus.wire.transforms import TransformReader

STATIC = TransformSource("other", "", {}, TransformReader(), static=True)


class Noted(Selection):
    """Takes no streams of this name, and notes which it was asked about."""

    def __init__(self) -> None:
        super().__init__(exclude="noise")
        self.asked: list[str] = []

    def takes_transforms(self, stream: str, *, static: bool) -> bool:
        self.asked.append(stream)
        return super().takes_transforms(stream, static=static)


class TestKeys:
    @pytest.fixture(autouse=True)
    def few(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Limits that a test can reach."""
        for name in ("MOST_KEYS", "_MOST_REFUSED", "_MOST_TOPICS"):
            monkeypatch.setattr(capture_module, name, 5)

    def test_keys_that_are_not_recorded_leave_room(self, bus: simulated_bus.Bus) -> None:
        """Names that cannot be shown, or are not selected, block no stream."""
        selection = Noted()
        capture = Capture(bus.node("recorder"), RawQueue(1_000), selection)
        for number in range(50):
            assert capture.source(f"tf/\x1b{number}") is None
            assert capture.source(f"tf/noise{number}") is None
        assert capture.source("tf/sim") is not None
        # The last are remembered as refused, the first are not.
        selection.asked.clear()
        for number in (49, 0):
            assert capture.source(f"tf/noise{number}") is None
        assert selection.asked == ["noise0"]
        capture.close()

    def test_keys_without_a_stream_give_way(self, bus: simulated_bus.Bus) -> None:
        """Where there are too many, those go that no publisher describes."""
        capture = Capture(bus.node("recorder"), RawQueue(1_000), Selection())
        capture.described["sim"] = description([])
        sim = capture.source("tf/sim")
        strays = [capture.source(f"tf/stray{number}") for number in range(50)]
        assert None not in strays
        assert capture.source("tf/sim") is sim is not None
        assert capture.source("tf/stray49") is strays[49]
        assert capture.source("tf/stray45") is not strays[45]
        capture.close()

    def test_topics_beyond_the_limit_take_no_memory(self, bus: simulated_bus.Bus) -> None:
        """Their types are not remembered either."""
        recorder, sim = bus.node("recorder"), bus.node("sim")
        log = Lines(recorder.log)
        for number in range(50):
            sim.create_raw_publisher(f"topic{number}")
        capture = Capture(recorder, RawQueue(1_000), Selection())
        eventually(lambda: any("there are more than 5" in line for line in log.lines))
        assert len(capture.types) == len(recorder.describe()["subscribes"]) == 5
        capture.close()


@pytest.mark.real
class TestBesideRos2:
    @pytest.mark.parametrize("everywhere", [False, True], ids=["plain", "fleet"])
    def test_nothing_of_ros_2_is_recorded(self, bus: Bus, everywhere: bool) -> None:
        """Neither its transforms nor its messages on topics that both have, without a word."""
        ros2 = Ros2(bus.endpoint)
        ros2.rmw_zenoh()
        ros2.bridge()
        recorder, queue = bus.node("recorder"), RawQueue(10_000_000)
        log = Lines(recorder.log, logging.INFO)
        capture = Capture(recorder, queue, Selection(), everywhere=everywhere)
        sender = bus.node("sim")
        broadcaster = TransformBroadcaster(sender)
        publisher = sender.create_publisher(Clock, "turtle1/pose")
        came: Counter[tuple[str, bytes]] = Counter()
        names: set[str] = set()

        def has_all() -> bool:
            ros2.send()
            broadcaster.send_transform(at(1))
            publisher.publish(Clock(7))
            for raw in queue.drain(0):
                if raw.source is not EVENTS:
                    came[raw.source.kind, raw.payload[:1]] += 1
                    names.add(raw.source.name)
            # The retained messages of ROS 2, and some time for those that are not.
            is_joined = len(capture._refused) >= (4 if everywhere else 1)
            return is_joined and len(came) >= 2 and min(came.values()) > 20

        eventually(has_all)
        capture.close()
        ros2.close()
        assert names == {"sim", "turtle1/pose"}
        # CDR begins with a zero, a map in MessagePack does not.
        assert b"\0" not in {first for _, first in came}
        assert log.lines == []


class TestStatics:
    def test_one_that_found_no_room_is_taken_when_it_comes_again(
        self, bus: simulated_bus.Bus
    ) -> None:
        """And then not a second time."""
        queue, session = RawQueue(1_000), bus.node("sim").session
        capture = Capture(bus.node("recorder"), queue, Selection())
        assert session.watch_heard("tf_static/sim").wait(20.0)
        publisher = session.publisher("tf_static/sim")
        while queue.put(STATIC, b"full"):
            pass
        publisher.put(b"x")
        eventually(lambda: queue.dropped["statics"] > 1)
        queue.drain(0)
        for _ in range(2):
            publisher.put(b"x")
        publisher.put(b"y")
        came: list[bytes] = []
        eventually(lambda: came.extend(raw.payload for raw in queue.drain(0)) or b"y" in came)
        assert came == [b"x", b"y"]
        capture.close()
