"""A carrot for a turtle: a frame fixed to another, or circling it.

    tfbus carrot
    tfbus carrot --param dynamic=true --param period=8.0

From tf2's tutorial on adding a frame: turtle1 -> carrot1 is 2 m to the turtle's left; with
`dynamic` it circles the turtle clockwise.
"""

from math import cos, pi, sin

import click

from tfbus import (
    Node,
    NodeSettings,
    Transform,
    TransformBroadcaster,
    TransformStamped,
    node_options,
)
from tfbus.command.parameters import Declared, NodeCommand

PERIOD_S = 0.1


PARENT = Declared("parent_frame", "turtle1", "The frame that carries the carrot.")
CARROT = Declared("frame", "carrot1", "The frame of the carrot.")
DYNAMIC = Declared("dynamic", False, "Whether the carrot circles its parent.")
RADIUS = Declared("radius", 2.0, "The distance to its parent, in m.", minimum=0.0)
PERIOD = Declared("period", 10.0, "Seconds for one circle.", minimum=0.1)


@click.command(
    cls=NodeCommand,
    declared=(PARENT, CARROT, DYNAMIC, RADIUS, PERIOD),
    epilog="Example: tfbus carrot --param dynamic=true",
)
@node_options("carrot")
def main(settings: NodeSettings) -> None:
    """Broadcast a frame fixed to another one, or circling it."""
    with Node.from_settings(settings) as node:
        parent, carrot = PARENT.on(node).value, CARROT.on(node).value
        dynamic, radius_m, period_s = DYNAMIC.on(node), RADIUS.on(node), PERIOD.on(node)
        broadcaster = TransformBroadcaster(node)

        def broadcast() -> None:
            stamp_ns = node.now_ns()
            turns = stamp_ns / 1e9 / period_s.value if dynamic.value else 0.0
            offset = Transform(carrot_at(turns, radius_m.value))
            broadcaster.send_transform(TransformStamped(stamp_ns, parent, carrot, offset))

        node.create_timer(PERIOD_S, broadcast)
        node.spin()


def carrot_at(turns: float, radius_m: float) -> tuple[float, float, float]:
    """The carrot's position after `turns` circles, in m: starts on the left, goes clockwise."""
    angle = 2.0 * pi * (turns % 1.0)
    return radius_m * sin(angle), radius_m * cos(angle), 0.0


if __name__ == "__main__":
    main()
