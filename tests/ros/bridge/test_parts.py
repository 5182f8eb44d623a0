"""The parts of the bridge by themselves."""

import logging
import math
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.builders import S, at
from tests.fakes import Clock
from tests.ros.bridge.fake_leg import FakeRos, FakeSubscription
from tests.simulated_bus import Bus
from tfbus.base.clock import Timer
from tfbus.base.errors import TfbusError
from tfbus.base.executor import Executor
from tfbus.geometry.columns import Columns
from tfbus.ros.bridge import common, routes
from tfbus.ros.bridge.bridge import Bridge
from tfbus.ros.bridge.common import BridgeOptions, Crossed, RosFrameNames
from tfbus.ros.bridge.legs import LegSettings, OnMessage, RosTopic, open_leg
from tfbus.ros.bridge.routes import RateLimit, invalid_rows
from tfbus.ros.bridge.topic_table import TopicTable


def rows(*children: str, stamp_ns: int = S) -> Columns:
    """One row of each child."""
    return Columns.of_transforms([at(1.0, child, stamp_ns) for child in children])


def test_patterns_are_those_of_a_shell() -> None:
    """And nothing given is everything."""
    assert BridgeOptions().selects("x")
    options = BridgeOptions(frames=("arm_*", "base"))
    assert [options.selects(each) for each in ("arm_1", "base", "base2", "leg")] == [
        True,
        True,
        False,
        False,
    ]
    assert BridgeOptions(ros_namespace="/robot1/").topic("tf") == "/robot1/tf"


def test_the_leg_over_zenoh_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without xxhash the command that installs it."""
    for module in ("ros.bridge.legs.zenoh", "ros.rmw_zenoh"):
        monkeypatch.delitem(sys.modules, f"tfbus.{module}", raising=False)
    monkeypatch.setitem(sys.modules, "xxhash", None)
    with pytest.raises(TfbusError, match=r"xxhash.*pip install"):
        open_leg("zenoh", LegSettings("bridge"), logging.getLogger("bridge"))


def test_names_go_there_and_back() -> None:
    """With a prefix, and where ROS has a frame of that name itself."""
    names = RosFrameNames(BridgeOptions(frame_prefix="r1/"))
    assert names.on_bus("/base") == names.on_bus("base") == "r1/base"
    assert names.in_ros("r1/base") == "base" and names.in_ros("world") == "world"
    assert names.met("world") and not names.met("/world")
    assert names.in_ros("world") is None and names.in_ros("r1/world") == "world"
    assert names.in_ros("r1/") == "r1/"
    assert names.mistake_in("/") == "must not be empty" and not names.mistake_in("base")


def test_a_row_that_has_crossed_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of another stamp does, once it is known what has crossed; other frames always."""
    clock = Clock()
    monkeypatch.setattr(common, "scheduler", clock)
    contested: list[None] = []
    crossed = Crossed(lambda: contested.append(None))
    assert not crossed.record("to ROS", ["a", "b"])
    assert not crossed.record("from ROS", ["c"]) and not contested
    assert crossed.record("from ROS", ["a"]) and contested
    assert crossed.crosses("from ROS", rows("a", "c", stamp_ns=S)) == [1]
    clock.now_ns = 2 * S
    assert crossed.crosses("to ROS", rows("a", "b", stamp_ns=2 * S)) == [0, 1]
    assert crossed.crosses("from ROS", rows("a", stamp_ns=2 * S)) == []
    assert crossed.crosses("from ROS", rows("a", stamp_ns=3 * S)) == [0]
    assert crossed.crosses("to ROS", rows("a", stamp_ns=3 * S)) == []
    crossed.forget("from ROS", ["a"])
    assert crossed.crosses("to ROS", rows("a", stamp_ns=3 * S)) == [0]


def test_the_memory_of_stamps_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest go."""
    clock = Clock()
    monkeypatch.setattr(common, "scheduler", clock)
    crossed = Crossed(lambda: None)
    crossed.record("to ROS", ["a"])
    crossed.record("from ROS", ["a"])
    clock.now_ns = 2 * S
    for number in range(1000):
        assert crossed.crosses("to ROS", rows("a", stamp_ns=number)) == [0]
    assert crossed.crosses("from ROS", rows("a", stamp_ns=999)) == []
    assert crossed.crosses("from ROS", rows("a", stamp_ns=1)) == [0]


def test_the_newest_row_goes_when_its_time_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first at once; each frame by itself."""
    clock = Clock()
    monkeypatch.setattr(routes, "scheduler", clock)
    sent: list[tuple[str, int]] = []

    def send(columns: Columns) -> None:
        sent.extend((each.child_frame_id, each.stamp_ns) for each in columns)

    executor = Executor("test", logging.getLogger("test"))
    limit = RateLimit(1e-3, send, executor)
    try:
        limit.pass_on(rows("a", stamp_ns=1))
        limit.pass_on(rows("a", "b", stamp_ns=2))
        limit.pass_on(rows("a", stamp_ns=3))
        assert sent == [("a", 1), ("b", 2)]
        clock.now_ns = 1001 * S
        limit.flush()
        assert sent == [("a", 1), ("b", 2), ("a", 3)]
        limit.flush()
        limit.pass_on(rows("b", stamp_ns=4))
        assert sent[3:] == [("b", 4)]
    finally:
        limit.close()
        executor.close()


class NotedTimers(Executor):
    """An executor that notes which timers it was given."""

    def __init__(self) -> None:
        super().__init__("test", logging.getLogger("test"))
        self.given: list[Timer] = []

    def every(self, period_s: float, callback: Callable[[], Any], **more: Any) -> Timer:
        self.given.append(super().every(period_s, callback, **more))
        return self.given[-1]

    @property
    def running(self) -> list[Timer]:
        """The timers that have neither fired nor been cancelled."""
        return [timer for timer in self.given if not timer.cancelled]


def test_no_timer_runs_where_nothing_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand times a second nothing would be done."""
    clock = Clock()
    monkeypatch.setattr(routes, "scheduler", clock)
    executor = NotedTimers()
    limit = RateLimit(1e-3, lambda columns: None, executor)
    try:
        limit.pass_on(rows("a"))
        assert not executor.running
        limit.pass_on(rows("a"))
        limit.pass_on(rows("a"))
        assert len(executor.running) == 1
        clock.now_ns = 1001 * S
        limit.flush()
        assert not executor.running
        limit.pass_on(rows("a"))
        limit.close()
        limit.pass_on(rows("a"))
        assert not executor.running
    finally:
        limit.close()
        executor.close()


def test_rows_that_are_no_transform_are_found() -> None:
    """Few or many of them."""
    good = [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]
    nan, none, long = [math.nan, *good[1:]], [0.0] * 7, [*good[:6], 1.0]
    infinite = [1.0, math.inf, *good[2:]]
    for count in (0, 10):
        poses = [good, nan, none, *[good] * count, long, infinite]
        found = Columns.of_bytes(
            ("a", "b"),
            np.tile(np.array([0, 1], np.uint32), len(poses)).tobytes(),
            np.zeros(len(poses), np.int64).tobytes(),
            np.array(poses).tobytes(),
        )
        assert list(invalid_rows(found)) == [1, 2, 3 + count, 4 + count]
    assert not invalid_rows(rows("a", "b", "c", "d", "e")) and not invalid_rows(rows("a"))


@pytest.mark.parametrize("topic", ["/tf", "/tf_static", "/clock"])
def test_a_bridge_that_cannot_be_made_leaves_ros(bus: Bus, topic: str) -> None:
    """Whatever it fails at: nothing of it stays in ROS, and no thread."""
    ros = FakeRos()
    leg = ros.leg()
    subscribe = leg.subscribe

    def refusing(wanted: RosTopic, on_message: OnMessage) -> FakeSubscription:
        if wanted.name == topic:
            raise TfbusError("refused")
        return subscribe(wanted, on_message)

    leg.subscribe = refusing
    node = bus.node("ros2")
    with pytest.raises(TfbusError, match="refused"):
        Bridge(node, leg, BridgeOptions(), table=TopicTable())
    assert not ros.senders and not ros.subscriptions
    names = [each.name for each in threading.enumerate()]
    assert f"{node.full_name} ROS" not in names and f"{node.full_name} topics" not in names
