"""Many publishers of static frames, and listeners that come at any time: none misses a frame."""

import sys
from pathlib import Path

import pytest

from tests import simulated_bus
from tests.buses import eventually
from tests.live_bus import Bus, free_port
from tests.processes.many_publishers import frame, publish
from tfbus import Buffer, Node, TransformListener

SCRIPT = Path(__file__).parent / "many_publishers.py"
STREAMS = 50
STATICS = 20


class Joining:
    """A listener, and the frames that it has come to know."""

    def __init__(self, node: Node, streams: int = STREAMS) -> None:
        self.buffer = Buffer()
        self._streams = streams
        TransformListener(self.buffer, node)

    def knows_all(self) -> bool:
        """Whether each static frame of each stream is there, where it was put."""
        if len(self.buffer.frames()) < self._streams * STATICS + 1:  # and `world`
            return False
        return all(
            self.buffer.lookup_transform("world", frame(number, i)).transform.xyz.tolist()
            == [number, i, 0.0]
            for number in range(self._streams)
            for i in range(STATICS)
        )


def publish_statics() -> None:
    """As `many_publishers.publish`, of the number on its command line."""
    publish(int(sys.argv[1]), STATICS)


def test_all_statics_are_known_whichever_process_starts_first(bus: simulated_bus.Bus) -> None:
    """A listener comes to know the twenty static frames of each of ten processes; it may come
    before, amid or after them.
    """
    streams = 10
    listeners = [Joining(bus.node("before"), streams)]
    programs = [
        bus.network.program("outside", publish_statics, str(number), env=bus.env)
        for number in range(streams)
    ]
    for name, number in (("amid", streams // 2), ("after", streams)):
        eventually(lambda number=number: sum(bool(each.err) for each in programs) >= number)
        listeners.append(Joining(bus.node(name), streams))
    for listener in listeners:
        eventually(listener.knows_all)


@pytest.mark.real
def test_statics_of_clients_are_known_whichever_process_starts_first(bus: Bus) -> None:
    """The same of real processes, which are clients of a router."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    bus.start("router", "--listen", endpoint).wait_for_line("Routing on")
    listeners = [Joining(bus.node("before", mode="client", connect=(endpoint,)))]
    publishers = bus.start_command(
        [sys.executable, str(SCRIPT), str(STREAMS), str(STATICS)],
        env={"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint},
    )

    def are_ready(number: int) -> bool:
        return sum("ready" in line for line in publishers.err) >= number

    for name, number in (("amid", STREAMS // 2), ("after", STREAMS)):
        eventually(lambda number=number: are_ready(number))
        listeners.append(Joining(bus.node(name, mode="client", connect=(endpoint,))))
    for listener in listeners:
        eventually(listener.knows_all)
