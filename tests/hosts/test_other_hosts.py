"""Hosts that cannot be reached, or heard: the frames of all other hosts go on meanwhile."""

import json
from collections.abc import Callable, Iterator
from itertools import groupby

import pytest

from tests import needs
from tests.buses import eventually
from tests.hosts.network import Hosts, Network, frames
from tests.live_bus import Bus, Process

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]

# Links to one host: as many as block all of Zenoh's own threads, which are two.
LOST = ("arm", "base")
# Reports of the witness, five a second: longer than a thread is blocked.
REPORTS = 60
# Of them in a row without a newer frame of the other host: Zenoh's own threads stood still for 50.
MOST_WITHOUT = 25

# The hosts that are lost, and what is done to each.
FAULTS: dict[str, Callable[[Hosts, str], None]] = {
    "unplugged": lambda hosts, name: hosts.set_link(name, up=False),
    "deaf": lambda hosts, name: hosts.set_deaf(name, deaf=True),
    "mute": lambda hosts, name: hosts.set_mute(name, mute=True),
}


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus, *FAULTS, "dock", "desk")
    yield network
    network.close()


def most_without_news(witness: Process, since: int) -> int:
    """How many reports in a row since one of them had no newer frame of the other host."""
    stamps = [json.loads(line)["frames"]["crane"]["newest_ns"] for line in witness.out[since:]]
    return max(len(list(same)) - 1 for _, same in groupby(stamps))


@pytest.mark.parametrize("through_router", [False, True], ids=["peers", "router"])
def test_the_frames_of_other_hosts_go_on_while_some_are_lost(
    network: Network, through_router: bool
) -> None:
    """While hosts with two processes each are unplugged, deaf or mute, others hear each other."""
    if through_router:
        network.start_router()
    lost = {f"{host}_{name}": host for host in FAULTS for name in LOST}
    for name, host in {**lost, "crane": "dock"}.items():
        arguments = ("stream_publisher.py", name, "--moving", name)
        network.start(host, *arguments, client=through_router)
    witness = network.start("desk", "fault_witness.py", "witness", client=through_router)

    def are_lost_gone(gone: bool) -> bool:
        known = frames(witness)
        return {*lost, "crane"} <= known.keys() and all(
            known[name]["gone"] is gone for name in lost
        )

    eventually(lambda: are_lost_gone(False))
    before = len(witness.out)
    for host, fault in FAULTS.items():
        fault(network.hosts, host)
    eventually(lambda: are_lost_gone(True))
    eventually(lambda: len(witness.out) >= before + REPORTS)
    assert most_without_news(witness, before) <= MOST_WITHOUT
