"""A plugin of pytest: how long threads write to and read from one buffer at once."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option."""
    parser.addoption(
        "--stress-s",
        type=float,
        default=1.0,
        help="seconds of the buffer's stress test (default: 1)",
    )
