"""Messages of one transform, which are the most frequent.

Compiled if there is a C compiler (`one_message.pxd` has the C types).
"""

from tfbus.core import packed
from tfbus.geometry.transform import TransformStamped, child_name


class OneMessage:
    """Writes messages that carry one transform, always between the same two frames.

    `head`, `stamps` and `poses` are the constant bytes of a message: up to its number, from there
    to its stamp, and from there to its pose.
    """

    def __init__(
        self, frame_id: str, child_frame_id: str, head: bytes, stamps: bytes, poses: bytes
    ) -> None:
        self._frame_id = frame_id
        self._child_frame_id = child_frame_id
        self._head = head
        self._stamps = stamps
        self._poses = poses

    def encode_bytes(
        self, seq: int, frames: tuple[str, ...], stamp_ns: int, pose: bytes
    ) -> bytes | None:
        """The message with this number, of a pose in the byte order of this machine. None for other
        frames.
        """
        if frames[1] != self._child_frame_id or frames[0] != self._frame_id:
            return None
        return b"".join(
            (
                self._head,
                seq.to_bytes(8, "big"),
                self._stamps,
                packed.stamp_bytes(stamp_ns),
                self._poses,
                pose,
            )
        )

    def encode(self, seq: int, transform: TransformStamped) -> bytes | None:
        """The message with this number, in the byte order of this machine. None for a transform
        between other frames.
        """
        if child_name(transform) != self._child_frame_id or transform._frame_id != self._frame_id:
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
