"""A stream: the transforms that one node publishes under one name.

Each stream has a liveliness token, and a retained description at the same key with its node, its
epoch and its frames: others know which frames exist, and their publishers, without reading a
transform.
"""

import logging
import math
import os
import socket
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from typing import Any

from tfbus.base import scheduler
from tfbus.base.errors import BusError, InvalidArgumentException
from tfbus.base.executor import Executor
from tfbus.base.wording import printable
from tfbus.bus.query import Query
from tfbus.bus.retained import declare_retained_publisher
from tfbus.bus.session import Session
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped, stamped_list
from tfbus.node.node import Node
from tfbus.streams.retained import Edges, FrameAnnouncer, FrameRows
from tfbus.streams.sender import StreamOptions, TransformSender
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import (
    STREAM_VERSION,
    FramesAsked,
    StreamDescription,
    encode_stream,
)
from tfbus.wire.keys import escape, mistake_in_stream, static_transforms_key, stream_key
from tfbus.wire.transforms import TransformMessage, encode_transforms

# Epochs closer to each other than this, as of a short recording in a loop, are logged once.
_LOG_EPOCHS_EVERY_S = 5.0
# This many in a row are no accident.
_MANY_EPOCHS = 10

_AT_ONCE_S = 0.001

# The options of a stream without dynamic transforms.
_ONLY_STATIC = StreamOptions(history_s=0.0)


class Stream:
    """Publishes the dynamic and static transforms of one stream; safe from any thread.

    Its first epoch is the one given. A new one begins when its stamps go back by more than 1 s:
    listeners then forget its earlier samples, except static transforms.
    """

    def __init__(
        self,
        name: str,
        node: str,
        epoch_ns: int,
        session: Session,
        executor: Executor,
        log: logging.Logger,
        *,
        origin: tuple[str, ...] = (),
    ) -> None:
        """Publish it. Raises InvalidArgumentException for a name that listeners would ignore."""
        if mistake := mistake_in_stream(name):
            raise InvalidArgumentException(
                f"a stream cannot be called '{printable(name, most=60)}': {mistake}"
            )
        session.settings.check_right("nodes", escape(name))
        self.name = name
        self._node = node
        self._started_ns = self._epoch_ns = epoch_ns
        self._session = session
        self._executor = executor
        self._log = log
        self._lock = scheduler.Lock()
        self._sender: TransformSender | None = None
        # No lock that a dynamic send takes is held while something retained is sent, which may wait
        # for the link: `_sending_statics` has them leave in their order.
        self._static_lock = scheduler.Lock()
        self._sending_statics = scheduler.Lock()
        self._last_epoch_s = -math.inf
        self._epochs_in_a_row = 0
        self._statics: dict[str, TransformStamped] = {}
        self._statics_sent = 0
        self._static_payload = b""
        self._static_key = static_transforms_key(name)
        self._static_publisher = declare_retained_publisher(session, self._static_key)
        self._frames = FrameAnnouncer(
            name,
            declare_retained_publisher(session, stream_key(name)),
            self._describe,
            executor,
            partial(session.settings.check_right, "frames"),
        )
        # If Zenoh's own recovery of the retained set fails, listeners query this key.
        self._queryable = session.queryable(self._static_key, self._on_static_query, long=True)
        self._token = session.token(stream_key(name))
        self._origin = origin
        self._frames.announce_soon()
        executor.streams.add(name)

    @property
    def started_ns(self) -> int:
        """When it began, its first epoch, in ns since the Unix epoch."""
        return self._started_ns

    @property
    def origin(self) -> tuple[str, ...]:
        """The gids of the ROS publishers whose transforms it carries; can be set."""
        return self._origin

    @origin.setter
    def origin(self, gids: tuple[str, ...]) -> None:
        if gids != self._origin:
            self._origin = gids
            self._frames.announce_soon(_AT_ONCE_S)

    def close(self) -> None:
        """End it: listeners then mark its frames as gone. Twice is fine."""
        self._token.close()
        self._frames.close()
        if self._sender is not None:
            self._sender.close()
        self._queryable.close()
        self._static_publisher.close()

    @property
    def unread(self) -> bool:
        """Whether it has dynamic transforms, and no process subscribes to them now."""
        return self._sender is not None and not self._sender.heard

    def sender(self, options: StreamOptions) -> TransformSender:
        """The sender of the stream's dynamic transforms, the same for all callers.

        Raises InvalidArgumentException if it has other options already.
        """
        with self._lock:
            if self._sender is None:
                self._sender = TransformSender(
                    self.name,
                    options,
                    self._epoch_ns,
                    self._session,
                    self._frames,
                    self._note_dynamic,
                    self._begin_epoch,
                )
                self._frames.announce_soon()
            elif self._sender.options != options:
                raise InvalidArgumentException(
                    f"stream {self.name!r} already has {self._sender.options}, not "
                    f"{options}: use the same options, or another stream (stream=...)"
                )
            return self._sender

    def send_static(self, transforms: Iterable[TransformStamped]) -> None:
        """Add static transforms to the stream; one of the same child frame is replaced.

        The whole set is sent, and retained for listeners that join later. Raises
        InvalidArgumentException if a frame name is invalid, or parent and child are the same, or
        one is no TransformStamped.
        """
        added = {ts.child_frame_id: ts for ts in stamped_list(transforms)}
        with self._static_lock:
            self._frames.add({child: (ts.frame_id, True) for child, ts in added.items()})
            self._statics |= added
        self._send_statics()

    def remove_static(self, *children: str) -> None:
        """Take static transforms out of the stream. Errors as FrameAnnouncer.remove."""
        self._frames.announce()
        with self._static_lock:
            self._frames.remove(*children, static=True)
            for child in children:
                self._statics.pop(child, None)
        self._send_statics()

    def _note_dynamic(self, edges: Edges) -> None:
        """Note that the stream sends these frames as dynamic; static ones of them become so.

        Errors as FrameAnnouncer.add.
        """
        with self._static_lock:
            self._frames.add(edges)
            if not self._statics.keys().isdisjoint(edges):
                for child in edges:
                    self._statics.pop(child, None)
                self._executor.submit("static transforms", self._resend_statics)

    def _resend_statics(self) -> None:
        # Only after they were sent as dynamic, so that they are never missing.
        if self._sender is not None:
            self._sender.wait_sent()
        self._send_statics()

    def _send_statics(self) -> None:
        with self._sending_statics:
            with self._static_lock:
                rows = Columns.of_transforms(self._statics.values())
                message = TransformMessage(rows, self._epoch_ns, self._statics_sent)
                self._statics_sent += 1
            self._static_payload = encode_transforms(message)
            self._static_publisher.put(self._static_payload)

    def _on_static_query(self, query: Query) -> None:
        is_of_description = query.parameter("description") is not None
        key, payload = (
            (stream_key(self.name), self._frames.described)
            if is_of_description
            else (self._static_key, self._static_payload)
        )
        # The session may be closed meanwhile.
        with suppress(BusError), query.answering("what the stream retains"):
            if payload and (not is_of_description or self._is_asked(query.payload)):
                query.answer(key, payload)

    def _is_asked(self, payload: bytes) -> bool:
        """Whether a question for descriptions is about this stream; DecodeError for a bad one."""
        return not payload or self._frames.lists_any_of(
            decode_message(FramesAsked, payload).children
        )

    def _begin_epoch(self, child: str, back_ns: int) -> int:
        """Begin an epoch, as the stamps of a frame went back; static transforms are sent again."""
        with self._static_lock:
            self._epoch_ns = max(scheduler.time_ns(), self._epoch_ns + 1)
            self._statics_sent = 0
            if self._statics:
                self._executor.submit("static transforms", self._resend_statics)
        self._log_epoch(child, back_ns)
        # Listeners hold back its messages until it comes.
        self._frames.announce_soon(_AT_ONCE_S)
        return self._epoch_ns

    def _log_epoch(self, child: str, back_ns: int) -> None:
        now_s = scheduler.monotonic()
        is_in_a_row = now_s < self._last_epoch_s + _LOG_EPOCHS_EVERY_S
        self._last_epoch_s = now_s
        self._epochs_in_a_row = self._epochs_in_a_row + 1 if is_in_a_row else 1
        self._log.log(
            logging.DEBUG if is_in_a_row else logging.INFO,
            "Stream %r restarted: the stamps of frame %r went back by %.3f s. Listeners forget "
            "what it sent before, except static transforms",
            self.name,
            child,
            back_ns / 1e9,
        )
        if self._epochs_in_a_row == _MANY_EPOCHS:
            self._log.warning(
                "Stream %r restarted %d times, each within %g s of the last, now for frame %r: "
                "each time listeners forget all its dynamic transforms. If that frame has a clock "
                "of its own, send it in a separate stream (stream=...)",
                self.name,
                _MANY_EPOCHS,
                _LOG_EPOCHS_EVERY_S,
                child,
            )

    def _describe(self, frames: FrameRows) -> bytes:
        options = self._sender.options if self._sender is not None else _ONLY_STATIC
        description = StreamDescription(
            STREAM_VERSION,
            self._node,
            self._epoch_ns,
            frames,
            host=printable(socket.gethostname()),
            pid=os.getpid(),
            session=self._session.id,
            priority=options.priority,
            split=options.split,
            history_s=options.history_s,
            started_ns=self._started_ns,
            origin=self._origin,
        )
        if self._sender is not None and self._sender.numbering is not None:
            description = self._sender.numbering.describe(description)
        return encode_stream(description)


class NodeStreams:
    """The streams of one node; it finds them again among the node's describers."""

    def __init__(self) -> None:
        self._lock = scheduler.Lock()
        self._by_name: dict[str, Stream] = {}

    @classmethod
    def of_node(cls, node: Node) -> "NodeStreams":
        """The streams of the node, made at the first call."""
        if (found := cls._found(node)) is not None:
            return found
        made = cls()
        node.describers.append(made)
        # Of two threads that come here at once both take the first.
        found = cls._found(node)
        if found is not made:
            node.describers.remove(made)
        return found or made

    @classmethod
    def _found(cls, node: Node) -> "NodeStreams | None":
        return next((each for each in [*node.describers] if isinstance(each, cls)), None)

    def get(self, node: Node, name: str) -> Stream:
        """The node's stream of this name, made at the first call."""
        with self._lock:
            if name not in self._by_name:
                self._by_name[name] = Stream(
                    name, node.full_name, node.started_ns, node.session, node.executor, node.log
                )
            return self._by_name[name]

    def reopen(self, node: Node, name: str, origin: tuple[str, ...]) -> Stream:
        """A new stream of this name and origin, whose first epoch begins now, in place of a former
        one.
        """
        self.close(name)
        with self._lock:
            stream = self._by_name[name] = Stream(
                name,
                node.full_name,
                scheduler.time_ns(),
                node.session,
                node.executor,
                node.log,
                origin=origin,
            )
            return stream

    def close(self, name: str) -> None:
        """End the stream of this name, if there is one."""
        with self._lock:
            stream = self._by_name.pop(name, None)
        if stream is not None:
            stream.close()

    def __call__(self) -> dict[str, list[Any]]:
        """The streams in the node's description of itself."""
        streams = dict(self._by_name)
        return {
            "streams": sorted(streams),
            "unread": sorted(name for name, stream in streams.items() if stream.unread),
        }


def stream_of_node(node: Node, name: str | None = None) -> Stream:
    """The stream of this name that the node publishes; of the node's own name if it is None."""
    if not hasattr(node, "describers"):
        raise InvalidArgumentException(
            "a broadcaster takes a Node, as in TransformBroadcaster(node), not "
            f"{type(node).__name__}"
        )
    return NodeStreams.of_node(node).get(node, name or node.name)
