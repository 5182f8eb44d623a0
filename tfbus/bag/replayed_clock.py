"""The simulated time while a recording is replayed: what nodes with simulated time follow."""

from collections.abc import Iterable

from tfbus.bag.playhead import Playhead, Progress
from tfbus.errors import DecodeError
from tfbus.messages import Clock
from tfbus.node.node import Node
from tfbus.recording.items import Item, TopicItem
from tfbus.recording.reader import RecordingReader
from tfbus.runtime import scheduler
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
        # What the recorded clock said last; None where it has not said anything yet.
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

    def take(self, item: TopicItem) -> None:
        """Take a message of the recorded clock."""
        said = self._clock_of(item)
        if said is None:
            return
        with self._lock:
            self._recorded = said
            self._publish(self._playhead.progress)

    def _clock_of(self, item: Item) -> Clock | None:
        """Time of the recorded clock in an item; None in others, and where it cannot be read."""
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
