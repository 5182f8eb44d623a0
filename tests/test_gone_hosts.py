"""Hosts that are unplugged and routers that are restarted: what is known of their frames."""

import json
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hosts
import pytest
from conftest import Bus, Process, eventually

REASON = hosts.why_not()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON or "-")

HERE = Path(__file__).parent
FRAMES = ["--moving", "robot", "--static", "camera", "--static", "lamp"]
# Without tfbus's own setting Zenoh notices a silent link after 10 s.
NOTICED_WITHIN_S = 8.0
# Zenoh looks for its neighbours again after 8 s at most.
HEALED_WITHIN_S = 40.0


class Network:
    """Three hosts; on one a publisher, on another a listener, on the third a router."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.hosts = hosts.Hosts("robot", "desk", "hub")
        self._router = f"tcp/{self.hosts.address['hub']}:7447"

    def start(self, host: str, script: str, *arguments: str, client: bool = False) -> Process:
        env = {"TFBUS_CONFIG": "", "TFBUS_CONNECT": ""}
        if client:
            env |= {"TFBUS_MODE": "client", "TFBUS_CONNECT": self._router}
        command = self.hosts.command(host, sys.executable, str(HERE / script), *arguments)
        return self._bus.start_command(command, env=env)

    def start_router(self) -> Process:
        command = self.hosts.command("hub", sys.executable, "-m", "tfbus", "router")
        router = self._bus.start_command(command, env={"TFBUS_CONFIG": "", "TFBUS_CONNECT": ""})
        router.wait_for_line("Routing on")
        return router


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus)
    yield network
    bus.close()
    network.hosts.close()


def frames(witness: Process) -> dict[str, Any]:
    """What the witness knew of each frame when it printed its last line."""
    told: dict[str, Any] = json.loads(witness.out[-1])["frames"] if witness.out else {}
    return told


def knows(witness: Process, *, gone: bool, camera_x: float) -> Callable[[], bool]:
    """Whether all three frames are known, so, and the camera is where it should be."""

    def known() -> bool:
        told = frames(witness)
        return (
            set(told) == {"robot", "camera", "lamp"}
            and all(frame["gone"] is gone for frame in told.values())
            and told["camera"]["x"] == camera_x
            and (gone or told["robot"]["age_s"] < 1.0)
        )

    return known


def test_the_frames_of_an_unplugged_host_are_gone_until_it_is_back(network: Network) -> None:
    """A host whose cable is pulled is noticed; back again, it brings what it changed meanwhile."""
    witness = network.start("desk", "fault_witness.py", "witness")
    publisher = network.start("robot", "stream_publisher.py", "sim", *FRAMES, "--correct", "camera")
    eventually(knows(witness, gone=False, camera_x=0.0))
    network.hosts.set_link("robot", up=False)
    eventually(knows(witness, gone=True, camera_x=0.0), within_s=NOTICED_WITHIN_S)
    publisher.signal(signal.SIGUSR1)
    network.hosts.set_link("robot", up=True)
    eventually(knows(witness, gone=False, camera_x=1.0), within_s=HEALED_WITHIN_S)
    assert len([line for line in witness.err if "is gone" in line]) == 1
    assert len([line for line in witness.err if "is back" in line]) == 1


def test_statics_come_back_after_the_routers_restart(network: Network) -> None:
    """Clients mark all frames while their router is away, and know all again after it."""
    router = network.start_router()
    witness = network.start("desk", "fault_witness.py", "witness", client=True)
    arguments = ["sim", *FRAMES, "--correct", "camera"]
    publisher = network.start("robot", "stream_publisher.py", *arguments, client=True)
    eventually(knows(witness, gone=False, camera_x=0.0))
    router.stop(signal.SIGKILL)
    eventually(knows(witness, gone=True, camera_x=0.0), within_s=NOTICED_WITHIN_S)
    publisher.signal(signal.SIGUSR1)
    network.start_router()
    late = network.start("desk", "fault_witness.py", "late", client=True)
    for each in (witness, late):
        eventually(knows(each, gone=False, camera_x=1.0), within_s=HEALED_WITHIN_S)
