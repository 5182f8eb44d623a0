"""Simulated time for tests: a clock in a process of its own, and a node that follows it."""

from tests.buses import DEADLINE_S, eventually
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import Empty, SetClock
from tfbus.testing.programs import Program

SECOND = 1_000_000_000


def start_clock(bus: Bus, *options: str) -> Program:
    """`tfbus clock` with these options, once it publishes the time."""
    clock = bus.start("clock", *options)
    clock.wait_for_line("It is ")
    return clock


def follower(bus: Bus, name: str = "follower", **given: object) -> Node:
    """A node of simulated time, in this process."""
    return bus.node(name, sim_time=True, **given)


class Remote:
    """A clock's services, called from a node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._set = node.create_client(SetClock, "clock/set")
        self._pause = node.create_client(Empty, "clock/pause")
        self._resume = node.create_client(Empty, "clock/resume")

    def set(self, second: float) -> None:
        """Set it, and wait until the node knows."""
        stamp_ns = round(second * SECOND)
        self._set.call(SetClock.Request(stamp_ns), timeout_s=DEADLINE_S)
        eventually(lambda: self._node.now_ns() == stamp_ns)

    def pause_and_set(self, second: float) -> None:
        """Set it while it stands still, and wait until the node knows."""
        self.pause()
        self.set(second)

    def pause(self) -> None:
        """Let it stand still."""
        self._pause.call(Empty.Request(), timeout_s=DEADLINE_S)

    def resume(self) -> None:
        """Let it go on."""
        self._resume.call(Empty.Request(), timeout_s=DEADLINE_S)
