"""The messages of one topic as they are drawn: their choice, place and time."""

import io
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus import messages
from tfbus.base.errors import TransformException
from tfbus.base.wording import printable
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.transform import Transform
from tfbus.messages import CompressedImage, Image
from tfbus.view.data.markers import item_of
from tfbus.view.data.shapes import (
    RGB_OF,
    Frustum,
    Item,
    Points,
    Shape,
    columns_of,
    items_of,
    line_along,
    pose_and_doubt,
)
from tfbus.view.data.topics import POINTS, Past, Waiting
from tfbus.view.settings import TopicSettings
from tfbus.wire.fleet import FrameNames

Picture = NDArray[np.uint8]

# A message whose transform is not known after so long is not drawn.
_WAITS_S = 5.0
_TROUBLE_AFTER_S = 1.0
# Of clouds that decay, as many points are drawn, in as many items; of markers as many.
MOST_DECAYING_POINTS = 500_000
_MOST_DECAYING = 60
# Above that, neighbouring items are joined until so few are left: browsers get each joined item as
# a whole, so that joining one at each message would send its points many times.
_FEW_DECAYING = 40
_MOST_MARKERS = 2000
_MOST_TRAIL = 2000
_MOST_LINES = 100
_MOST_NAMESPACES = 50

_IMAGES = (messages.Image, messages.CompressedImage)


@dataclass(frozen=True, eq=False)
class PlacedItem:
    """An item at a pose in the fixed frame, until the time `ends_s`, with the points of `messages`
    messages, which came within `joins_s` seconds.
    """

    item: Item
    pose: Transform
    ends_s: float = math.inf
    messages: int = 1
    joins_s: float = 0.0


class TopicLayer:
    """The messages of one topic that are drawn: `placed` items by key, a `picture`, or log `lines`.

    `drawn` messages were; `dropped` messages or markers were not, by reason. Points can be coloured
    by `columns`, and `span` are the numbers of the first and the last colour, if
    numbers are coloured. `is_cut` says that points left early, as they were too many, and might
    still be there.
    `namespaces` are the markers'. `age_s` is how old the message drawn last was then. `waits_in` is
    the frame of messages that wait for a transform for some time, `waiting_count` of them; "" if
    none does.
    """

    def __init__(self, waiting: Waiting) -> None:
        self.waiting = waiting
        self.placed: dict[object, PlacedItem] = {}
        self.picture: Picture | None = None
        self.lines: deque[messages.Log] = deque(maxlen=_MOST_LINES)
        self.columns: tuple[str, ...] = ()
        self.span: tuple[float, float] | None = None
        self.is_cut = False
        self.namespaces: dict[str, None] = {}
        self.age_s: float | None = None
        self._newest_ns = 0
        self.waits_in = ""
        self.drawn = 0
        self.dropped: Counter[str] = Counter()
        self._refusal = self._waits_for = ""
        # Why the last message that was sent to browsers could not be, in part.
        self._undrawn = ""
        self._is_new = self._has_failed = False
        # Each with the times since which it waits, and at which it ends.
        self._unplaced: dict[object, tuple[Item, float, float]] = {}
        self._cut_until_s = -math.inf
        self._fixed_frame = ""
        self._settings: TopicSettings | None = None
        self._last: Any = None
        # The points drawn last, and the message that they are of.
        self._source: tuple[Shape | None, Any] = None, None
        self._due_s = self._pace_s = 0.0
        self._waits_since_s: float | None = None
        self._count = 0
        self._trail: deque[tuple[float, float, float]] = deque(maxlen=_MOST_TRAIL)

    @property
    def trouble(self) -> str:
        """Why the last message, or part of it, is not drawn; "" if it is."""
        return self._refusal or self._undrawn or self._waits_for

    @property
    def waiting_count(self) -> int:
        """How many messages, or markers, wait."""
        return len(self._unplaced) + len(self.waiting)

    def was_sent(self, now_ns: int) -> None:
        """Note that browsers get the drawn messages, at this time of the bus."""
        if self._newest_ns:
            self.age_s = (now_ns - self._newest_ns) / 1e9
            self._newest_ns = 0
        if self._is_new and not self._has_failed:
            self._undrawn = ""
        self._is_new = self._has_failed = False

    def step(
        self,
        buffer: Buffer,
        fixed_frame: str,
        now_s: float,
        settings: TopicSettings,
        camera: messages.CameraInfo | None = None,
        *,
        pace_s: float | None = None,
    ) -> None:
        """Take the messages that came, and place the drawn items; `now_s` is of the clock by which
        they come, and `pace_s` of the one by which they are drawn, the same by default.
        """
        self._pace_s = now_s if pace_s is None else pace_s
        if fixed_frame != self._fixed_frame:
            self._change_fixed_frame(buffer, fixed_frame, now_s)
        for key in [key for key, each in self.placed.items() if each.ends_s <= now_s]:
            del self.placed[key]
        if self._last is not None and not _are_alike(self._settings, settings):
            self._again(buffer, now_s, settings)
        self._settings = settings
        before = self.drawn
        if self._pace_s >= self._due_s and self.waiting.is_every:
            self._take_every(now_s, settings)
        elif self._pace_s >= self._due_s:
            self._take_newest(buffer, now_s, settings, camera)
        self._is_new = self._is_new or self.drawn != before
        self._place(buffer, now_s)
        if settings.decay_s and self.waiting.message_type in POINTS:
            self._bound_points(now_s + settings.decay_s)
        self.is_cut = now_s < self._cut_until_s

    def _change_fixed_frame(self, buffer: Buffer, fixed_frame: str, now_s: float) -> None:
        """Place the items in another fixed frame, for as long as they had. Points that decay go by
        where the former frame is now once some were joined, as the places of their messages are no
        longer known, or if their stamp is too old.
        """
        way = self._way_into(buffer, fixed_frame) if self.placed else None
        self._fixed_frame = fixed_frame
        # Without a place in the new one they would be drawn at a wrong one.
        placed, self.placed = self.placed, {}
        is_joined = any(each.messages > 1 for each in placed.values())
        for key, each in placed.items():
            pose = None
            if self.waiting.message_type in POINTS and each.item.lifetime_s:
                # All alike, so that the picture stays whole.
                pose = None if is_joined else self._pose(buffer, each.item, now_s)
                pose = way @ each.pose if pose is None and way is not None else pose
            if pose is not None:
                self.placed[key] = replace(each, pose=pose)
            elif each.messages == 1:
                self._unplaced.setdefault(key, (each.item, now_s, each.ends_s))

    def _way_into(self, buffer: Buffer, fixed_frame: str) -> Transform | None:
        """The newest transform from the fixed frame into another; None if it is not known."""
        try:
            return buffer.lookup_transform(fixed_frame, self._fixed_frame).transform
        except TransformException:
            return None

    def recall(
        self,
        past: Iterable[Past],
        fixed_frame: str,
        settings: TopicSettings,
        camera: messages.CameraInfo | None = None,
    ) -> None:
        """Draw earlier messages, each at its time."""
        for buffer, came_s, came in past:
            for message in came:
                self.waiting.put(message)
            self._due_s = 0.0
            self.step(buffer, fixed_frame, came_s, settings, camera)
        self._due_s = 0.0

    def is_by(self, fixed_frame: str, settings: TopicSettings) -> bool:
        """Whether drawn items stay valid in this fixed frame, under these settings."""
        return self._fixed_frame == fixed_frame and _are_alike(self._settings, settings)

    def _again(self, buffer: Buffer, now_s: float, settings: TopicSettings) -> None:
        """Draw the last message by other settings."""
        self.placed.clear()
        self._unplaced.clear()
        self._cut_until_s = -math.inf
        if not isinstance(self._last, _IMAGES):
            self._try(buffer, self._last, now_s, settings, None)

    # The newest message

    def _take_newest(
        self,
        buffer: Buffer,
        now_s: float,
        settings: TopicSettings,
        camera: messages.CameraInfo | None,
    ) -> None:
        taken = self.waiting.take()
        if not taken:
            return
        for at in range(len(taken) - 1, -1, -1):
            if self._try(buffer, taken[at], now_s, settings, camera):
                self._due_s = self._pace_s + 1.0 / settings.rate_hz
                self._waits_since_s = None
                self.waiting.put_back(taken[at + 1 :])
                return
        if self._waits_since_s is None:
            self._waits_since_s = now_s
        if now_s - self._waits_since_s < _WAITS_S:
            self.waiting.put_back(taken)
        elif self._is_at_any_time(taken[-1], settings):
            self.waiting.put_back(taken[-1:])
        else:
            self.dropped["no transform"] += len(taken)
            self._waits_since_s = None

    def _is_at_any_time(self, message: Any, settings: TopicSettings) -> bool:
        """Whether any transform of its frame places a message, also one that comes long after."""
        is_map = isinstance(message, messages.OccupancyGrid)
        return is_map or settings.locked or not message.stamp_ns

    def _try(
        self,
        buffer: Buffer,
        message: Any,
        now_s: float,
        settings: TopicSettings,
        camera: messages.CameraInfo | None,
    ) -> bool:
        """Draw a message; False if its transform is not known."""
        try:
            seen = called_outside(message, self.waiting.names)
            items = self._items(buffer, seen, settings, camera)
        except TransformException as error:
            self._wait(error, now_s, self._waits_since_s, seen.frame_id)
            return False
        except _REFUSALS as error:
            self._refuse(error)
            return True
        self._refusal = self._waits_for = self.waits_in = ""
        self._last = message
        self._newest_ns = message.stamp_ns
        self.drawn += 1
        for item in items:
            if isinstance(message, POINTS) and settings.decay_s:
                self._count += 1
                item = replace(item, key=self._count, lifetime_s=settings.decay_s)
            self._add(item, now_s)
        if isinstance(message, POINTS):
            self.columns = columns_of(message)
            [points] = [shape for shape in items[0].shapes if isinstance(shape, Points)]
            self.span = points.span
            self._source = points, seen
        return True

    def source_of(self, points: Points) -> Any:
        """The message that points are of, with its frame's name from outside; None for points of an
        earlier message. Safe from any thread.
        """
        shape, message = self._source
        return message if shape is points else None

    def _items(
        self,
        buffer: Buffer,
        message: Any,
        settings: TopicSettings,
        camera: messages.CameraInfo | None,
    ) -> list[Item]:
        if isinstance(message, _IMAGES):
            self.picture = picture_of(message)
            return _frustum(message, self.picture, camera, settings)
        fixed_frame = self._fixed_frame
        if not message.frame_id:
            raise ValueError("it has no frame_id")
        # A map is older than the buffer: it is drawn where its frame is.
        if isinstance(message, messages.OccupancyGrid):
            settings = replace(settings, locked=True)
        if isinstance(message, POINTS) and not settings.locked:
            message = _straight(buffer, message, fixed_frame)
        stamp_ns = None if settings.locked else message.stamp_ns or None
        found = buffer.lookup_transform(fixed_frame, message.frame_id, stamp_ns)
        return items_of(message, settings, found.transform)

    def _bound_points(self, ends_s: float) -> None:
        """Of points that decay the oldest leave if there are too many; the newest end at `ends_s`.
        Browsers have few items: those that came one after the other within the shortest time
        become one.
        """
        counts = {key: len(_points_of(each).xyz) for key, each in self.placed.items()}
        total = sum(counts.values())
        if total > MOST_DECAYING_POINTS:
            self._cut_until_s = ends_s
        for key in [*counts][:-1]:
            if total <= MOST_DECAYING_POINTS:
                break
            del self.placed[key]
            total -= counts[key]
        is_full = len(self.placed) > _MOST_DECAYING
        while is_full and len(self.placed) > _FEW_DECAYING:
            _, first, second = min(
                (_joined_s(self.placed[first], self.placed[second]), first, second)
                for first, second in pairwise(self.placed)
            )
            self.placed[first] = _joined(self.placed[first], self.placed.pop(second))

    # Every message

    def _take_every(self, now_s: float, settings: TopicSettings) -> None:
        taken = self.waiting.take()
        for message in taken:
            _TAKERS[type(message)](self, called_outside(message, self.waiting.names), now_s)
            self.drawn += 1
        if taken:
            last = (
                taken[-1].markers[-1:]
                if isinstance(taken[-1], messages.MarkerArray)
                else taken[-1:]
            )
            self._newest_ns = last[0].stamp_ns if last else 0
        if taken and isinstance(taken[-1], messages.Odometry):
            self._due_s = self._pace_s + 1.0 / settings.rate_hz
            newest = called_outside(taken[-1], self.waiting.names)
            self._draw_odometry(newest, now_s, settings)

    def _take_log(self, line: messages.Log, now_s: float) -> None:
        self.lines.append(line)

    def _take_markers(self, array: messages.MarkerArray, now_s: float) -> None:
        self._refusal = ""
        for marker in array.markers:
            self._take_one(marker, now_s)

    def _take_marker(self, marker: messages.Marker, now_s: float) -> None:
        self._refusal = ""
        self._take_one(marker, now_s)

    def _take_one(self, marker: messages.Marker, now_s: float) -> None:
        key = (marker.ns, marker.id)
        if len(self.namespaces) < _MOST_NAMESPACES:
            self.namespaces.setdefault(marker.ns)
        if marker.action == messages.Marker.DELETEALL:
            for kept in [*self.placed, *self._unplaced]:
                if not marker.ns or (isinstance(kept, tuple) and kept[0] == marker.ns):
                    self._remove(kept)
        elif marker.action == messages.Marker.DELETE:
            self._remove(key)
        elif not self._has_room(key):
            self._refuse(ValueError(f"more than {_MOST_MARKERS} markers are not drawn"))
        else:
            try:
                self._add(item_of(marker), now_s)
            except _REFUSALS as error:
                self._remove(key)
                self._refuse(error)

    def _has_room(self, key: object) -> bool:
        """Whether a marker can be drawn, too; one that is there already, at its new place."""
        if key in self.placed or key in self._unplaced:
            return True
        # One that moves may be among both.
        most = len(self.placed) + len(self._unplaced)
        return most < _MOST_MARKERS or len({*self.placed, *self._unplaced}) < _MOST_MARKERS

    def _take_odometry(self, odometry: messages.Odometry, now_s: float) -> None:
        at = odometry.pose.pose.position
        self._trail.append((at.x, at.y, at.z))

    def _draw_odometry(
        self, odometry: messages.Odometry, now_s: float, settings: TopicSettings
    ) -> None:
        rgb = settings.painted(RGB_OF[messages.Odometry])
        trail = line_along(np.array(self._trail).reshape(-1, 3), rgb)
        shapes: tuple[Shape, ...] = (trail, *pose_and_doubt(odometry.pose, settings))
        stamp_ns = odometry.stamp_ns
        self._add(Item("", odometry.frame_id, stamp_ns, shapes, is_locked=settings.locked), now_s)

    # Places

    def _add(self, item: Item, now_s: float) -> None:
        ends_s = now_s + item.lifetime_s if item.lifetime_s else math.inf
        self._unplaced[item.key] = item, now_s, ends_s

    def _remove(self, key: object) -> None:
        self.placed.pop(key, None)
        self._unplaced.pop(key, None)

    def _place(self, buffer: Buffer, now_s: float) -> None:
        for key, (item, since_s, ends_s) in [*self._unplaced.items()]:
            pose = self._pose(buffer, item, now_s, since_s)
            if pose is not None:
                self._waits_for = self.waits_in = ""
                # Items that decay are in their order.
                self.placed.pop(key, None) if item.lifetime_s else None
                self.placed[key] = PlacedItem(item, pose, ends_s)
                del self._unplaced[key]
            elif now_s >= ends_s or (
                now_s - since_s >= _WAITS_S and item.stamp_ns and not item.is_locked
            ):
                del self._unplaced[key]
                self.placed.pop(key, None)
                self.dropped["no transform"] += 1
        locked = [(key, each) for key, each in self.placed.items() if each.item.is_locked]
        for key, each in locked:
            pose = self._pose(buffer, each.item, now_s)
            if pose is not None and pose != each.pose:
                self.placed[key] = replace(each, pose=pose)

    def _pose(
        self, buffer: Buffer, item: Item, now_s: float, since_s: float | None = None
    ) -> Transform | None:
        stamp_ns = None if item.is_locked else item.stamp_ns or None
        try:
            found = buffer.lookup_transform(self._fixed_frame, item.frame_id, stamp_ns)
        except TransformException as error:
            self._wait(error, now_s, since_s, item.frame_id)
            return None
        return found.transform @ item.pose

    def _wait(
        self, error: TransformException, now_s: float, since_s: float | None, frame_id: str
    ) -> None:
        # A transform that comes a little after its message is no trouble.
        if since_s is not None and now_s - since_s > _TROUBLE_AFTER_S:
            self._waits_for = printable(str(error), 300)
            self.waits_in = frame_id

    def fail(self, error: Exception, key: object = None) -> None:
        """Drop the item of this key, which cannot be drawn; without one all that wait."""
        if key is None:
            self._unplaced.clear()
        self._remove(key)
        self.dropped["cannot be drawn"] += 1
        self._undrawn, self._has_failed = printable(str(error), 300), True

    def _refuse(self, error: Exception) -> None:
        self.dropped["cannot be drawn"] += 1
        self._refusal = printable(str(error), 300)


def _are_alike(former: TopicSettings | None, settings: TopicSettings) -> bool:
    """Whether drawn items stay valid under the new settings. Points that decay cannot be drawn
    anew: their messages are gone.
    """
    return former is None or settings == replace(
        former, size=settings.size, rate_hz=settings.rate_hz
    )


def _points_of(placed: PlacedItem) -> Points:
    """The points of an item of a cloud or scan."""
    return next(shape for shape in placed.item.shapes if isinstance(shape, Points))


def _joined_s(before: PlacedItem, after: PlacedItem) -> float:
    """The span in s in which the messages of both came."""
    return before.joins_s + after.ends_s - before.ends_s


def _joined(before: PlacedItem, after: PlacedItem) -> PlacedItem:
    """The points of both as an item at the pose of the first, until the end of the second."""
    first, second = _points_of(before), _points_of(after)
    moved = (~before.pose @ after.pose).apply(second.xyz.astype(np.float64))
    points = replace(
        second,
        xyz=np.concatenate((first.xyz, moved.astype(np.float32))),
        colors=np.concatenate((first.colors, second.colors)),
        rows=np.concatenate((first.rows, second.rows)),
    )
    item = replace(before.item, shapes=(points,))
    count = before.messages + after.messages
    return PlacedItem(item, before.pose, after.ends_s, count, _joined_s(before, after))


# By the numbers in a message: its checks cannot foresee all.
_REFUSALS = (ValueError, ArithmeticError, IndexError, TypeError, MemoryError)

_TAKERS: Mapping[type, Callable[[TopicLayer, Any, float], None]] = {
    messages.Log: TopicLayer._take_log,
    messages.Marker: TopicLayer._take_marker,
    messages.MarkerArray: TopicLayer._take_markers,
    messages.Odometry: TopicLayer._take_odometry,
}


def called_outside(message: Any, names: FrameNames | None) -> Any:
    """The message with its frames' names from outside of the namespace of its robot."""
    if names is None or not names.namespace:
        return message
    if isinstance(message, messages.MarkerArray):
        markers = tuple(called_outside(each, names) for each in message.markers)
        return replace(message, markers=markers)
    if isinstance(message, messages.Log):
        return message
    return replace(message, frame_id=names.outside(message.frame_id))


def _straight(buffer: Buffer, message: Any, fixed_frame: str) -> Any:
    """A scan or cloud in the fixed frame, if its points have times of their own, else as it is."""
    if isinstance(message, messages.LaserScan):
        has_times = bool(message.time_increment and len(message.ranges))
    else:
        has_times = message.time_column is not None and len(message) > 0
    return buffer.transform(message, fixed_frame) if has_times and message.stamp_ns else message


def _frustum(
    image: Any, picture: Picture, camera: messages.CameraInfo | None, settings: TopicSettings
) -> list[Item]:
    """The frustum of an image's camera; none without a calibration."""
    if camera is None or not image.frame_id or camera.height < 1:
        return []
    focal = camera.k[4]
    if not (math.isfinite(focal) and focal > 0.0):
        return []
    fov_y_rad = 2.0 * math.atan(camera.height / 2.0 / focal)
    fov_y_rad = min(max(fov_y_rad, 0.01), 3.0)
    shape = Frustum(fov_y_rad, picture, settings.scale, int(settings.quality))
    return [Item("", image.frame_id, image.stamp_ns, (shape,), is_locked=settings.locked)]


# More pixels are left out, and larger files are not opened.
_MOST_SIDE = 1280
_MOST_PIXELS = 50_000_000

_CHANNELS = {"rgb": (0, 1, 2), "bgr": (2, 1, 0)}


def picture_of(image: Image | CompressedImage) -> Picture:
    """The picture (H, W, 3) of an image, at most 1280 wide and high.

    Depths and other numbers are from dark to bright, by the range in the image. Raises ValueError
    for an image that cannot be read.
    """
    if isinstance(image, CompressedImage):
        return _opened(image)
    pixels = image.pixels()
    if not pixels.size:
        raise ValueError("the image has no pixels")
    step = -(-max(pixels.shape[:2]) // _MOST_SIDE)
    encoding = image.encoding
    if encoding.startswith("bayer_"):
        return _of_bayer(pixels, encoding, max(1, -(-step // 2)))
    if encoding in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"):
        return _of_yuv422(pixels, is_y_first=encoding in ("yuyv", "yuv422_yuy2"), step=step)
    pixels = pixels[::step, ::step]
    if pixels.ndim == 2:
        return np.repeat(_bytes(pixels, encoding == "mono16")[:, :, None], 3, axis=2)
    channels = pixels.shape[2]
    if channels < 3:
        return np.repeat(_bytes(pixels[:, :, 0], False)[:, :, None], 3, axis=2)
    # OpenCV's names with three channels are blue first.
    order = _CHANNELS["rgb" if encoding.startswith("rgb") else "bgr"]
    return np.ascontiguousarray(_bytes(pixels[:, :, order], encoding.endswith("16")))


def _bytes(numbers: NDArray[Any], is_16_bit: bool) -> Picture:
    if numbers.dtype == np.uint8:
        return np.ascontiguousarray(numbers)
    if is_16_bit:
        return (numbers >> 8).astype(np.uint8)
    values = numbers.astype(np.float64)
    # 0 stands for no depth, as NaN does.
    is_known = np.isfinite(values) & (values != 0.0)
    shown = np.zeros(values.shape, np.uint8)
    if is_known.any():
        low, high = np.percentile(values[is_known], (1.0, 99.0))
        with np.errstate(over="ignore", invalid="ignore"):
            parts = np.clip((values[is_known] - low) / max(high - low, 1e-9), 0.0, 1.0)
        shown[is_known] = np.nan_to_num(30.0 + 225.0 * parts).astype(np.uint8)
    return shown


def _of_bayer(pixels: NDArray[Any], encoding: str, step: int) -> Picture:
    """A pixel for each four."""
    height, width = (side - side % 2 for side in pixels.shape)
    if not height * width:
        raise ValueError("an image of colour filters needs 2 by 2 pixels")
    levels = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)
    four = [levels[y:height:2, x:width:2][::step, ::step] for y in (0, 1) for x in (0, 1)]
    order = encoding[6:10]
    greens = [four[at].astype(np.uint16) for at in range(4) if order[at] == "g"]
    green = ((greens[0] + greens[1]) >> 1).astype(np.uint8)
    return np.stack((four[order.index("r")], green, four[order.index("b")]), axis=2)


def _of_yuv422(pixels: NDArray[Any], *, is_y_first: bool, step: int) -> Picture:
    width = pixels.shape[1] - pixels.shape[1] % 2
    if not width:
        raise ValueError("an image of yuv422 needs 2 columns")
    at_y, at_uv = (0, 1) if is_y_first else (1, 0)
    rows = pixels[::step, :width]
    y = rows[:, ::step, at_y].astype(np.float32)
    # Both columns of a pair have the colour of the pair.
    of_column = np.arange(0, width, step) // 2 * 2
    u, v = (rows[:, of_column + at, at_uv].astype(np.float32) - 128.0 for at in (0, 1))
    rgb = np.stack((y + 1.402 * v, y - 0.344 * u - 0.714 * v, y + 1.772 * u), axis=2)
    picture: Picture = np.clip(rgb, 0.0, 255.0).astype(np.uint8)
    return picture


def _opened(image: CompressedImage) -> Picture:
    import PIL.Image

    try:
        # Formats that may run programs or read files, such as EPS, are not among these.
        data = io.BytesIO(image.data.tobytes())
        opened = PIL.Image.open(data, formats=("JPEG", "PNG", "WEBP"))
        if opened.width * opened.height > _MOST_PIXELS:
            raise ValueError(f"it has {opened.width} by {opened.height} pixels, too many to show")
        # JPEG is made smaller while it is read.
        opened.draft("RGB", (_MOST_SIDE, _MOST_SIDE))
        opened.thumbnail((_MOST_SIDE, _MOST_SIDE))
        return np.asarray(opened.convert("RGB"))
    except (OSError, SyntaxError, PIL.Image.DecompressionBombError) as error:
        raise ValueError(f"{image.format[:60]!r} cannot be read: {error}") from error
