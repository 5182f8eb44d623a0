"""Looks a frame up once a second, and says why where there is no answer.

    python examples/listener.py
    python examples/listener.py --param target=world --param source=camera

Start it before or after broadcaster.py. Ctrl-C ends it.
"""

from tfbus import Buffer, Node, TransformException, TransformListener


def main() -> None:
    buffer = Buffer()
    with Node.from_args("listener") as node, TransformListener(buffer, node):
        target = node.declare_parameter("target", "world").value
        source = node.declare_parameter("source", "camera").value
        while node.wait(1.0):
            try:
                # Fails where the newest sample is older than half a second.
                pose = buffer.lookup_transform(target, source, timeout_s=2.0, max_age_s=0.5)
            except TransformException as error:
                node.log.warning("%s", error)
            else:
                x, y, z = pose.transform.xyz
                yaw = pose.transform.as_rpy()[2]
                print(f"{source} in {target}: ({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {yaw:.2f} rad")


if __name__ == "__main__":
    main()
