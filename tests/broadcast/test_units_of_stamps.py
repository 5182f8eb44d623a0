"""A stamp in seconds is sent as it is, but not without a word."""

import logging
import time

import pytest

from tests.builders import at
from tests.fakes import Lines
from tests.live_bus import Bus
from tfbus import Node, TransformBatch, TransformBroadcaster


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
    assert line.startswith(
        f"Sent a transform of 1970: the stamp {stamp} looks like {unit}, but stamps are "
        f"nanoseconds: tfbus.stamp_ns({stamp // factor}) makes one of seconds"
    )


def test_stamps_of_now_and_small_ones_are_not_logged(sender: Node) -> None:
    """A simulation counts from 0, also where its node has no simulated clock."""
    log = Lines(sender.log, logging.WARNING)
    broadcaster = TransformBroadcaster(sender)
    for stamp in (0, 10**7, 1_500_000_000, 60 * 10**9, time.time_ns()):
        broadcaster.send_transform(at(stamp_ns=stamp))
    broadcaster.send_transform([])
    assert log.lines == []


def test_a_simulated_clock_may_come_by_any_stamp(bus: Bus) -> None:
    """Where the node's clock is simulated, 1.7 s is right."""
    node = bus.node("sim", sim_time=True)
    log = Lines(node.log, logging.WARNING)
    broadcaster = TransformBroadcaster(node)
    broadcaster.send_transform(at(stamp_ns=int(time.time())))
    assert [line for line in log.lines if "looks like" in line] == []
