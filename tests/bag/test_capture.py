"""What comes from the bus by itself: keys and tokens of any number, from any peer."""

import logging
from collections import Counter
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests import simulated_bus
from tests.builders import at, description
from tests.buses import eventually
from tests.fakes import Lines
from tests.live_bus import Bus
from tests.ros2_on_zenoh import Ros2
from tfbus import TransformBroadcaster
from tfbus.bag import capture as capture_module
from tfbus.bag.capture import Capture, NodeRoster
from tfbus.bag.raw_queue import EVENTS, RawQueue
from tfbus.bus.session import Session
from tfbus.discover.graph import TopicInfo
from tfbus.messages import Clock
from tfbus.recording.selection import Selection


class TestKeys:
    @pytest.fixture(autouse=True)
    def few(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Limits that a test can reach."""
        for name in ("MOST_KEYS", "_MOST_REFUSED", "_MOST_TOPICS"):
            monkeypatch.setattr(capture_module, name, 5)

    def test_keys_that_are_not_recorded_leave_room(self, bus: simulated_bus.Bus) -> None:
        """Names that cannot be shown, or are not selected, block no stream."""
        capture = Capture(bus.node("recorder"), RawQueue(1_000), Selection(exclude="noise"))
        for number in range(50):
            assert capture.source(f"tf/\x1b{number}") is None
            assert capture.source(f"tf/noise{number}") is None
        assert capture.source("tf/sim") is not None
        assert len(capture._refused) <= 5
        capture.close()

    def test_keys_without_a_stream_give_way(self, bus: simulated_bus.Bus) -> None:
        """Where there are too many, those go that no publisher describes."""
        capture = Capture(bus.node("recorder"), RawQueue(1_000), Selection())
        capture.described["sim"] = description([])
        sim = capture.source("tf/sim")
        for number in range(50):
            assert capture.source(f"tf/stray{number}") is not None
        assert capture.source("tf/sim") is sim is not None
        assert len(capture._sources) <= 5
        capture.close()

    def test_topics_beyond_the_limit_take_no_memory(self, bus: simulated_bus.Bus) -> None:
        """Their types are not remembered either."""
        capture = Capture(bus.node("recorder"), RawQueue(1_000), Selection())
        for number in range(50):
            if capture._take_topic(f"topic{number}", info := TopicInfo(f"topic{number}")):
                capture._note_type(f"topic{number}", info)
        assert len(capture.types) == len(capture._topics) == 5
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

        def has_all() -> bool:
            ros2.send()
            broadcaster.send_transform(at(1))
            publisher.publish(Clock(7))
            for raw in queue.take(0):
                if raw.source is not EVENTS:
                    came[raw.source.kind, raw.payload[:1]] += 1
            # The retained messages of ROS 2, and some time for those that are not.
            is_joined = len(capture._refused) >= (4 if everywhere else 1)
            return is_joined and len(came) >= 2 and min(came.values()) > 20

        eventually(has_all)
        capture.close()
        ros2.close()
        assert {source.name for source in capture._sources.values()} == {"sim"}
        # CDR begins with a zero, a map in MessagePack does not.
        assert b"\0" not in {first for _, first in came}
        assert log.lines == []


class TestStatics:
    def test_one_that_found_no_room_is_taken_when_it_comes_again(
        self, bus: simulated_bus.Bus
    ) -> None:
        """And then not a second time."""
        queue = RawQueue(0)
        capture = Capture(bus.node("recorder"), queue, Selection(topics=("tf_static",)))
        capture._on_static("tf_static/sim", b"x")
        queue._most_bytes = 1_000
        for _ in range(2):
            capture._on_static("tf_static/sim", b"x")
        assert [raw.payload for raw in queue.take(0) if raw.source.kind == "statics"] == [b"x"]
        capture.close()


class NoNodes:
    """A session without answers, and whose tokens come as the test says."""

    id = "own"
    settings = SimpleNamespace(namespace="")

    def __init__(self) -> None:
        self.asked = 0
        self.on_token: Callable[[str, bool], None]

    def has_asked_since(self, before: int) -> bool:
        """Whether a further question was asked."""
        return self.asked > before

    def watch_living(self, key: str, callback: Callable[[str, bool], None]) -> Any:
        """Keep what tokens are given to."""
        self.on_token = callback
        return SimpleNamespace(close=lambda: None)

    def ask(self, key: str, timeout_s: float) -> list[Any]:
        """No node answers."""
        self.asked += 1
        return []


@pytest.mark.usefixtures("network")
class TestNodes:
    def test_tokens_that_come_and_go_make_one_look_wait(self) -> None:
        """However often, the looks do not pile up, and the last state counts."""
        session = NoNodes()
        roster = NodeRoster(cast(Session, session), lambda *_: None, log=logging.getLogger("test"))
        for number in range(300):
            asked = session.asked
            session.on_token("@tfbus/node/sim", True)
            if number < 5:
                eventually(partial(session.has_asked_since, asked))
            session.on_token("@tfbus/node/sim", False)
            eventually(lambda: not roster._news)
        assert len(roster._executor._due) <= 10
        eventually(lambda: not roster._living)
        roster.close()
