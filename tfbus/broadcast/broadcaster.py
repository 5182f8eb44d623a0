"""Broadcasters: a node sends transforms to everyone."""

from collections.abc import Iterable

from tfbus.broadcast.options import StreamOptions
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.node.node import Node

Transforms = TransformStamped | TransformBatch | Iterable[TransformStamped]


class TransformBroadcaster:
    """Sends transforms that change with time.

    All broadcasters of a node belong to the stream of the node's name, unless they are given a
    `stream` of their own; those of one stream agree on the rest. What is sent in one call goes in
    one message, or, with `split`, in one a frame on a key of its own, so that others need not
    receive all. Of two publishers of one frame that of higher `priority` wins in the listeners
    that go by it. The messages of the last `history_s` seconds are kept for listeners that start
    later and ask for them, in at most 16 MiB.

    Where the stamps of a frame go back by more than a second, as of a simulator that was reset,
    all listeners forget what the stream sent before, but for its static transforms.

    Raises InvalidArgumentException where `history_s` or `priority` cannot be, or where the stream
    has a broadcaster that sends otherwise.
    """

    def __init__(
        self,
        node: Node,
        *,
        stream: str | None = None,
        split: bool = False,
        priority: int = 0,
        history_s: float = 10.0,
    ):
        options = StreamOptions(split=split, priority=priority, history_s=history_s)
        self._sender = node.stream(stream).sender(options)

    def send_transform(self, transforms: Transforms) -> None:
        """Send one transform, several, or a batch of columns.

        Each takes points of its child frame into its frame_id, the parent. Raises
        InvalidArgumentException where parent and child are the same frame, or a name in a batch
        can be no frame's.
        """
        if isinstance(transforms, TransformStamped):
            self._sender.send_one(transforms)
        else:
            self._sender.send(_as_columns(transforms))

    def remove(self, frame: str) -> None:
        """Take a child frame out of the stream, and so out of every listener's buffer.

        Raises LookupException where the stream does not send it, InvalidArgumentException where
        it is static. Sent again, it is there again.
        """
        self._sender.remove(frame)


class StaticTransformBroadcaster:
    """Sends transforms that hold at all times.

    They are added to the static transforms of the stream, or replace those of the same child
    frame, and reach listeners that start later as long as the node lives.
    """

    def __init__(self, node: Node, *, stream: str | None = None):
        self._stream = node.stream(stream)

    def send_transform(self, transforms: Transforms) -> None:
        """Send one transform, several, or a batch, as `TransformBroadcaster.send_transform`."""
        self._stream.send_static(_as_batch(transforms))

    def remove(self, frame: str) -> None:
        """Take a child frame out of the stream, and so out of every listener's buffer.

        Raises LookupException where the stream does not send it, InvalidArgumentException where
        it is not static.
        """
        self._stream.remove_static(frame)


def _as_columns(transforms: TransformBatch | Iterable[TransformStamped]) -> Columns:
    if isinstance(transforms, TransformBatch):
        return Columns.of_batch(transforms)
    return Columns.of_transforms(transforms)


def _as_batch(transforms: Transforms) -> TransformBatch:
    if isinstance(transforms, TransformStamped):
        transforms = (transforms,)
    if isinstance(transforms, TransformBatch):
        return transforms
    return TransformBatch.from_transforms(transforms)
