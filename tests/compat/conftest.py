"""Fixtures of the tests of ported names: rclpy on the bus of the test."""

from collections.abc import Iterator
from types import ModuleType

import pytest

from tests import live_bus, simulated_bus
from tfbus.compat import rclpy as ported


@pytest.fixture
def rclpy(
    bus: live_bus.Bus | simulated_bus.Bus, monkeypatch: pytest.MonkeyPatch
) -> Iterator[ModuleType]:
    """rclpy, begun without arguments; its nodes join the bus of the test, and end with it."""
    if isinstance(bus, live_bus.Bus):
        monkeypatch.setenv("TFBUS_CONFIG", str(bus.quick_config))
        monkeypatch.setenv("TFBUS_CONNECT", bus.endpoint)
    ported.init(args=[])
    yield ported
    ported.shutdown()
