"""The meshes of robots on other machines, as their robot_state serves them."""

from threading import Lock

from tfbus.errors import TfbusError
from tfbus.messages import RobotMesh
from tfbus.node.node import Node
from tfbus.node.service import Client
from tfbus.wording import printable

# The largest file, how long one part of it may take, and how often it may change while it is read.
MOST_BYTES = 100_000_000
_PATIENCE_S = 10.0
_MOST_CHANGES = 3


class RobotMeshes:
    """Fetches the meshes that descriptions name, and the pictures and materials beside them."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = Lock()
        self._clients: dict[str, Client] = {}

    def fetch(self, origin: str, mesh: str) -> bytes:
        """The content of a mesh of the robot in a namespace, from the machine that describes it.

        Raises TfbusError where it cannot be had.
        """
        client = self._client(origin)
        for _ in range(_MOST_CHANGES):
            found = _fetch(client, mesh)
            if found is not None:
                return found
        raise TfbusError("it changed while it was read")

    def _client(self, origin: str) -> Client:
        with self._lock:
            client = self._clients.get(origin)
            if client is None:
                name = f"{origin}/robot_mesh" if origin else "robot_mesh"
                client = self._clients[origin] = self._node.create_client(RobotMesh, name)
            return client


def _fetch(client: Client, mesh: str) -> bytes | None:
    """The whole file; None where it changed meanwhile."""
    parts: list[bytes] = []
    got, size, version = 0, 1, None
    while got < size:
        try:
            request = RobotMesh.Request(mesh, got)
            answer: RobotMesh.Response = client.call(request, timeout_s=_PATIENCE_S)
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
