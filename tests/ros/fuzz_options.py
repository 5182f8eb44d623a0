"""A plugin of pytest: how many spoilt messages of ROS the tests read."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option."""
    parser.addoption(
        "--fuzz-messages",
        type=int,
        default=20_000,
        help="spoilt messages of ROS that are read (default: 20000)",
    )
