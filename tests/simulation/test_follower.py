"""The turtles of the tutorial on a simulated network, with a link that loses packets."""

from math import hypot

import tfbus
from tfbus.nodes import broadcaster, carrot, follow, simulator
from tfbus.testing import Network


def test_a_turtle_follows_a_carrot_over_a_lossy_link(network: Network) -> None:
    """The follower comes near its carrot, also where one in five packets is lost."""
    robot, base = network.host("robot"), network.host("base")
    network.path(robot, base, delay_s=0.02, loss=0.2)

    def run(host: object, name: str, main: object, *words: str) -> None:
        network.start(host, name, main, [*words], standalone_mode=False)

    run(robot, "sim", simulator.main, "--headless")
    run(robot, "turtle1", broadcaster.main)
    run(robot, "turtle2", broadcaster.main, "--name", "b2", "--param", "turtlename=turtle2")
    run(base, "carrot", carrot.main)
    run(base, "follow", follow.main, "--param", "target_frame=carrot1")
    with network.process(base, "eye"):
        buffer = tfbus.Buffer()
        node = tfbus.Node("eye")
        tfbus.TransformListener(buffer, node)

        def is_near() -> bool:
            try:
                found = buffer.lookup_transform("turtle2", "carrot1").transform
            except tfbus.TransformException:
                return False
            return hypot(found.x, found.y) < 0.1

        network.run(until=is_near, timeout_s=60.0)
