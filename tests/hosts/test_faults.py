"""Processes killed and links cut on real hosts: all listeners know all frames again."""

import random
from collections.abc import Iterator

import pytest

from tests import needs
from tests.hosts.faults import MOST_GROWTH_KB, WITNESSES, InjuredHosts, wait_until_well
from tests.live_bus import Bus

REASON = needs.why_no_hosts()
pytestmark = [pytest.mark.real, pytest.mark.skipif(bool(REASON), reason=REASON or "-")]


@pytest.fixture
def injured(bus: Bus, request: pytest.FixtureRequest) -> Iterator[InjuredHosts]:
    """Four hosts with publishers, witnesses and a router."""
    seed = request.config.getoption("--fault-seed")
    if seed is None:
        seed = random.randrange(1_000_000)
    print(f"pytest tests/hosts/test_faults.py --fault-seed {seed}")
    world = InjuredHosts(bus, seed)
    yield world
    bus.close()
    world.close()


def test_all_frames_are_known_again_after_each_healing(
    injured: InjuredHosts, pytestconfig: pytest.Config
) -> None:
    """Processes are killed, restarted and stopped, links cut, and addresses and interfaces changed,
    in random order; after each healing every listener has every static and living frame, frames of
    killed publishers are gone, no other process has ended, and memory is flat.
    """
    wait_until_well(injured)
    before_kb = {name: injured.report(name)["resident_kb"] for name in WITNESSES}
    for number in range(1, 1 + pytestconfig.getoption("--fault-rounds")):
        injured.history.append(f"round {number}")
        injured.injure()
        injured.heal()
        print(f"round {number}: well after {wait_until_well(injured):.1f} s")
        assert injured.died() == []
    after_kb = {name: injured.report(name)["resident_kb"] for name in WITNESSES}
    assert all(after_kb[name] - before_kb[name] < MOST_GROWTH_KB for name in WITNESSES)
