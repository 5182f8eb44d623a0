"""Counts of what has been received of one stream."""

from typing import Any

# The weight of one message in the mean delay.
_SMOOTHING = 0.1


class Counts:
    """The counts of one stream; the names are those of fields of `StreamInfo`.

    Not safe by itself: hold the stream's lock to change it. Any thread may read it.
    """

    # A `Struct` would take three times as long to count.
    __slots__ = (
        "bytes",
        "delay_s",
        "disputed",
        "excluded",
        "forbidden",
        "kept_delay_s",
        "last_delay_s",
        "last_heard_ns",
        "messages",
        "missed",
        "outdated",
        "rejected",
        "transforms",
    )

    def __init__(self) -> None:
        self.messages = self.transforms = self.bytes = self.missed = 0
        self.outdated = self.disputed = self.rejected = self.excluded = self.forbidden = 0
        self.last_heard_ns: int | None = None
        self.delay_s: float | None = None
        self.last_delay_s: float | None = None
        self.kept_delay_s: float | None = None

    def as_map(self) -> dict[str, Any]:
        """All of them by name."""
        return {name: getattr(self, name) for name in self.__slots__}

    def add(self, transforms: int, size: int) -> None:
        """Count one message of `transforms` rows and `size` bytes."""
        self.messages += 1
        self.transforms += transforms
        self.bytes += size

    def add_delay(self, delay_s: float) -> None:
        """Take the delay of one message, also into the mean."""
        self.last_delay_s = delay_s
        former_s = delay_s if self.delay_s is None else self.delay_s
        self.delay_s = former_s + _SMOOTHING * (delay_s - former_s)

    def add_kept_delay(self, delay_s: float) -> None:
        """Take how old a message was when it came that the stream had kept."""
        former_s = self.kept_delay_s
        self.kept_delay_s = delay_s if former_s is None else min(former_s, delay_s)

    def forget_delays(self) -> None:
        """Forget the delays: a new epoch may be by another clock."""
        self.delay_s = self.last_delay_s = self.kept_delay_s = None
