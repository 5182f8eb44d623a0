"""A leading slash makes a name absolute, as in ROS, in every command that takes one."""

import pytest

from tests.simulated_bus import Bus
from tfbus.messages import Color, Empty


@pytest.fixture
def robots(bus: Bus) -> Bus:
    """/colour, /reset and the parameter /lamp rate; /robot7/colour beside them."""
    for name, namespace in (("lamp", ""), ("lamp7", "robot7")):
        node = bus.node(name, namespace=namespace)
        publisher = node.create_publisher(Color, "colour")
        node.create_timer(0.1, lambda publisher=publisher: publisher.publish(Color(1, 2, 3)))
        node.create_service(Empty, "reset", lambda request: Empty.Response())
        node.declare_parameter("rate", 5)
    return bus


@pytest.mark.parametrize(
    ("line", "out"),
    [
        ("topic echo /colour --once --csv", "1,2,3"),
        ("topic echo /robot7/colour --once --csv", "1,2,3"),
        ("topic echo /robot7/colour --once --csv --namespace robot7", "1,2,3"),
        ("topic type /colour", "Color"),
        ("topic info /robot7/colour --namespace robot7", "Publisher count: 1"),
        ("topic hz /colour --once", "average rate: "),
        ("topic show /colour", "b: int"),
        ("service type /reset", "Empty"),
        ("service call /reset", "{}"),
        ("call /robot7/reset --namespace robot7", "{}"),
        ("param get /lamp rate", "Integer value is: 5"),
        ("node info /robot7/lamp7", "colour: Color"),
    ],
)
def test_a_command_takes_an_absolute_name(robots: Bus, line: str, out: str) -> None:
    """Absolute names work from the root and from within their namespace."""
    done = robots.run(*line.split())
    assert done.returncode == 0, done.stderr
    assert out in done.stdout
