"""Two robots drive in one map, and each says where it sees the other.

    python examples/two_robots.py

Positions are in the `base_link` of the one that looks: x ahead, y to the left. Both have a frame of
that name, and a namespace keeps them apart. Here they share a process; on real robots each calls
`start` by itself. `tfbus frames --fleet --shared map` lists the frames of both, and `tfbus view`
with the same options shows them. Ctrl-C ends it.
"""

import math
import sys
from contextlib import ExitStack

from tfbus import (
    Buffer,
    Fleet,
    Node,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)

NEAR_M = 1.5


def start(open_until_end: ExitStack, name: str, other: str, turn: int) -> Node:
    """A robot that drives on a circle, to the left (1) or right (-1), and looks for another."""
    wheels = Node.from_args("wheels", [*sys.argv[1:], "--namespace", name])
    # In no namespace, and so it receives the frames of all robots: `robot1/base_link`.
    eyes = Node.from_args(f"{name}_eyes")
    buffer = Buffer()
    listener = TransformListener(buffer, eyes, fleet=Fleet(shared_frames=("map",)))
    for each in (wheels, eyes, listener):
        open_until_end.enter_context(each)
    broadcaster = TransformBroadcaster(wheels)

    def drive() -> None:
        now_ns = wheels.now_ns()
        angle = math.remainder(0.4 * now_ns / 1e9, 2 * math.pi)
        middle = Transform.from_rpy(0, 0, turn * angle, xyz=(-2.5 * turn, 0, 0))
        pose = middle @ Transform.from_rpy(0, 0, math.pi / 2, xyz=(2 * turn, 0, 0))
        broadcaster.send_transform(TransformStamped(now_ns, "map", "base_link", pose))

    def look() -> None:
        me, it = f"{name}/base_link", f"{other}/base_link"
        if not buffer.can_transform(me, it, max_age_s=1.0):
            print(f"{name} does not see {other}")
            return
        x, y, _ = buffer.lookup_transform(me, it).transform.xyz
        near = ", near" if math.hypot(x, y) < NEAR_M else ""
        print(f"{name} sees {other} at ({x:.1f}, {y:.1f}) m{near}")

    wheels.create_timer(0.05, drive)
    eyes.create_timer(1.0, look)
    return wheels


def main() -> None:
    with ExitStack() as open_until_end:
        start(open_until_end, "robot1", "robot2", 1)
        start(open_until_end, "robot2", "robot1", -1).spin()


if __name__ == "__main__":
    main()
