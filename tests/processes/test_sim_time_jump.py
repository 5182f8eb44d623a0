"""A simulated clock that is set back while transforms flow: nothing is left of the future."""

from collections.abc import Iterator

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.processes.sim_time import SECOND, Remote, follower, start_clock
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)


@pytest.fixture
def buffer(bus: Bus) -> Iterator[Buffer]:
    """A buffer that receives a carrot around turtle1, by a clock that started at 1000 s."""
    start_clock(bus, "--start", "1000s")
    bus.start("carrot", "--sim-time", "--param", "dynamic=true")
    bus.start("static", "turtle1", "mast", "--z", "1", "--sim-time")
    node = follower(bus, "listener")
    buffer = Buffer()
    with TransformListener(buffer, node):
        assert node.wait_for_clock(DEADLINE_S)
        eventually(lambda: buffer.can_transform("turtle1", "carrot1"))
        eventually(lambda: buffer.can_transform("turtle1", "mast"))
        yield buffer


def latest(buffer: Buffer) -> int:
    """The newest stamp of the carrot, 0 where there is none."""
    known = buffer.can_transform("turtle1", "carrot1")
    return (buffer.latest_common_time("turtle1", "carrot1") or 0) if known else 0


def test_lookups_go_on_after_a_jump_back(bus: Bus, buffer: Buffer) -> None:
    """Set back by a quarter of an hour, listeners know the new present and nothing of the old."""
    remote = bus.node("remote", sim_time=True)
    Remote(remote).pause_and_set(10.0)
    Remote(remote).resume()
    eventually(lambda: 10 * SECOND < latest(buffer) < 100 * SECOND)
    answer = buffer.lookup_transform("turtle1", "carrot1", timeout_s=1.0)
    assert 10 * SECOND < answer.stamp_ns < 100 * SECOND
    assert buffer.lookup_transform("turtle1", "mast").transform.z == 1.0


def test_a_small_jump_back_forgets_the_future_only(bus: Bus) -> None:
    """Set back by half a second, a listener forgets that half second and keeps what was before."""
    start_clock(bus, "--paused", "--start", "1000s")
    node, sender = follower(bus, "listener"), follower(bus, "sender")
    remote = Remote(node)
    buffer = Buffer()
    broadcaster = TransformBroadcaster(sender)
    StaticTransformBroadcaster(sender).send_transform(
        TransformStamped(0, "base", "mast", Transform((0.0, 0.0, 1.0)))
    )
    with TransformListener(buffer, node) as listener:
        assert node.wait_for_clock(DEADLINE_S)

        def send(stamp_ns: int) -> bool:
            broadcaster.send_transform(TransformStamped(stamp_ns, "odom", "base", Transform()))
            return buffer.can_transform("odom", "mast", stamp_ns)

        for second in (1000, 1001):
            eventually(lambda second=second: send(second * SECOND))
        remote.set(1001.0)
        remote.set(1000.5)
        assert buffer.latest_common_time("odom", "mast") == 1000 * SECOND
        assert buffer.can_transform("base", "mast")
        # The clock's own messages are none of transforms.
        assert listener.rejected.total() == 0


def test_a_buffer_takes_the_clock_of_its_listeners_node(bus: Bus) -> None:
    """A buffer goes by the clock of the node that fills it, unless it was given another."""
    node = follower(bus)
    plain = Buffer()
    other = Buffer(clock=lambda: 7)
    with TransformListener(plain, node), TransformListener(other, node):
        assert plain.clock is node.clock
        assert other.clock() == 7
    assert node.now_ns() == 0
