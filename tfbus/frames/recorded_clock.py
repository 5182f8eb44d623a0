"""The time at a moment of a recording: when it was recorded, or a simulated time in it."""

from collections.abc import Iterable

from tfbus.frames.simulated import simulated_time
from tfbus.recording.items import TopicItem
from tfbus.runtime.clock import Clock
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import CLOCK_TOPIC


class RecordedClock(Clock):
    """Stands at `log_ns`; if it `follows` the recorded clock, at its last time instead."""

    def __init__(self, *, follows: bool = False) -> None:
        self.log_ns = 0
        self._follows = follows
        self._simulated_ns: int | None = None

    @property
    def is_simulated(self) -> bool:  # type: ignore[override]  # theirs can be set
        """Whether the time is simulated: it is from the first message of the recorded clock on."""
        return self._simulated_ns is not None

    def now_ns(self) -> int:
        return self.log_ns if self._simulated_ns is None else self._simulated_ns

    def elapsed_ns(self) -> int:
        return self.log_ns

    def log_s(self) -> float:
        """The log time in seconds."""
        return self.log_ns / 1e9

    def take(self, item: TopicItem, namespace: str = "") -> bool:
        """Take a message of the recorded clock, any other is none; whether it was set back."""
        stamp_ns = item.values.get("stamp_ns")
        if not self._follows or type(stamp_ns) is not int or item.topic != clock_topic(namespace):
            return False
        before_ns, self._simulated_ns = self._simulated_ns, stamp_ns
        return before_ns is not None and stamp_ns < before_ns


def clock_topic(namespace: str = "") -> str:
    """The topic of the clock of a namespace, by its full name."""
    return f"{namespace}/{CLOCK_TOPIC}" if namespace else CLOCK_TOPIC


def follows_clock(nodes: Iterable[NodeDescription]) -> bool:
    """Whether all publishers of transforms followed a simulated time."""
    time = simulated_time(nodes)
    return bool(time.clocks) and len(time.followers) == time.publishers
