"""Serves a request, and has a parameter that can be set while it runs.

    python examples/service_and_parameter.py
    tfbus call distance '{target: world, source: camera}'
    tfbus param set ruler digits 1

The service says how far apart two frames are. A service is a class with a Request and a
Response, frozen dataclasses. Ctrl-C ends it.
"""

from dataclasses import dataclass

from tfbus import Buffer, Node, ServiceError, TransformException, TransformListener


class Distance:
    """How far a frame is from another."""

    @dataclass(frozen=True)
    class Request:
        target: str
        source: str

    @dataclass(frozen=True)
    class Response:
        distance_m: float


def main() -> None:
    buffer = Buffer()
    with Node.from_args("ruler") as node, TransformListener(buffer, node):
        digits = node.declare_parameter("digits", 3, minimum=0, maximum=9)

        def measure(request: Distance.Request) -> Distance.Response:
            try:
                pose = buffer.lookup_transform(request.target, request.source, timeout_s=2.0)
            except TransformException as error:
                raise ServiceError(str(error)) from error
            x, y, z = pose.transform.xyz
            return Distance.Response(round(float(x * x + y * y + z * z) ** 0.5, digits.value))

        node.create_service(Distance, "distance", measure)
        node.spin()


if __name__ == "__main__":
    main()
