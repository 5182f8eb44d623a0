"""Time of a replay: the simulated clock, and stamps moved to now."""

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.base import scheduler
from tfbus.base.errors import DecodeError
from tfbus.base.lazy_numpy import NDArray
from tfbus.geometry.columns import Columns
from tfbus.messages import Clock
from tfbus.node.node import Node
from tfbus.recording.items import Item, Selection, TopicItem, TransformItem
from tfbus.recording.playhead import Pace, Playhead, Progress
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import Playable
from tfbus.wire.codec import from_map
from tfbus.wire.keys import CLOCK_TOPIC


def clock_topic_of(reader: RecordingReader) -> str:
    """The topic with the simulated time that the recorded nodes followed, "" if it has none."""
    clocks = [topic.name for topic in reader.topics if is_clock(topic.name, topic.type_name)]
    return min(clocks, key=len, default="")


def is_clock(topic: str, type_name: str) -> bool:
    """Whether a topic has the simulated time, of any namespace."""
    return topic.rpartition("/")[2] == CLOCK_TOPIC and type_name in ("", Clock.__name__)


class ReplayedClock:
    """Publishes the time of a recording: its log time and `ahead_ns`, `rate_hz` times a second; or,
    if it has a simulated time itself on `recorded_topic`, that. Safe from any thread.
    """

    def __init__(
        self,
        node: Node,
        rate_hz: float,
        playhead: Playhead,
        *,
        ahead_ns: int = 0,
        recorded_topic: str = "",
    ) -> None:
        self._publisher = node.create_clock_publisher()
        self._playhead = playhead
        self._ahead_ns = ahead_ns
        self._recorded_topic = recorded_topic
        # The last message of the recorded clock; None before the first.
        self._recorded: Clock | None = None
        # Held while the time is read and published: it never goes back but by a jump.
        self._lock = scheduler.Lock()
        if not recorded_topic:
            node.create_timer(1.0 / rate_hz, self._tick)

    def begin(self, state: Iterable[Item]) -> None:
        """Publish the time at a moment if this is in force, as after a jump."""
        said = [clock for item in state if (clock := self._clock_of(item)) is not None]
        with self._lock:
            self._recorded = said[-1] if said else None
            self._publish(self._playhead.progress)

    def follow(self) -> None:
        """Publish the time, if it stands still from now on, or goes at another rate."""
        with self._lock:
            self._publish(self._playhead.progress)

    def set_by(self, item: TopicItem) -> None:
        """Set it by a message of the recorded clock."""
        said = self._clock_of(item)
        if said is None:
            return
        with self._lock:
            self._recorded = said
            self._publish(self._playhead.progress)

    def _clock_of(self, item: Item) -> Clock | None:
        """Time of the recorded clock in an item; None in others, and if it cannot be read."""
        if not isinstance(item, TopicItem) or item.topic != self._recorded_topic:
            return None
        try:
            return from_map(Clock, item.values)
        except DecodeError:
            return None

    def _tick(self) -> None:
        with self._lock:
            progress = self._playhead.progress
            if not progress.is_paused:
                self._publish(progress)

    def _publish(self, progress: Progress) -> None:
        rate, paused = progress.rate, progress.is_paused
        if self._recorded_topic:
            said = self._recorded
            if said is not None:
                stands = paused or said.paused
                self._publisher.publish(Clock(said.stamp_ns, said.rate * rate, stands))
        else:
            self._publisher.publish(Clock(max(progress.log_ns + self._ahead_ns, 0), rate, paused))


# A recording whose stamps are further from its log times than this was made with simulated time.
_OTHER_CLOCK_NS = 60_000_000_000

# This many messages of transforms, of this many items, say it.
_MESSAGES, _ITEMS = 50, 2000

# Our field of a stamp, and a header of ROS, by its fields and its stamp's.
_STAMP = "stamp_ns"
_HEADER = {"stamp", "frame_id"}
_TIME = {"sec", "nanosec"}
_SECOND_NS = 1_000_000_000

_FIRST_NS, _LAST_NS = -(2**63), 2**63 - 1

# 146 years. A shorter time can be added to any stamp of a recording.
_FAR_NS = 2.0**62


def stamps_ahead_ns(source: Playable, selection: Selection, from_ns: int) -> int:
    """By how much the stamps of a recording are ahead of its log times, from a moment on.

    0 if they are of the same clock: then a difference is a delay, and stays one.
    """
    items = islice(source.items(from_ns, None, selection), _ITEMS)
    dynamic = (item for item in items if isinstance(item, TransformItem) and not item.static)
    ahead = [
        stamp_ns - item.log_ns
        for item in islice(dynamic, _MESSAGES)
        if (stamp_ns := item.rows.last_stamp_ns()) is not None
    ]
    middle = sorted(ahead)[len(ahead) // 2] if ahead else 0
    return middle if abs(middle) > _OTHER_CLOCK_NS else 0


def moved_ns(stamp_ns: int, pace: Pace, ahead_ns: int) -> int:
    """A stamp of now, as `moved` has the stamps of rows."""
    return pace.wall_ns + round((stamp_ns - pace.log_ns - ahead_ns) / pace.rate)


def moved(rows: Columns, pace: Pace, ahead_ns: int) -> Columns:
    """The rows with stamps of now: that of `pace.log_ns + ahead_ns` becomes `pace.wall_ns`.

    At rate 1 all are moved by the same number of nanoseconds.
    """
    origin_ns = pace.log_ns + ahead_ns
    stamps = rows.stamps_ns()
    if pace.rate == 1.0:
        stamps = _later(stamps, pace.wall_ns - origin_ns)
    else:
        since = np.clip(np.rint(_later(stamps, -origin_ns) / pace.rate), -_FAR_NS, _FAR_NS)
        stamps = _later(since.astype(np.int64), pace.wall_ns)
    return _stamped(rows, stamps)


def _later(stamps: "NDArray[np.int64]", by_ns: int) -> "NDArray[np.int64]":
    """The stamps, so much later; the first or the last one of 64 bits if they are beyond."""
    if -_FAR_NS <= by_ns <= _FAR_NS:
        return stamps + by_ns  # stamps of a recording are from 1901 to 2038
    by_ns = min(max(by_ns, _FIRST_NS), _LAST_NS)
    return (
        np.clip(stamps, max(_FIRST_NS, _FIRST_NS - by_ns), min(_LAST_NS, _LAST_NS - by_ns)) + by_ns
    )


def moved_to(rows: Columns, stamp_ns: int) -> Columns:
    """The rows with this stamp."""
    return _stamped(rows, np.full(rows.count, stamp_ns, np.int64))


def _stamped(rows: Columns, stamps: "NDArray[np.int64]") -> Columns:
    return Columns.of_bytes(rows.frames, rows.edges_bytes(), stamps.tobytes(), rows.poses_bytes())


def with_stamps(values: Mapping[str, Any], pace: Pace, ahead_ns: int) -> Mapping[str, Any]:
    """The fields of a message with its stamps moved as those of rows are, in nested messages too;
    the same object if it has none.

    A stamp is an integer `stamp_ns`, or a ROS header's. 0 stays: it stands for no time.
    """
    if values.keys() == _HEADER:
        stamp = values["stamp"]
        if isinstance(stamp, dict) and stamp.keys() == _TIME:
            return {**values, "stamp": _moved_time(stamp, pace, ahead_ns)}
    changed = {
        key: new
        for key, value in values.items()
        if (new := _moved_in(key, value, pace, ahead_ns)) is not None
    }
    return {**values, **changed} if changed else values


def _moved_in(key: str, value: Any, pace: Pace, ahead_ns: int) -> Any:
    """A field with its stamps moved; None if it has none."""
    if key == _STAMP:
        return moved_ns(value, pace, ahead_ns) if type(value) is int and value else None
    if isinstance(value, dict):
        moved_value = with_stamps(value, pace, ahead_ns)
        return None if moved_value is value else moved_value
    if isinstance(value, list) and value and isinstance(value[0], dict):
        items = [
            with_stamps(each, pace, ahead_ns) if isinstance(each, dict) else each for each in value
        ]
        is_same = all(new is each for new, each in zip(items, value, strict=True))
        return None if is_same else items
    return None


def _moved_time(stamp: Mapping[str, Any], pace: Pace, ahead_ns: int) -> Mapping[str, Any]:
    sec, nanosec = stamp["sec"], stamp["nanosec"]
    if type(sec) is not int or type(nanosec) is not int or not (sec or nanosec):
        return stamp
    sec, nanosec = divmod(moved_ns(sec * _SECOND_NS + nanosec, pace, ahead_ns), _SECOND_NS)
    return {"sec": sec, "nanosec": nanosec}
