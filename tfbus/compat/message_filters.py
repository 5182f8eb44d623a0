"""ROS's message_filters: messages of several topics that belong together by their stamps."""

import bisect
import itertools
import threading
from collections.abc import Callable, Iterable
from typing import Any

from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.time import Time
from tfbus.ros.transforms import stamp_ns_of

__all__ = ["ApproximateTimeSynchronizer", "Cache", "SimpleFilter", "Subscriber", "TimeSynchronizer"]


class SimpleFilter:
    """Passes messages on to callbacks."""

    def __init__(self) -> None:
        self.callbacks: dict[int, tuple[Callable[..., object], tuple[Any, ...]]] = {}

    def registerCallback(self, cb: Callable[..., object], *args: Any) -> int:
        """Call `cb(messages..., *args)` for each; returns a number for it."""
        number = len(self.callbacks)
        self.callbacks[number] = (cb, args)
        return number

    def signalMessage(self, *msg: Any) -> None:
        """Pass messages on."""
        for callback, arguments in [*self.callbacks.values()]:
            callback(*msg, *arguments)


class Subscriber(SimpleFilter):
    """The messages of a topic; arguments as of `node.create_subscription`, without the callback."""

    def __init__(
        self, node: Any, msg_type: type, topic: str, qos_profile: Any = 10, **options: Any
    ) -> None:
        super().__init__()
        self.node = node
        self.topic = topic
        self.sub = node.create_subscription(msg_type, topic, self.callback, qos_profile, **options)

    def callback(self, msg: Any) -> None:
        """Take a message."""
        self.signalMessage(msg)

    def getTopic(self) -> str:
        """The topic."""
        return self.topic

    def unsubscribe(self) -> None:
        """End it."""
        self.node.destroy_subscription(self.sub)


class Cache(SimpleFilter):
    """Keeps the last `cache_size` messages of a filter by their stamps, and passes them on.

    A message without a header has the time of its arrival with `allow_headerless`, and is left out
    otherwise.
    """

    def __init__(self, *args: Any, cache_size: int = 1, allow_headerless: bool = False) -> None:
        super().__init__()
        given = dict(zip(("f", "cache_size", "allow_headerless"), args, strict=False))
        self.cache_size = int(given.get("cache_size", cache_size))
        self.allow_headerless = bool(given.get("allow_headerless", allow_headerless))
        self._stamps: list[int] = []
        self._messages: list[Any] = []
        self._node = getattr(given.get("f"), "node", None)
        self.connectInput(given.get("f"))

    def connectInput(self, f: SimpleFilter | None) -> None:
        """Take the messages of this filter."""
        if f is not None:
            f.registerCallback(self.add)

    def add(self, msg: Any) -> None:
        """Take a message; older ones than all that are kept are left out."""
        stamp_ns = _stamp_ns(msg, self._node if self.allow_headerless else None)
        if stamp_ns is None:
            return
        at = bisect.bisect_right(self._stamps, stamp_ns)
        self._stamps.insert(at, stamp_ns)
        self._messages.insert(at, msg)
        if len(self._stamps) > self.cache_size:
            del self._stamps[0], self._messages[0]
        self.signalMessage(msg)

    def getInterval(self, from_stamp: Any, to_stamp: Any) -> list[Any]:
        """The messages from one time to another, both included."""
        first = bisect.bisect_left(self._stamps, stamp_ns_of(from_stamp))
        return self._messages[first : bisect.bisect_right(self._stamps, stamp_ns_of(to_stamp))]

    def getElemAfterTime(self, stamp: Any) -> Any:
        """The first message at this time or after it; None for none."""
        at = bisect.bisect_left(self._stamps, stamp_ns_of(stamp))
        return self._messages[at] if at < len(self._messages) else None

    def getElemBeforeTime(self, stamp: Any) -> Any:
        """The last message at this time or before it; None for none."""
        at = bisect.bisect_right(self._stamps, stamp_ns_of(stamp))
        return self._messages[at - 1] if at else None

    def getLatestTime(self) -> Time | None:
        """The stamp of the newest message; None for none."""
        return _time(self._stamps[-1]) if self._stamps else None

    def getOldestTime(self) -> Time | None:
        """The stamp of the oldest message; None for none."""
        return _time(self._stamps[0]) if self._stamps else None

    getLastestTime = getLatestTime  # as it is spelt in older releases

    def getLast(self) -> Any:
        """The newest message; None for none."""
        return self._messages[-1] if self._messages else None


class TimeSynchronizer(SimpleFilter):
    """Passes on messages of several filters that have the same stamp, one of each.

    At most `queue_size` messages of each filter wait for the others.
    """

    def __init__(self, fs: Iterable[SimpleFilter], queue_size: int) -> None:
        super().__init__()
        self.queue_size = int(queue_size)
        self._lock = threading.RLock()
        self.queues: list[dict[int, Any]] = []
        self.connectInput(fs)

    def connectInput(self, fs: Iterable[SimpleFilter]) -> None:
        """Take the messages of these filters."""
        filters = list(fs)
        self.queues = [{} for _ in filters]
        for each, queue in zip(filters, self.queues, strict=True):
            each.registerCallback(self._take, queue, getattr(each, "node", None))

    def _take(self, msg: Any, queue: dict[int, Any], node: Any) -> None:
        self.add(msg, queue)

    def add(self, msg: Any, my_queue: dict[int, Any], my_queue_index: Any = None) -> None:
        """Take a message of one filter. Raises TypeError for one without a header."""
        stamp_ns = _stamp_ns(msg, None)
        if stamp_ns is None:
            raise TypeError(f"a {type(msg).__name__} has no header with a stamp")
        with self._lock:
            self._put(my_queue, stamp_ns, msg)
            if not all(stamp_ns in queue for queue in self.queues):
                return
            together = [queue.pop(stamp_ns) for queue in self.queues]
        self.signalMessage(*together)

    def _put(self, queue: dict[int, Any], stamp_ns: int, msg: Any) -> None:
        queue[stamp_ns] = msg
        while len(queue) > self.queue_size:
            del queue[min(queue)]


class ApproximateTimeSynchronizer(TimeSynchronizer):
    """Passes on messages of several filters whose stamps are within `slop` seconds, one of each.

    Of several sets the one with the nearest stamps is taken. A message without a header has the
    time of its arrival with `allow_headerless`.
    """

    def __init__(
        self,
        fs: Iterable[SimpleFilter],
        queue_size: int,
        slop: float,
        allow_headerless: bool = False,
        sync_arrival_time: bool = False,
    ) -> None:
        self.slop = Duration(seconds=slop)
        self.allow_headerless = allow_headerless or sync_arrival_time
        self._by_arrival = sync_arrival_time
        super().__init__(fs, queue_size)

    def _take(self, msg: Any, queue: dict[int, Any], node: Any) -> None:
        node = node if self.allow_headerless else None
        stamp_ns = _stamp_ns(None if self._by_arrival else msg, node)
        if stamp_ns is None:
            raise TypeError(
                f"a {type(msg).__name__} has no header with a stamp: allow_headerless=True gives "
                "it the time of its arrival"
            )
        with self._lock:
            self._put(queue, stamp_ns, msg)
            found = self._nearest(queue, stamp_ns)
            if found is None:
                return
            together = [each.pop(at) for each, at in zip(self.queues, found, strict=True)]
        self.signalMessage(*together)

    def add(self, msg: Any, my_queue: dict[int, Any], my_queue_index: Any = None) -> None:
        """Take a message of one filter. Raises TypeError for one without a header."""
        self._take(msg, my_queue, None)

    def _nearest(self, own: dict[int, Any], stamp_ns: int) -> tuple[int, ...] | None:
        """The stamps of the set with this message whose stamps are the nearest to each other."""
        slop_ns = self.slop.nanoseconds
        near = [
            [stamp_ns]
            if queue is own
            else sorted((at for at in queue if abs(at - stamp_ns) <= slop_ns), key=_from(stamp_ns))
            for queue in self.queues
        ]
        best: tuple[int, ...] | None = None
        for found in itertools.product(*near):
            spread = max(found) - min(found)
            if spread <= slop_ns and (best is None or spread < max(best) - min(best)):
                best = found
        return best


def _from(stamp_ns: int) -> Callable[[int], int]:
    return lambda at: abs(at - stamp_ns)


def _stamp_ns(msg: Any, node: Any) -> int | None:
    """The stamp of a message's header; the time of the node's clock if there is none."""
    stamp = getattr(getattr(msg, "header", None), "stamp", None)
    if stamp is not None:
        return stamp_ns_of(stamp)
    return None if node is None else int(node.get_clock().now().nanoseconds)


def _time(stamp_ns: int) -> Time:
    return Time(nanoseconds=stamp_ns)
