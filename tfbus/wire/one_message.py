"""Messages of one transform between two frames, the most frequent there are.

One of the modules that are compiled where there is a C compiler (`one_message.pxd` says the C
types).
"""

from tfbus.core import packed
from tfbus.geometry.transform import TransformStamped


class OneMessage:
    """Writes the messages that carry one transform from the child frame to the parent.

    `head`, `stamps` and `poses` are the bytes of a message that do not change: up to its number,
    from there to its stamp, and from there to its pose.
    """

    def __init__(
        self, frame_id: str, child_frame_id: str, head: bytes, stamps: bytes, poses: bytes
    ) -> None:
        self._frame_id = frame_id
        self._child_frame_id = child_frame_id
        self._head = head
        self._stamps = stamps
        self._poses = poses

    def encode(self, seq: int, transform: TransformStamped) -> bytes | None:
        """The message with this number; stamp and pose as they stand on this machine. None for a
        transform between other frames.
        """
        if (
            transform._child_frame_id != self._child_frame_id
            or transform._frame_id != self._frame_id
        ):
            return None
        return b"".join(
            (
                self._head,
                seq.to_bytes(8, "big"),
                self._stamps,
                packed.stamp_bytes(transform._stamp_ns),
                self._poses,
                packed.pose_bytes(transform._pose),
            )
        )
