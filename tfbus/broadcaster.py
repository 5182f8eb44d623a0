"""Broadcasters: a node sends transforms to everyone."""

from collections.abc import Iterable

from tfbus.batch import TransformBatch
from tfbus.errors import InvalidArgumentException
from tfbus.node import Node
from tfbus.transform import TransformStamped

Transforms = TransformStamped | TransformBatch | Iterable[TransformStamped]


class TransformBroadcaster:
    """Sends transforms that change with time.

    What is sent in one call goes in one message. All broadcasters of a node belong to the
    stream of the node's name, unless they are given a `stream` of their own.
    """

    def __init__(self, node: Node, *, stream: str | None = None):
        self._stream = node.stream(stream)

    def send_transform(self, transforms: Transforms) -> None:
        """Send one transform, several, or a batch of columns.

        Each takes points of its child frame into its frame_id, the parent. Raises
        InvalidArgumentException where parent and child are the same frame.
        """
        self._stream.send(_as_batch(transforms))


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


def _as_batch(transforms: Transforms) -> TransformBatch:
    if isinstance(transforms, TransformStamped):
        transforms = (transforms,)
    if not isinstance(transforms, TransformBatch):
        transforms = TransformBatch.from_transforms(transforms)
    for parent, child in transforms.edges.tolist():
        if parent == child:
            raise InvalidArgumentException(
                f"frame {transforms.frames[child]!r} cannot be its own parent; "
                "frame_id and child_frame_id differ"
            )
    return transforms
