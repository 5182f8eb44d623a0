"""Broadcasters: a node sends transforms to all listeners."""

from collections.abc import Iterable

from tfbus.base.arguments import called_as
from tfbus.base.stamps import (
    LATEST_OF_ANOTHER_UNIT,
    MOST_AHEAD_NS,
    is_of_simulated_clock,
    other_unit,
    unit_hint,
)
from tfbus.base.wording import age
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns, columns_of_batch
from tfbus.geometry.transform import TransformStamped
from tfbus.node.node import Node
from tfbus.streams.sender import StreamOptions
from tfbus.streams.stream import stream_of_node

# The type of the topic of a simulated time.
_CLOCK = "Clock"

# A simulation without a clock begins with so many stamps of 0 at most, one for each frame.
_MOST_ZEROS = 100

# Later than any stamp.
_NEVER_NS = 2**63

Transforms = TransformStamped | TransformBatch | Iterable[TransformStamped]


class TransformBroadcaster:
    """Sends dynamic transforms, which change with time.

    All broadcasters of a node send in the stream with the node's name, unless they name another
    `stream`; broadcasters of one stream must have the same options. With `split`, each frame is a
    message on its own key. Of two publishers of one frame, listeners with `conflicts="priority"`
    accept the higher `priority`. Messages of the last `history_s` seconds, at most 16 MiB, are kept
    for listeners that query them.

    `poses` is how precise transforms are as others receive them, and how many bytes each takes; by
    default the node's settings say it. "float64" is exact, with names in each message.
    "float32" takes 28 bytes: translations are within 6e-8 of their distance from where the frame
    was first, rotations within 1e-5 degrees. "compact" takes 18 bytes at most, and 6 if the frame
    only turns: translations are within 0.1 mm, and rotations within 0.01 degrees. A transform that
    does not fit, as more than 214 km from the first of its frame, is sent as float64.

    When the stamps of a frame go back by more than 1 s, all listeners forget the stream's samples
    so far; static transforms stay.

    Raises InvalidArgumentException if `history_s`, `priority` or `poses` is invalid, or if the
    stream already has other options.
    """

    @called_as("TransformBroadcaster(node)")
    def __init__(
        self,
        node: Node,
        *,
        stream: str | None = None,
        split: bool = False,
        priority: int = 0,
        history_s: float = 10.0,
        poses: str | None = None,
    ):
        stream_of = stream_of_node(node, stream)
        options = StreamOptions(
            split=split,
            priority=priority,
            history_s=history_s,
            poses=node.settings.poses if poses is None else poses,
        )
        self._sender = stream_of.sender(options)
        self._stream = stream or node.name
        self._node = node
        # Stamps up to this need no look: the clock is not read at each send.
        self._seems_right_to_ns = 0
        self._zeros = 0

    def send_transform(self, transforms: Transforms) -> None:
        """Send one transform, several, or a batch of columns.

        Each takes points of its child frame into its frame_id, the parent. A stamp that looks like
        seconds, milliseconds or microseconds is logged once, and so is one that is more than 20 ms
        later than the node's own clock. Raises InvalidArgumentException if parent and child are
        the same frame, or a frame name in a batch is invalid.
        """
        if isinstance(transforms, TransformStamped):
            self._sender.send_one(transforms)
            stamp_ns: int | None = transforms.stamp_ns
        else:
            columns = _as_columns(transforms)
            self._sender.send(columns)
            stamp_ns = columns.last_stamp_ns()
        if stamp_ns is not None and not (
            LATEST_OF_ANOTHER_UNIT <= stamp_ns <= self._seems_right_to_ns
        ):
            self._check_stamp(stamp_ns)

    def _check_stamp(self, stamp_ns: int) -> None:
        if stamp_ns >= LATEST_OF_ANOTHER_UNIT:
            self._check_ahead(stamp_ns)
            return
        now_ns = self._node.clock.now_ns()
        if stamp_ns == 0:
            self._check_zero(now_ns)
        elif stamp_ns > 0 and (unit := other_unit(stamp_ns, now_ns)):
            self._warn_once("Sent a transform of 1970: %s", unit_hint(stamp_ns, unit))

    def _check_zero(self, now_ns: int) -> None:
        # A simulation counts from 0, and sends each frame once there.
        self._zeros += 1
        if self._zeros > _MOST_ZEROS and not is_of_simulated_clock(now_ns):
            self._warn_once(
                "Sent %d transforms with the stamp 0 in stream %r: stamp them with node.now_ns()",
                self._zeros,
                self._stream,
            )

    def _check_ahead(self, stamp_ns: int) -> None:
        clock = self._node.clock
        now_ns = clock.now_ns()
        self._seems_right_to_ns = now_ns + MOST_AHEAD_NS
        if stamp_ns <= self._seems_right_to_ns:
            return
        self._seems_right_to_ns = _NEVER_NS
        # Others may have a simulated time before this node, and who publishes one makes it.
        if not clock.is_simulated and _CLOCK not in self._node.describe()["publishes"].values():
            self._warn_once(
                "Sent a transform %s in stream %r: stamp it with the time at which it was "
                "measured, node.now_ns(). Further ones are not logged",
                age((now_ns - stamp_ns) / 1e9),
                self._stream,
            )

    def _warn_once(self, text: str, *values: object) -> None:
        """Log the first of a kind in the stream, which several broadcasters may share."""
        if text not in self._sender.warned_of:
            self._sender.warned_of.add(text)
            self._node.log.warning(text, *values)

    def remove(self, frame: str, *more: str) -> None:
        """Take child frames out of the stream, and so out of every listener's buffer.

        Raises LookupException if the stream does not send one, InvalidArgumentException if
        it is static; then none is removed. Send a frame again to have it back.
        """
        self._sender.remove(frame, *more)


class StaticTransformBroadcaster:
    """Sends static transforms, which hold at all times.

    They are added to the static transforms of the stream, or replace the one of the same child
    frame. As long as the node lives they reach listeners that join later too.
    """

    @called_as("StaticTransformBroadcaster(node)")
    def __init__(self, node: Node, *, stream: str | None = None):
        self._stream = stream_of_node(node, stream)

    @called_as("send_transform(TransformStamped(stamp_ns, frame_id, child_frame_id, transform))")
    def send_transform(self, transforms: Transforms) -> None:
        """Send one transform, several, or a batch, as `TransformBroadcaster.send_transform`."""
        if isinstance(transforms, TransformStamped):
            transforms = (transforms,)
        self._stream.send_static(transforms)

    def remove(self, frame: str, *more: str) -> None:
        """Take child frames out of the stream, and so out of every listener's buffer.

        Raises LookupException if the stream does not send one, InvalidArgumentException if
        it is not static; then none is removed.
        """
        self._stream.remove_static(frame, *more)


def _as_columns(transforms: TransformBatch | Iterable[TransformStamped]) -> Columns:
    if isinstance(transforms, TransformBatch):
        return columns_of_batch(transforms)
    return Columns.of_transforms(transforms)
