"""A stamp in seconds, or ahead of the clock, is sent as it is, but not without a word."""

import logging
import time

import pytest

from tests.builders import at
from tests.buses import eventually
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import Node, TransformBatch, TransformBroadcaster
from tfbus.messages import Clock

HOUR_NS = 3_600_000_000_000


@pytest.mark.parametrize(
    ("factor", "unit"), [(1, "seconds"), (10**3, "milliseconds"), (10**6, "microseconds")]
)
def test_a_stamp_in_another_unit_is_logged_once(sender: Node, factor: int, unit: str) -> None:
    """The first is named; every one is sent, alone or in a batch."""
    log = Lines(sender.log, logging.WARNING)
    broadcaster = TransformBroadcaster(sender)
    stamp = int(time.time()) * factor
    broadcaster.send_transform(at(1.0, stamp_ns=stamp))
    broadcaster.send_transform(TransformBatch.from_transforms([at(2.0, stamp_ns=stamp)]))
    (line,) = log.lines
    assert "1970: " in line and f"stamp {stamp} looks like {unit}, " in line
    assert f"tfbus.stamp_ns({stamp // factor})" in line


def test_stamps_of_zero_are_logged_once(sender: Node) -> None:
    """A hundred are the first step of a simulation; who sends more does not stamp."""
    log = Lines(sender.log, logging.WARNING)
    broadcaster = TransformBroadcaster(sender)
    for _ in range(100):
        broadcaster.send_transform(at(stamp_ns=0))
    assert log.lines == []
    for _ in range(100):
        broadcaster.send_transform(at(stamp_ns=0))
    (line,) = log.lines
    assert line.startswith("Sent 101 transforms ") and "stamp 0" in line
    assert "node.now_ns()" in line


def test_stamps_of_now_and_small_ones_are_not_logged(sender: Node) -> None:
    """A simulation counts from 0, also where its node has no simulated clock."""
    log = Lines(sender.log, logging.WARNING)
    broadcaster = TransformBroadcaster(sender)
    for stamp in (0, 10**7, 1_500_000_000, 60 * 10**9, time.time_ns()):
        broadcaster.send_transform(at(stamp_ns=stamp))
    broadcaster.send_transform([])
    # Of a recording, and what was computed for a moment.
    for stamp in (time.time_ns() - HOUR_NS, time.time_ns() + 10_000_000):
        broadcaster.send_transform(at(stamp_ns=stamp))
    assert log.lines == []


@pytest.mark.parametrize("as_batch", [False, True])
def test_a_stamp_ahead_of_the_clock_is_logged_once_per_stream(sender: Node, as_batch: bool) -> None:
    """Whichever broadcaster sends it, and also where stamps were right at first."""
    log = Lines(sender.log, logging.WARNING)
    broadcasters = [TransformBroadcaster(sender), TransformBroadcaster(sender)]
    for broadcaster in broadcasters:
        broadcaster.send_transform(at(stamp_ns=time.time_ns()))
    for broadcaster in [*broadcasters, *broadcasters]:
        one = at(stamp_ns=time.time_ns() + HOUR_NS)
        broadcaster.send_transform(TransformBatch.from_transforms([one]) if as_batch else one)
    TransformBroadcaster(sender, stream="arm").send_transform(at(stamp_ns=time.time_ns() + HOUR_NS))
    first, other = log.lines
    assert "60 min in the future" in first and f"in stream {sender.name!r}: " in first
    assert "node.now_ns()" in first
    assert "in stream 'arm'" in other


def test_a_simulated_time_is_not_ahead_of_the_clock(bus: Bus) -> None:
    """Neither for a node that follows it, nor for one that makes it."""
    follower, maker = bus.node("follower", sim_time=True), bus.node("maker")
    clock = maker.create_clock_publisher()
    logs = [Lines(node.log, logging.WARNING) for node in (follower, maker)]
    now_ns = time.time_ns() + HOUR_NS
    clock.publish(Clock(now_ns))
    eventually(lambda: follower.now_ns() == now_ns)
    for node in (follower, maker):
        TransformBroadcaster(node).send_transform(at(stamp_ns=now_ns + HOUR_NS))
    assert [line for log in logs for line in log.lines if "in the future" in line] == []


def test_a_simulated_clock_may_come_by_any_stamp(bus: Bus) -> None:
    """Where the node's clock is simulated, 1.7 s is right."""
    node = bus.node("sim", sim_time=True)
    log = Lines(node.log, logging.WARNING)
    broadcaster = TransformBroadcaster(node)
    broadcaster.send_transform(at(stamp_ns=int(time.time())))
    assert [line for line in log.lines if "looks like" in line] == []
