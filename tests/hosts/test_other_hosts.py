"""A host that cannot be reached, or heard: the frames of all other hosts go on meanwhile."""

import json
from collections.abc import Callable, Iterator

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
# Zenoh's own threads stood still for 10 s.
MOST_AGE_S = 5.0

FAULTS: dict[str, Callable[[Hosts], None]] = {
    "unplugged": lambda hosts: hosts.set_link("robot", up=False),
    "deaf": lambda hosts: hosts.set_deaf("robot", deaf=True),
    "mute": lambda hosts: hosts.set_mute("robot", mute=True),
}


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus, "robot", "dock", "desk")
    yield network
    network.close()


def crane_ages_s(witness: Process, since: int) -> list[float]:
    """How old the frame of the other host was in each report since one of them."""
    reports = [json.loads(line)["frames"] for line in witness.out[since:]]
    return [report["crane"]["age_s"] for report in reports]


@pytest.mark.parametrize("through_router", [False, True], ids=["peers", "router"])
@pytest.mark.parametrize("fault", FAULTS)
def test_the_frames_of_other_hosts_go_on_while_one_is_lost(
    network: Network, fault: str, through_router: bool
) -> None:
    """While a host with two processes is unplugged, deaf or mute, others hear each other."""
    if through_router:
        network.start_router()
    for host, name in (*(("robot", name) for name in LOST), ("dock", "crane")):
        arguments = ("stream_publisher.py", name, "--moving", name)
        network.start(host, *arguments, client=through_router)
    witness = network.start("desk", "fault_witness.py", "witness", client=through_router)

    def are_lost_gone(gone: bool) -> bool:
        known = frames(witness)
        return {*LOST, "crane"} <= known.keys() and all(
            known[name]["gone"] is gone for name in LOST
        )

    eventually(lambda: are_lost_gone(False))
    before = len(witness.out)
    FAULTS[fault](network.hosts)
    eventually(lambda: are_lost_gone(True))
    eventually(lambda: len(witness.out) >= before + REPORTS)
    assert max(crane_ages_s(witness, before)) < MOST_AGE_S
