"""The listener: every transform on the bus goes into a buffer."""

from collections import Counter

from tfbus.buffer import Buffer
from tfbus.errors import DecodeError
from tfbus.keys import ALL_STATIC_TRANSFORMS, ALL_TRANSFORMS, stream_of
from tfbus.node import Node
from tfbus.retained import declare_retained_subscriber
from tfbus.wire import decode_transforms


class TransformListener:
    """Fills a buffer with the transforms that others send, and keeps it up to date.

    It works on threads of its own: there is nothing to spin, and a lookup may wait anywhere.
    The authority of a transform is the stream that it came in. A message that cannot be read is
    counted in `rejected` by its stream, reported once, and dropped; a transform that the buffer
    refuses is counted there, and reported once a stream.
    """

    def __init__(self, buffer: Buffer, node: Node):
        self.buffer = buffer
        self.rejected: Counter[str] = Counter()
        self._log = node.log
        self._told: set[str] = set()
        self._dynamic = node.session.subscriber(ALL_TRANSFORMS, self._on_transforms)
        self._static = declare_retained_subscriber(
            node.session, ALL_STATIC_TRANSFORMS, self._on_static_transforms
        )
        self._closed = False

    def __enter__(self) -> "TransformListener":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Listen no more; the buffer keeps what it has. Twice is fine."""
        if not self._closed:
            self._closed = True
            self._dynamic.close()
            self._static.close()

    def _on_transforms(self, key: str, payload: bytes) -> None:
        self._insert(key, payload, static=False)

    def _on_static_transforms(self, key: str, payload: bytes) -> None:
        self._insert(key, payload, static=True)

    def _insert(self, key: str, payload: bytes, *, static: bool) -> None:
        stream = stream_of(key)
        try:
            batch = decode_transforms(payload).batch
        except DecodeError as error:
            self._reject(stream, error)
        else:
            refused = self.buffer.rejected.total()
            taken = self.buffer.set_transforms(batch, static=static, authority=stream)
            # Rows that are only too old are not taken either, but not refused.
            if taken < len(batch) and self.buffer.rejected.total() > refused:
                self._tell_refused(stream)

    def _tell_refused(self, stream: str) -> None:
        if stream not in self._told:
            self._told.add(stream)
            self._log.warning(
                "Refused a transform of stream %r: %s. More of them are only counted",
                stream,
                self.buffer.rejected.last,
            )

    def _reject(self, stream: str, error: DecodeError) -> None:
        self.rejected[stream] += 1
        if self.rejected[stream] == 1:
            self._log.warning(
                "Dropped a message of stream %r: %s. More of them are only counted", stream, error
            )
