"""A carrot before a turtle's nose: a frame that stands fixed beside another, or goes around it.

    tfbus carrot
    tfbus carrot --param dynamic=true --param period=8.0

From tf2's tutorial on adding a frame: turtle1 -> carrot1 is 2 m to the turtle's left; dynamic,
it goes clockwise around the turtle in a smooth circle.
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

PERIOD_S = 0.1


@click.command(epilog="Example: tfbus carrot --param dynamic=true")
@node_options("carrot")
def main(settings: NodeSettings) -> None:
    """Broadcast a frame fixed to another one, or circling it."""
    with Node.from_settings(settings) as node:
        parent = node.declare_parameter(
            "parent_frame", "turtle1", description="The frame that carries the carrot."
        ).value
        carrot = node.declare_parameter(
            "frame", "carrot1", description="The frame of the carrot."
        ).value
        dynamic = node.declare_parameter(
            "dynamic", False, description="Whether the carrot goes around its parent."
        )
        radius_m = node.declare_parameter(
            "radius", 2.0, description="How far it is from its parent, in m.", minimum=0.0
        )
        period_s = node.declare_parameter(
            "period", 10.0, description="Seconds for one way around.", minimum=0.1
        )
        broadcaster = TransformBroadcaster(node)

        def broadcast() -> None:
            stamp_ns = node.now_ns()
            turns = stamp_ns / 1e9 / period_s.value if dynamic.value else 0.0
            offset = Transform(carrot_at(turns, radius_m.value))
            broadcaster.send_transform(TransformStamped(stamp_ns, parent, carrot, offset))

        node.create_timer(PERIOD_S, broadcast)
        node.spin()


def carrot_at(turns: float, radius_m: float) -> tuple[float, float, float]:
    """Where the carrot is after so many turns, in m: at first to the left, then clockwise."""
    angle = 2.0 * pi * (turns % 1.0)
    return radius_m * sin(angle), radius_m * cos(angle), 0.0


if __name__ == "__main__":
    main()
