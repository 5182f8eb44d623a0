"""From the bus to ROS: the transforms that a listener accepts, as tf2_ros broadcasts them."""

import threading
from collections.abc import Callable

from tfbus.base.errors import InvalidArgumentException, TfbusError, TransformException
from tfbus.base.wording import printable
from tfbus.buffer.info import Change
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.ros.bridge.common import Common
from tfbus.ros.bridge.legs import RosSender
from tfbus.ros.bridge.routes import RateLimit, Route, Routes, chosen, route
from tfbus.ros.tf_message import TFMessageWriter
from tfbus.streams.listener import TransformListener
from tfbus.streams.passing_buffer import PassingBuffer

# Changes after which other static transforms hold.
_OF_STATICS = (
    "added",
    "removed",
    "reparented",
    "became static",
    "became dynamic",
    "publisher gone",
    "publisher back",
)


class _Listener(TransformListener):
    """Leaves out transforms from ROS: this session has sent them itself."""

    _hears_itself = False


class ToRos:
    """Sends transforms of the bus to ROS, until `close()`."""

    def __init__(
        self,
        common: Common,
        dynamic: RosSender,
        static: RosSender,
        *,
        on_statics: Callable[[], object],
    ) -> None:
        self._node = common.node
        self._options = common.options
        self._names = common.names
        self._bus = common.bus
        self._crossed = common.crossed
        self._executor = common.executor
        self._once = common.once
        self._dynamic = dynamic
        self._static = static
        self._sent_by_seniors = common.sent_by_seniors
        self._on_statics = on_statics
        self._lock = threading.Lock()
        self._writer = TFMessageWriter()
        self._routes: dict[str, Routes] = {}
        # Frames that go, by the names of the bus, and the stream of each.
        self._going: dict[str, str] = {}
        # The static transforms on the bus, and the ones in ROS, by the names of the bus.
        self._held: dict[str, tuple[str, TransformStamped]] = {}
        self._sent_statics: dict[str, TransformStamped] = {}
        self._static_message = b""
        self._is_undecided = False
        self._has_senior = False
        self._is_closed = False
        self._limit = (
            None
            if common.options.rate_limit_hz is None
            else RateLimit(common.options.rate_limit_hz, self._send, common.executor)
        )
        self._buffer = PassingBuffer(on_rows=self._on_rows, leaves_out=common.bus.is_own)
        self._buffer.on_change(self._on_change)
        self._listener: TransformListener | None = None

    def listen(self) -> None:
        """Take the bus's transforms from now on."""
        self._listener = _Listener(self._buffer, self._node)

    def close(self) -> None:
        """Send nothing more. Twice is fine."""
        self._is_closed = True
        if self._listener is not None:
            self._listener.close()
        if self._limit is not None:
            self._limit.close()
        self._dynamic.close()
        self._static.close()

    @property
    def streams(self) -> dict[str, int]:
        """How many frames go of each stream."""
        found: dict[str, int] = {}
        for stream in [*self._going.values()]:
            found[stream] = found.get(stream, 0) + 1
        return found

    def sends(self, child: str) -> bool:
        """Whether a frame goes, by its name on the bus."""
        return child in self._going

    def static_of(self, child: str) -> TransformStamped | None:
        """The static transform that it sends of a frame, by its name on the bus."""
        return self._sent_statics.get(child)

    def reconsider(self) -> None:
        """The bus, or ROS, has changed."""
        with self._lock:
            self._routes.clear()
            left = [child for child, of in self._going.items() if not self._bus.is_there(of)]
            for child in left:
                del self._going[child]
        self._crossed.forget("to ROS", left)
        self._statics_soon()

    def poll(self) -> None:
        """Reconsider frames that were undecided; to be called every second."""
        if self._is_undecided or self._has_senior:
            self._is_undecided = self._has_senior = False
            self.reconsider()

    # From the bus

    def _on_rows(self, rows: Columns, static: bool, stream: str) -> None:
        if self._is_closed:
            return
        if static:
            with self._lock:
                for each in rows:
                    self._held[each.child_frame_id] = stream, each
            self._statics_soon()
            return
        with self._lock:
            way = (self._routes.get(stream) or self._routes_of(stream)).of(rows)
            if not self._dynamic.heard or (way.rows is not None and not way.rows):
                return
            if way.contested:
                rows = rows if way.rows is None else chosen(rows, way.rows)
                rows = chosen(rows, self._crossed.crosses("to ROS", rows))
                rows = rows.with_frames(way.frames)
            else:
                rows = way.renamed(rows)
            # In one go, where no limit looks at them first.
            message = self._written(rows) if self._limit is None and rows.count else None
        if message is not None:
            self._is_taken(self._dynamic, rows, message)
        elif self._limit is not None and rows.count:
            self._limit.pass_on(rows)

    def _on_change(self, change: Change) -> None:
        if change.kind in _OF_STATICS:
            self._statics_soon()

    def _routes_of(self, stream: str) -> Routes:
        routes = self._routes[stream] = Routes(lambda rows: self._route(rows, stream))
        return routes

    def _route(self, rows: Columns, stream: str) -> Route:
        goes = self._goes(stream)
        in_ros = {name: self._names.in_ros(name) for name in rows.frames}
        kept = [
            at
            for at, (parent, child) in enumerate(rows.pairs())
            if goes and self._crosses(rows.frames[parent], rows.frames[child], in_ros)
        ]
        found = route(rows, tuple(in_ros[name] or name for name in rows.frames), kept)
        for child in rows.children() - set(found.children):
            self._stays(child, stream)
        for child in found.children:
            self._going[child] = stream
        is_contested = self._crossed.record("to ROS", found.children)
        return Route(found.frames, found.rows, found.children, is_contested)

    def _stays(self, child: str, stream: str) -> None:
        """A frame of a stream does not go, or no longer."""
        if self._going.get(child) == stream:
            del self._going[child]
            self._crossed.forget("to ROS", (child,))

    def _goes(self, stream: str) -> bool:
        goes = self._bus.goes_to_ros(stream)
        self._is_undecided |= goes is None
        return goes is True

    def _crosses(self, parent: str, child: str, in_ros: dict[str, str | None]) -> bool:
        if not self._options.selects(child):
            return False
        there = in_ros[parent], in_ros[child]
        if None in there or there[0] == there[1]:
            self._once.warning(
                ("same name", child),
                "Frame '%s' does not go to ROS: '%s', without the prefix, is another frame there",
                printable(child, 60),
                printable(parent if there[0] is None else child, 60),
            )
            return False
        if self._sent_by_seniors.has(child):
            self._has_senior = True
            return False
        return True

    # To ROS

    def _send(self, rows: Columns) -> None:
        with self._lock:
            message = self._written(rows)
        if message is not None:
            self._is_taken(self._dynamic, rows, message)

    def _is_taken(self, sender: RosSender, rows: Columns, message: bytes) -> bool:
        """Send a message; whether ROS has it, or as much of it as this ROS can have."""
        try:
            sender.send(message)
        except InvalidArgumentException as error:
            self._once.warning("unwritable", "A transform does not go to ROS: %s", error)
            # The writer took them: it is ROS 1 that has no time before 1970.
            kept = [at for at, stamp_ns in enumerate(rows.stamps_as_ints()) if stamp_ns >= 0]
            left = chosen(rows, kept)
            with self._lock:
                message_left = self._written(left) if 0 < left.count < rows.count else None
            return message_left is None or self._is_taken(sender, left, message_left)
        except TfbusError as error:
            if not self._is_closed:
                self._once.warning("unsent", "Transforms do not go to ROS: %s", error)
            return False
        return True

    def _written(self, rows: Columns) -> bytes | None:
        try:
            return self._writer.write(rows)
        except InvalidArgumentException as error:
            self._once.warning("unwritable", "A transform does not go to ROS: %s", error)
        kept = [at for at in range(rows.count) if self._is_writable(chosen(rows, [at]))]
        return self._writer.write(chosen(rows, kept)) if kept else None

    def _is_writable(self, row: Columns) -> bool:
        try:
            TFMessageWriter().write(row)
        except InvalidArgumentException:
            return False
        return True

    def _statics_soon(self) -> None:
        if not self._is_closed:
            self._executor.submit("static transforms to ROS", self._send_statics, limit=1)

    def _send_statics(self) -> None:
        """Send all static transforms that cross, if they have changed."""
        with self._lock:
            crossing = self._crossing_statics()
            rows = Columns.of_transforms([self._in_ros(each) for each in crossing.values()])
            message = self._written(rows) or b""
            self._sent_statics = crossing
            is_new = message != self._static_message and (crossing or self._static_message)
        if is_new and not self._is_closed:
            if self._is_taken(self._static, rows, message):
                self._static_message = message
            else:
                # Again at the next look.
                self._is_undecided = True
            self._on_statics()

    def _crossing_statics(self) -> dict[str, TransformStamped]:
        crossing = {}
        for child, (stream, transform) in [*self._held.items()]:
            parent = transform.frame_id
            try:
                held = self._buffer.frame(child)
            except TransformException:
                del self._held[child]
                continue
            is_it = held.static and held.parent == parent and held.authority == stream
            in_ros = {name: self._names.in_ros(name) for name in (parent, child)}
            if (
                is_it
                and not held.gone
                and self._goes(stream)
                and self._crosses(parent, child, in_ros)
            ):
                crossing[child] = transform
                self._going[child] = stream
            elif is_it:
                self._stays(child, stream)
        self._crossed.record("to ROS", crossing)
        return crossing

    def _in_ros(self, transform: TransformStamped) -> TransformStamped:
        parent, child = transform.frame_id, transform.child_frame_id
        return TransformStamped(
            transform.stamp_ns,
            self._names.in_ros(parent) or parent,
            self._names.in_ros(child) or child,
            transform.transform,
        )
