"""Running the callbacks of a ported node until something holds."""

from typing import Any

from tests.buses import eventually
from tfbus.compat import rclpy as ported


def spin_until(node: Any, condition: Any) -> None:
    """Run callbacks until the condition holds."""

    def spun() -> bool:
        ported.spin_once(node, timeout_sec=0.01)
        return bool(condition())

    eventually(spun)


def publish_until(node: Any, publisher: Any, message: Any, condition: Any) -> None:
    """The same, and publish meanwhile."""

    def published() -> bool:
        publisher.publish(message)
        ported.spin_once(node, timeout_sec=0.01)
        return bool(condition())

    eventually(published)
