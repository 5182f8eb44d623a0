"""Which frames a stream has; others are told in the stream's description."""

import difflib
import threading
from collections.abc import Callable, Mapping

from tfbus.bus.handles import BytesPublisher
from tfbus.errors import InvalidArgumentException, LookupException
from tfbus.geometry.transform import check_frame_id
from tfbus.runtime.executor import Executor

# Of each child frame: its parent, and whether the transform is static.
Edges = Mapping[str, tuple[str, bool]]
FrameRows = tuple[tuple[str, str, bool], ...]

# New frames often come in a burst: one description tells of all of them. One of many frames is
# sent less often, so that frames that come one by one do not cost more than this.
_DESCRIBE_AFTER_S = 0.02
_MOST_BYTES_A_SECOND = 1e6
_DESCRIBE_WITHIN_S = 1.0

_FRAMES_NAMED = 5
_KINDS = {
    False: "moves: remove it by a TransformBroadcaster",
    True: "is static: remove it by a StaticTransformBroadcaster",
}


class StreamFrames:
    """The frames of a stream. Each change is told soon, on the node's thread: `publisher` sends
    `describe(rows)` of all rows (parent, child, static). `moves` counts how often a frame that was
    there already got another parent.
    """

    def __init__(
        self,
        stream: str,
        publisher: BytesPublisher,
        describe: Callable[[FrameRows], bytes],
        executor: Executor,
    ) -> None:
        self._stream = stream
        self._publisher = publisher
        self._describe = describe
        self._executor = executor
        # Held while one is sent, so that descriptions leave in their order.
        self._telling = threading.Lock()
        self._lock = threading.Lock()
        self._edges: dict[str, tuple[str, bool]] = {}
        self._is_due = False
        self._described_bytes = 0
        self.moves = 0

    def note(self, edges: Edges) -> None:
        """The stream sends these edges too.

        Raises InvalidArgumentException where a name can be no frame's, or parent and child are
        the same: no buffer would take them.
        """
        with self._lock:
            if edges.items() <= self._edges.items():
                return
            for child, (parent, _) in edges.items():
                _check(parent, child)
            self.moves += any(self._edges.get(child, edge) != edge for child, edge in edges.items())
            self._edges |= edges
        self.describe_soon()

    def remove(self, child: str, *, static: bool) -> None:
        """The stream does not send this frame any more.

        Raises LookupException where it never did, InvalidArgumentException where it is of the
        other kind.
        """
        with self._lock:
            if child not in self._edges:
                raise self._unknown(child, static)
            if self._edges[child][1] is not static:
                raise InvalidArgumentException(
                    f"frame {child!r} of stream {self._stream!r} {_KINDS[not static]}"
                )
        # Others know that it was removed by its being in one description, and not in the next.
        self._describe_now()
        with self._lock:
            self._edges.pop(child, None)
        self.describe_soon()

    def describe_soon(self) -> None:
        """Tell others what the stream is now."""
        with self._lock:
            if self._is_due:
                return
            self._is_due = True
            spared_s = min(self._described_bytes / _MOST_BYTES_A_SECOND, _DESCRIBE_WITHIN_S)
        self._executor.after(max(_DESCRIBE_AFTER_S, spared_s), self._describe_now)

    def _describe_now(self) -> None:
        with self._telling:
            with self._lock:
                if not self._is_due:
                    return
                self._is_due = False
                rows = tuple((parent, child, kind) for child, (parent, kind) in self._edges.items())
            payload = self._describe(rows)
            self._described_bytes = len(payload)
            self._publisher.put(payload)

    def _unknown(self, child: str, static: bool) -> LookupException:
        sent = [other for other, (_, other_static) in self._edges.items() if other_static is static]
        nearest = tuple(difflib.get_close_matches(child, sent, n=3))
        kind = "static frame" if static else "frame"
        more = f" and {len(sent) - _FRAMES_NAMED} more" if len(sent) > _FRAMES_NAMED else ""
        named = ", ".join(map(repr, sent[:_FRAMES_NAMED])) or "none"
        return LookupException(
            f"stream {self._stream!r} sends no {kind} {child!r}; it sends {named}{more}",
            frame=child,
            nearest=nearest,
        )


def _check(parent: str, child: str) -> None:
    check_frame_id(parent)
    check_frame_id(child)
    if parent == child:
        raise InvalidArgumentException(
            f"frame {child!r} cannot be its own parent; frame_id and child_frame_id differ"
        )
