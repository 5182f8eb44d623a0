"""A plugin of pytest: how often the test of faults injures its hosts, and its seed."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options."""
    parser.addoption("--fault-rounds", type=int, default=2, help="rounds of faults (default: 2)")
    parser.addoption(
        "--fault-seed", type=int, default=None, help="seed of the faults (default: new)"
    )
