"""A stream as tests receive it: messages with transforms, and a buffer to look into."""

import logging
from collections.abc import Iterable

from tfbus import Buffer, Transform, TransformBatch, TransformStamped
from tfbus.listen.reception import DynamicReception, StreamReception
from tfbus.wire.transforms import TransformMessage, TransformReader, encode_transforms

S = 10**9


def at(x: float, child: str, stamp_ns: int = S, parent: str = "world") -> TransformStamped:
    """The child x metres ahead of its parent."""
    return TransformStamped(stamp_ns, parent, child, Transform((x, 0, 0)))


def payload(
    transforms: Iterable[TransformStamped], epoch_ns: int = 1, seq: int | None = None
) -> bytes:
    batch = TransformBatch.from_transforms(transforms)
    return encode_transforms(TransformMessage(batch, epoch_ns, seq))


class Received:
    """A stream as it is received into a buffer of its own."""

    def __init__(self) -> None:
        self.buffer = Buffer()
        self.time_s = 0.0
        self.taken_over: list[tuple[str, int]] = []
        self.stream = StreamReception(
            "sim",
            self.buffer,
            logging.getLogger("test"),
            lambda: 9 * S,
            TransformReader(),
            on_takeover=lambda name, epoch_ns: self.taken_over.append((name, epoch_ns)),
            now_s=lambda: self.time_s,
        )
        self.key = DynamicReception(self.stream)

    def send(
        self, *transforms: TransformStamped, epoch_ns: int = 1, seq: int | None = None
    ) -> None:
        self.key.receive(payload(transforms, epoch_ns, seq))

    def send_static(self, *transforms: TransformStamped, epoch_ns: int = 1) -> None:
        self.stream.receive_static(payload(transforms, epoch_ns))

    def describe(self, *children: str, epoch_ns: int = 1) -> None:
        self.stream.describe(epoch_ns, frozenset(children))

    def gone(self) -> list[str]:
        return [info.name for info in self.buffer.all_frames() if info.gone]

    def x_of(self, child: str) -> float | None:
        if not self.buffer.can_transform("world", child):
            return None
        return self.buffer.lookup_transform("world", child).transform.x
