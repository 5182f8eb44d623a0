"""Hosts that are unplugged and routers that restart: their frames at listeners."""

import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.network import ROUTER_HOST, Network, frames
from tests.live_bus import Bus, Process

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

FRAMES = ["--moving", "robot", "--static", "camera", "--static", "lamp"]


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus, "robot", "desk")
    yield network
    network.close()


def knows(witness: Process, *, gone: bool, camera_x: float) -> Callable[[], bool]:
    """Whether all three frames are known, so, and the camera is where it should be."""

    def known() -> bool:
        found = frames(witness)
        return (
            set(found) == {"robot", "camera", "lamp"}
            and all(frame["gone"] is gone for frame in found.values())
            and found["camera"]["x"] == camera_x
            and (gone or found["robot"]["age_s"] < 1.0)
        )

    return known


def test_the_frames_of_an_unplugged_host_are_gone_until_it_is_back(network: Network) -> None:
    """A host whose cable is pulled is noticed; back again, it brings what it changed meanwhile."""
    witness = network.start("desk", "fault_witness.py", "witness")
    publisher = network.start("robot", "stream_publisher.py", "sim", *FRAMES, "--correct", "camera")
    eventually(knows(witness, gone=False, camera_x=0.0))
    network.hosts.set_link("robot", up=False)
    eventually(knows(witness, gone=True, camera_x=0.0))
    publisher.signal(signal.SIGUSR1)
    network.hosts.set_link("robot", up=True)
    eventually(knows(witness, gone=False, camera_x=1.0))
    # Its transforms may come before its token does.
    witness.wait_for_line("is back")
    told = re.findall("is (gone|back)", "\n".join(witness.err))
    # On a busy host a link may be lost once more.
    assert told == (["gone", "back"] * len(told))[: len(told)]


def test_statics_come_back_after_the_routers_restart(network: Network) -> None:
    """Clients mark all frames while their router is away, and know all again after it."""
    router = network.start_router()
    witness = network.start("desk", "fault_witness.py", "witness", client=True)
    arguments = ["sim", *FRAMES, "--correct", "camera"]
    publisher = network.start("robot", "stream_publisher.py", *arguments, client=True)
    eventually(knows(witness, gone=False, camera_x=0.0))
    router.stop(signal.SIGKILL)
    eventually(knows(witness, gone=True, camera_x=0.0))
    publisher.signal(signal.SIGUSR1)
    network.start_router()
    late = network.start("desk", "fault_witness.py", "late", client=True)
    for each in (witness, late):
        eventually(knows(each, gone=False, camera_x=1.0))


class Introduced:
    """A publisher and a listener without multicast, on two hosts; a process that both name with
    `--connect` introduces them.
    """

    def __init__(self, network: Network, folder: Path) -> None:
        config = folder / "no_multicast.json5"
        config.write_text("{scouting: {multicast: {enabled: false}}}")
        env = {"TFBUS_CONFIG": str(config)}
        listening = env | {"TFBUS_LISTEN": "tcp/0.0.0.0:7447"}
        network.start(ROUTER_HOST, "fault_witness.py", "named", env=listening)
        calling = env | {"TFBUS_CONNECT": network.router}
        self.listener = network.start("desk", "fault_witness.py", "listener", env=calling)
        self.publisher = network.start(
            "robot", "stream_publisher.py", "sim", "--moving", "robot", env=calling
        )

    def robot_is(self, *, gone: bool) -> Callable[[], bool]:
        """Whether the listener has the frame marked so and, where it is not gone, fresh."""

        def known() -> bool:
            robot = frames(self.listener).get("robot", {})
            return robot.get("gone") is gone and (gone or robot["age_s"] < 1.0)

        return known


def test_an_unplugged_host_is_met_again_without_multicast(network: Network, tmp_path: Path) -> None:
    """A host that was cut off connects to the named process again, which introduces it to all."""
    peers = Introduced(network, tmp_path)
    for host in ("robot", "desk"):
        eventually(peers.robot_is(gone=False))
        network.hosts.set_link(host, up=False)
        eventually(peers.robot_is(gone=True))
        network.hosts.set_link(host, up=True)
    eventually(peers.robot_is(gone=False))


def test_a_process_that_stood_still_is_met_again_without_multicast(
    network: Network, tmp_path: Path
) -> None:
    """A process that did not run for longer than the lease is back after it runs again."""
    peers = Introduced(network, tmp_path)
    eventually(peers.robot_is(gone=False))
    peers.publisher.signal(signal.SIGSTOP)
    eventually(peers.robot_is(gone=True))
    peers.publisher.signal(signal.SIGCONT)
    eventually(peers.robot_is(gone=False))
