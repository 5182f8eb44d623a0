"""The fixture `network` of pytest: a simulated network for one test."""

import argparse
import random
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tfbus.testing.network import Network


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of the seed."""
    group = parser.getgroup("tfbus", "tfbus, simulated networks")
    group.addoption(
        "--tfbus-seed",
        default="0",
        type=_seed,
        metavar="N",
        help="seed of the fixture network: a number, or random for another one each time",
    )


def _seed(given: str) -> str:
    if given != "random" and not given.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{given!r} is no seed: give a number from 0 on, or random"
        )
    return given


@pytest.fixture
def network(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> "Iterator[Network]":
    """A simulated network, in force during the test; its seed is in the report of a failure.

    Settings of the environment (TFBUS_MODE and others) have no effect on its nodes.
    """
    from tfbus.testing.network import Network  # only where a test asks for it

    given = request.config.getoption("--tfbus-seed")
    seed = random.randrange(2**32) if given == "random" else int(given)
    request.node.add_report_section("setup", "tfbus", f"again: --tfbus-seed {seed}")
    with Network(seed) as made:
        yield made
