"""The stream on the bus of one node in ROS."""

from collections.abc import Mapping

from tfbus.broadcast.node_streams import NodeStreams
from tfbus.broadcast.options import StreamOptions
from tfbus.broadcast.sender import TransformSender
from tfbus.broadcast.stream import Stream
from tfbus.errors import RightsError
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.names import is_printable
from tfbus.node.node import Node
from tfbus.wire.keys import escape


class RosStream:
    """The transforms of one node of ROS, as a stream of the bus; used by one thread at a time.

    It begins with the first transform. `gids` are those of the publishers that have sent.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self.gids: set[str] = set()
        self._node = node
        self._streams = NodeStreams.of(node)
        self._stream: Stream | None = None
        self._sender: TransformSender | None = None
        self._statics: dict[str, TransformStamped] = {}
        self._origin: tuple[str, ...] = ()

    @property
    def is_open(self) -> bool:
        """Whether it is on the bus."""
        return self._stream is not None

    @property
    def since(self) -> tuple[int, str]:
        """When it began, in ns, later than any other if it has not; and the session."""
        session = self._node.session.id
        return (2**63 if self._stream is None else self._stream.started_ns, session)

    def say_origin(self, gids: tuple[str, ...]) -> None:
        """Say on the bus which publishers it stands for."""
        self._origin = gids
        if self._stream is not None:
            self._stream.origin = gids

    def send(self, rows: Columns) -> None:
        """Send dynamic transforms. Raises TfbusError if they cannot be sent."""
        self._sending().send(rows)

    def send_pose(self, frames: tuple[str, ...], stamp_ns: int, pose: bytes) -> None:
        """Send a dynamic transform, as `TransformSender.send_pose`. Raises as `send`."""
        (self._sender or self._sending()).send_pose(frames, stamp_ns, pose)

    def set_statics(self, transforms: Mapping[str, TransformStamped]) -> None:
        """Send these static transforms, by their child frames, in place of those before. Raises
        TfbusError if they cannot be sent.
        """
        new = {
            child: each for child, each in transforms.items() if self._statics.get(child) != each
        }
        left = self._statics.keys() - transforms.keys()
        if new:
            self._opened().send_static(new.values())
            self._statics |= new
        if left and self._stream is not None:
            for child in left:
                del self._statics[child]
            self._stream.remove_static(*left)

    def becomes_dynamic(self, child: str) -> None:
        """A static frame comes as a dynamic one now."""
        self._statics.pop(child, None)

    def close(self) -> None:
        """Its node is gone: listeners mark its frames so. Twice is fine; sending opens it again."""
        if self._stream is not None:
            self._streams.close(self.name)
            self._stream = self._sender = None
            self._statics.clear()

    def _sending(self) -> TransformSender:
        if self._sender is None:
            self._sender = self._opened().sender(StreamOptions())
        return self._sender

    def _opened(self) -> Stream:
        if self._stream is None:
            # With its origin from the first description on: without, another bridge would take it
            # for one that does not come from ROS.
            self._stream = self._streams.reopen(self._node, self.name, self._origin)
        return self._stream


def stream_name(node: Node, ros_node: str) -> str:
    """The name of the stream for a node of ROS, by its full name: "ros2/robot_state_publisher".

    That of the bridge's node alone if ROS does not tell, or the name cannot be shown or may not
    be used on this bus.
    """
    name = _own_name(node, ros_node)
    return name if name and not lacks_right(node, ros_node) else node.name


def lacks_right(node: Node, ros_node: str) -> str:
    """The name that the stream for a node of ROS would have, but that this identity may not use;
    "" if it may.
    """
    name = _own_name(node, ros_node)
    if name:
        try:
            node.settings.check_right("nodes", escape(name))
        except RightsError:
            return name
    return ""


def _own_name(node: Node, ros_node: str) -> str:
    name = f"{node.name}/{ros_node.strip('/')}"
    return name if ros_node.strip("/") and is_printable(name) else ""
