"""Many publishers of static frames, and listeners that come at any time: nobody misses one."""

import sys
from pathlib import Path

import pytest
from conftest import Bus, Process, eventually, free_port

from tfbus import Buffer, Node, TransformListener

SCRIPT = Path(__file__).parent / "many_publishers.py"
PROCESSES = 2
STREAMS = 25
STATICS = 20

# A second after who joins has met the publishers, on a machine that is ten times as busy.
MET_S = 10.0


class Meeting:
    """Publishers and listeners that are peers, or clients of a router."""

    def __init__(self, bus: Bus, *, clients: bool) -> None:
        self._bus = bus
        self._env = {"TFBUS_CONFIG": str(bus.quick_config)}
        self._given: dict[str, object] = {}
        # Of peers each is linked with each, so there are fewer of them, with several streams.
        self._nodes, self._streams = (STREAMS, 1) if clients else (5, STREAMS // 5)
        if clients:
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            router = bus.start("router", "--listen", endpoint)
            router.wait_for_line("Routing on")
            self._env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint}
            self._given |= {"mode": "client", "connect": (endpoint,)}

    def publish(self) -> list[Process]:
        """Fifty streams in two processes, started."""
        return [
            self._bus.start_command(
                [
                    sys.executable,
                    str(SCRIPT),
                    *map(str, (first, self._nodes, self._streams, STATICS)),
                ],
                env=self._env,
            )
            for first in range(0, PROCESSES * STREAMS, STREAMS)
        ]

    def node(self, name: str) -> Node:
        return self._bus.node(name, **self._given)


def has_met_all(listener: TransformListener) -> bool:
    """Whether it knows that each stream is there."""
    return sum(info.alive for info in listener.streams()) == PROCESSES * STREAMS


def knows_all(buffer: Buffer) -> bool:
    """Whether each static frame of each stream can be looked up, where it was put."""
    if len(buffer.frames()) < PROCESSES * STREAMS * STATICS + 1:
        return False
    return all(
        buffer.lookup_transform("world", f"s{stream}_{i}").transform.xyz[:2].tolist() == [stream, i]
        for stream in range(PROCESSES * STREAMS)
        for i in range(STATICS)
    )


@pytest.mark.parametrize("clients", [False, True], ids=["peers", "clients"])
def test_whoever_comes_first_all_statics_are_known(bus: Bus, tmp_path: Path, clients: bool) -> None:
    """A listener knows all of 1,000 static frames of 50 streams soon after it has met these,
    before, amid or after them.
    """
    meeting = Meeting(bus, clients=clients)
    with TransformListener(Buffer(), meeting.node("before")) as before:
        publishers = meeting.publish()
        publishers[0].wait_for_line("ready")
        with TransformListener(Buffer(), meeting.node("amid")) as amid:
            publishers[1].wait_for_line("ready")
            with TransformListener(Buffer(), meeting.node("after")) as after:
                for listener in (before, amid, after):
                    eventually(lambda listener=listener: has_met_all(listener), within_s=40.0)
                    eventually(lambda listener=listener: knows_all(listener.buffer), within_s=MET_S)
