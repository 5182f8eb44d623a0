"""Many publishers of static frames, and listeners that come at any time: none misses a frame."""

import sys
from pathlib import Path

import pytest

from tests.live_bus import Bus, Process, eventually, free_port
from tests.processes.many_publishers import frame
from tfbus import Buffer, Node, TransformListener

pytestmark = pytest.mark.real

SCRIPT = Path(__file__).parent / "many_publishers.py"
STREAMS = 50
STATICS = 20

# On two cores the meeting of fifty processes takes seconds, with any program.
MET_WITHIN_S = 90.0


class Joining:
    """A listener, and the frames that it has come to know."""

    def __init__(self, node: Node) -> None:
        self.buffer = Buffer()
        TransformListener(self.buffer, node)

    def knows_all(self) -> bool:
        """Whether each static frame of each stream is there, where it was put."""
        if len(self.buffer.frames()) < STREAMS * STATICS + 1:  # and `world`
            return False
        return all(
            self.buffer.lookup_transform("world", frame(number, i)).transform.xyz.tolist()
            == [number, i, 0.0]
            for number in range(STREAMS)
            for i in range(STATICS)
        )


class Meeting:
    """Publishers and listeners that are peers, each linked with each, or clients of a router."""

    def __init__(self, bus: Bus, *, clients: bool) -> None:
        self._bus = bus
        self._env = {"TFBUS_CONFIG": str(bus.quick_config)}
        self._given: dict[str, object] = {}
        if clients:
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            router = bus.start("router", "--listen", endpoint)
            router.wait_for_line("Routing on")
            self._env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint}
            self._given |= {"mode": "client", "connect": (endpoint,)}

    def publish(self) -> Process:
        """Fifty processes, started."""
        command = [sys.executable, str(SCRIPT), str(STREAMS), str(STATICS)]
        return self._bus.start_command(command, env=self._env)

    def join(self, name: str) -> Joining:
        """A listener that comes now."""
        return Joining(self._bus.node(name, **self._given))


def are_ready(publishers: Process, number: int) -> bool:
    """Whether this many of the publishers have joined the bus."""
    return sum("ready" in line for line in publishers.err) >= number


@pytest.mark.parametrize("clients", [False, True], ids=["peers", "clients"])
def test_all_statics_are_known_whichever_process_starts_first(bus: Bus, clients: bool) -> None:
    """A listener comes to know the twenty static frames of each of fifty processes; it may come
    before, amid or after them.
    """
    meeting = Meeting(bus, clients=clients)
    listeners = [meeting.join("before")]
    publishers = meeting.publish()
    for name, number in (("amid", STREAMS // 2), ("after", STREAMS)):
        eventually(lambda number=number: are_ready(publishers, number), within_s=MET_WITHIN_S)
        listeners.append(meeting.join(name))
    for listener in listeners:
        eventually(listener.knows_all, within_s=MET_WITHIN_S)
