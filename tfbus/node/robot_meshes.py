"""The meshes of robots on other machines, as their robot_state serves them."""

from contextlib import closing

from tfbus.base import scheduler
from tfbus.base.errors import TfbusError
from tfbus.base.wording import printable
from tfbus.messages import RobotMesh
from tfbus.node.node import Node
from tfbus.node.service import Client

# The largest file, how long it and one part of it may take, and how often it may change while it is
# read.
MOST_BYTES = 100_000_000
_LONGEST_S = 60.0
_PATIENCE_S = 10.0
_MOST_CHANGES = 3


def fetch_mesh(node: Node, origin: str, mesh: str, within_s: float = _LONGEST_S) -> bytes:
    """The content of a mesh of the robot in a namespace, or of a picture or material beside it,
    from the machine that describes the robot.

    Raises TfbusError if it cannot be had, or not in this time.
    """
    deadline_s = scheduler.monotonic() + within_s
    client = node.create_client(RobotMesh, f"{origin}/robot_mesh" if origin else "robot_mesh")
    # Robots come and go, and the client of one that is gone would stay as long as the node.
    with closing(client):
        for _ in range(_MOST_CHANGES):
            found = _fetch(client, mesh, deadline_s)
            if found is not None:
                return found
    raise TfbusError("it changed while it was read")


def _fetch(client: Client, mesh: str, deadline_s: float) -> bytes | None:
    """The whole file; None if it changed meanwhile."""
    parts: list[bytes] = []
    got, size, version = 0, 1, None
    while got < size:
        left_s = deadline_s - scheduler.monotonic()
        if left_s <= 0.0:
            raise TfbusError("it could not be fetched: it came too slowly")
        try:
            request = RobotMesh.Request(mesh, got)
            answer: RobotMesh.Response = client.call(request, timeout_s=min(_PATIENCE_S, left_s))
        except TfbusError as error:
            raise TfbusError(f"it could not be fetched: {printable(str(error), 300)}") from error
        if version is not None and answer.version != version:
            return None
        version, size = answer.version, answer.size
        if size > MOST_BYTES:
            raise TfbusError(f"it has {size / 1e6:.0f} MB, at most {MOST_BYTES / 1e6:.0f} are read")
        if not answer.data and got < size:
            raise TfbusError("it came in part only")
        parts.append(answer.data)
        got += len(answer.data)
    return b"".join(parts)
