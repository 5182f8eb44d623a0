"""A stream: the transforms that one node publishes under one name.

Each stream has a liveliness token, and a retained description at the same key that tells its
node, its epoch and its frames; so others know which frames exist, and who publishes them,
without reading a transform.
"""

import os
import socket
import threading
from collections.abc import Iterable

from tfbus.batch import TransformBatch
from tfbus.codec import encode_message
from tfbus.description import STREAM_VERSION, StreamDescription
from tfbus.executor import Executor
from tfbus.keys import static_transforms_key, stream_key, transforms_key
from tfbus.retained import declare_retained_publisher
from tfbus.session import Session
from tfbus.transform import TransformStamped
from tfbus.wire import TransformMessage, encode_transforms

# New frames often come in a burst: one description tells of all of them.
_DESCRIBE_AFTER_S = 0.02


class Stream:
    """Publishes the dynamic and static transforms of one stream; safe from any thread."""

    def __init__(
        self, name: str, node: str, epoch_ns: int, session: Session, executor: Executor
    ) -> None:
        self.name = name
        self._node = node
        self._epoch_ns = epoch_ns
        self._session = session
        self._executor = executor
        self._lock = threading.Lock()
        self._edges: dict[str, tuple[str, bool]] = {}  # of each child: its parent, static
        self._last_table: tuple[tuple[str, ...], bytes] | None = None
        self._statics: dict[str, TransformStamped] = {}
        self._sent = 0
        self._sent_static = 0
        self._description_is_due = False
        self._transforms = session.publisher(transforms_key(name))
        self._static_transforms = declare_retained_publisher(session, static_transforms_key(name))
        self._description = declare_retained_publisher(session, stream_key(name))
        self._token = session.token(stream_key(name))

    def send(self, batch: TransformBatch) -> None:
        """Send the transforms of the batch in one message."""
        with self._lock:
            self._note_edges(batch, static=False)
            self._transforms.put(
                encode_transforms(TransformMessage(batch, self._epoch_ns, self._sent))
            )
            self._sent += 1

    def send_static(self, transforms: Iterable[TransformStamped]) -> None:
        """Add static transforms to the stream, or replace those of the same child frame; the
        whole set is sent, and kept for those who join later.
        """
        with self._lock:
            self._statics |= {ts.child_frame_id: ts for ts in transforms}
            batch = TransformBatch.from_transforms(self._statics.values())
            self._note_edges(batch, static=True)
            self._static_transforms.put(
                encode_transforms(TransformMessage(batch, self._epoch_ns, self._sent_static))
            )
            self._sent_static += 1

    def _note_edges(self, batch: TransformBatch, *, static: bool) -> None:
        table = (batch.frames, batch.edges.tobytes())
        if not static and table == self._last_table:
            return
        if not static:
            self._last_table = table
        frames = batch.frames
        edges = {frames[child]: (frames[parent], static) for parent, child in batch.edges.tolist()}
        if not edges.items() <= self._edges.items():
            self._edges |= edges
            self._describe_soon()

    def _describe_soon(self) -> None:
        if not self._description_is_due:
            self._description_is_due = True
            self._executor.after(_DESCRIBE_AFTER_S, self._describe)

    def _describe(self) -> None:
        with self._lock:
            self._description_is_due = False
            self._description.put(encode_message(self._describe_itself()))

    def _describe_itself(self) -> StreamDescription:
        return StreamDescription(
            STREAM_VERSION,
            self._node,
            self._epoch_ns,
            tuple((parent, child, static) for child, (parent, static) in self._edges.items()),
            host=socket.gethostname(),
            pid=os.getpid(),
            session=self._session.id,
        )
