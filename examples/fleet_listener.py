"""Sees the frames of all robots, each of which has a `base_link` in a shared `map`.

    tfbus static map base_link --x 3 --namespace robot3
    tfbus static map base_link --x 7 --namespace robot7
    python examples/fleet_listener.py

Prints where each robot is, once a second, and marks robots that are gone. Ctrl-C ends it.
"""

from tfbus import Buffer, Fleet, Node, TransformListener


def main() -> None:
    buffer = Buffer()
    fleet = Fleet(shared_frames=("map",))
    with Node.from_args("tower") as node, TransformListener(buffer, node, fleet=fleet):
        while node.wait(1.0):
            robots = [frame for frame in buffer.all_frames() if frame.name.endswith("/base_link")]
            for robot in robots:
                if buffer.can_transform("map", robot.name):
                    x, y, _ = buffer.lookup_transform("map", robot.name).transform.xyz
                    state = " (gone)" if robot.gone else ""
                    print(f"{robot.name.partition('/')[0]}: ({x:.1f}, {y:.1f}) m{state}")


if __name__ == "__main__":
    main()
