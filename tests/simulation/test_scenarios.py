"""The model of Zenoh and Zenoh itself show applications the same."""

from collections.abc import Callable, Iterator

import pytest

from tests import needs
from tests.builders import examples
from tests.simulation.scenarios import SCENARIOS
from tests.simulation.stages import RealStage, SimulatedStage, Stage
from tfbus.testing.network import Network

PLAYS = pytest.mark.parametrize("play", SCENARIOS.values(), ids=SCENARIOS)


@PLAYS
def test_the_model_plays_it(play: Callable[[Stage], None]) -> None:
    """The scenario holds in the model, however tasks interleave."""
    for seed in range(examples(5)):
        with Network(seed, interleaving=20) as network:
            play(SimulatedStage(network))


@pytest.fixture(scope="module")
def hosts(real: None) -> Iterator[RealStage]:
    """Three hosts on one network."""
    if why := needs.why_no_hosts():
        needs.skip(why)
    stage = RealStage()
    yield stage
    stage.close()


@PLAYS
def test_zenoh_plays_it(play: Callable[[Stage], None], hosts: RealStage) -> None:
    """The scenario holds between real sessions of Zenoh on real hosts."""
    try:
        play(hosts)
    finally:
        hosts.clear()
