"""A stream: the transforms that one node publishes under one name.

Each stream has a liveliness token, and a retained description at the same key that tells its
node, its epoch and its frames; so others know which frames exist, and who publishes them,
without reading a transform.
"""

import logging
import math
import os
import socket
import threading
import time
from contextlib import suppress

from tfbus.broadcast.announcer import Edges, FrameRows, StreamFrames
from tfbus.broadcast.options import StreamOptions
from tfbus.broadcast.sender import TransformSender
from tfbus.bus.query import Query
from tfbus.bus.retained import declare_retained_publisher
from tfbus.bus.session import Session
from tfbus.errors import BusError, InvalidArgumentException
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.transform import TransformStamped
from tfbus.runtime.executor import Executor
from tfbus.wire.codec import encode_map
from tfbus.wire.descriptions import STREAM_VERSION, StreamDescription
from tfbus.wire.keys import static_transforms_key, stream_key
from tfbus.wire.transforms import TransformMessage, encode_transforms

# Epochs that follow each other closer than that, as of a short recording in a loop, are told by one
# line.
_TELL_EPOCHS_EVERY_S = 5.0
# So many in a row are no accident.
_MANY_EPOCHS = 10

# What a stream is that nothing moves in.
_NOTHING_MOVES = StreamOptions(history_s=0.0)


class Stream:
    """Publishes the dynamic and static transforms of one stream; safe from any thread.

    `epoch_ns` is its first epoch. A new one begins where its stamps go back by more than a
    second: what was sent before is then worth nothing, but for the static transforms.
    """

    def __init__(
        self,
        name: str,
        node: str,
        epoch_ns: int,
        session: Session,
        executor: Executor,
        log: logging.Logger,
    ) -> None:
        self.name = name
        self._node = node
        self._started_ns = self._epoch_ns = epoch_ns
        self._session = session
        self._executor = executor
        self._log = log
        self._lock = threading.Lock()
        self._sender: TransformSender | None = None
        self._static_lock = threading.Lock()
        self._told_epoch_s = -math.inf
        self._epochs_in_a_row = 0
        self._statics: dict[str, TransformStamped] = {}
        self._statics_sent = 0
        self._static_payload = b""
        self._static_key = static_transforms_key(name)
        self._static_publisher = declare_retained_publisher(session, self._static_key)
        # Who was told of the one way to what is retained too early, may know of the other.
        session.queryable(self._static_key, self._on_static_query, long=True)
        self._frames = StreamFrames(
            name, declare_retained_publisher(session, stream_key(name)), self._describe, executor
        )
        self._token = session.token(stream_key(name))
        self._frames.describe_soon()

    @property
    def unread(self) -> bool:
        """Whether it has frames that move, and nobody listens to them now."""
        return self._sender is not None and not self._sender.heard

    def sender(self, options: StreamOptions) -> TransformSender:
        """What sends the stream's dynamic transforms, the same for all who ask.

        Raises InvalidArgumentException where it sends otherwise already.
        """
        with self._lock:
            if self._sender is None:
                self._sender = TransformSender(
                    self.name,
                    options,
                    self._epoch_ns,
                    self._session,
                    self._frames,
                    self._note_moving,
                    self._begin,
                )
                self._frames.describe_soon()
            elif self._sender.options != options:
                raise InvalidArgumentException(
                    f"stream {self.name!r} is sent with {self._sender.options}, not with "
                    f"{options}: ask for the same, or name another stream (stream=...)"
                )
            return self._sender

    def send_static(self, batch: TransformBatch) -> None:
        """Add static transforms to the stream, or replace those of the same child frame; the
        whole set is sent, and kept for those who join later.

        Raises InvalidArgumentException where a name can be no frame's, or parent and child are
        the same.
        """
        added = {ts.child_frame_id: ts for ts in batch}
        with self._static_lock:
            self._frames.note({child: (ts.frame_id, True) for child, ts in added.items()})
            self._statics |= added
            self._send_statics()

    def remove_static(self, child: str) -> None:
        """Take a static transform out of the stream. Errors as StreamFrames.remove."""
        with self._static_lock:
            self._frames.remove(child, static=True)
            self._statics.pop(child, None)
            self._send_statics()

    def _note_moving(self, edges: Edges) -> None:
        """The stream sends these frames as moving: those that were static are so no more.

        Errors as StreamFrames.note.
        """
        with self._static_lock:
            self._frames.note(edges)
            if not self._statics.keys().isdisjoint(edges):
                for child in edges:
                    self._statics.pop(child, None)
                self._executor.submit("static transforms", self._resend_statics)

    def _resend_statics(self) -> None:
        # Only after they were sent as moving, so that they are never missing.
        if self._sender is not None:
            self._sender.wait_sent()
        with self._static_lock:
            self._send_statics()

    def _send_statics(self) -> None:
        batch = TransformBatch.from_transforms(self._statics.values())
        message = TransformMessage(batch, self._epoch_ns, self._statics_sent)
        self._statics_sent += 1
        self._static_payload = encode_transforms(message)
        self._static_publisher.put(self._static_payload)

    def _on_static_query(self, query: Query) -> None:
        # The session may be closed meanwhile, and then there is nobody to tell.
        with suppress(BusError), query.answering("the static transforms"):
            if self._static_payload:
                query.answer(self._static_key, self._static_payload)

    def _begin(self, child: str, back_ns: int) -> int:
        """A new epoch, since the stamps of a frame went back; the static transforms go with it."""
        with self._static_lock:
            self._epoch_ns = max(time.time_ns(), self._epoch_ns + 1)
            self._statics_sent = 0
            if self._statics:
                self._send_statics()
        now_s = time.monotonic()
        often = now_s < self._told_epoch_s + _TELL_EPOCHS_EVERY_S
        self._told_epoch_s = now_s
        self._epochs_in_a_row = self._epochs_in_a_row + 1 if often else 1
        self._log.log(
            logging.DEBUG if often else logging.INFO,
            "The stamps of frame %r went back by %.3f s: stream %r begins anew, what was sent "
            "before counts no more, static transforms stay",
            child,
            back_ns / 1e9,
            self.name,
        )
        if self._epochs_in_a_row == _MANY_EPOCHS:
            self._log.warning(
                "Stream %r began anew %d times, each within %g s of the last, now for frame %r: "
                "each time listeners forget what moves in all of it. If that frame has a clock of "
                "its own, send it from a stream of its own (stream=...)",
                self.name,
                _MANY_EPOCHS,
                _TELL_EPOCHS_EVERY_S,
                child,
            )
        self._frames.describe_soon()
        return self._epoch_ns

    def _describe(self, frames: FrameRows) -> bytes:
        options = self._sender.options if self._sender is not None else _NOTHING_MOVES
        description = StreamDescription(
            STREAM_VERSION,
            self._node,
            self._epoch_ns,
            frames,
            host=socket.gethostname(),
            pid=os.getpid(),
            session=self._session.id,
            priority=options.priority,
            split=options.split,
            history_s=options.history_s,
            started_ns=self._started_ns,
        )
        # Its fields are what goes on the wire; of 10,000 frames `as_map` would take 20 ms.
        return encode_map(vars(description))
