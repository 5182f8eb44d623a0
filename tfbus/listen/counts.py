"""Counts of what has been received of one stream."""

from tfbus.runtime.structs import Struct

# The weight of one message in the mean delay.
_SMOOTHING = 0.1


class Counts(Struct, frozen=False):
    """What has been received of one stream; the fields are those of `StreamInfo`.

    Not safe by itself: hold the stream's lock to change it. Any thread may read it.
    """

    messages: int = 0
    transforms: int = 0
    bytes: int = 0
    missed: int = 0
    outdated: int = 0
    disputed: int = 0
    rejected: int = 0
    excluded: int = 0
    forbidden: int = 0
    last_heard_ns: int | None = None
    delay_s: float | None = None
    last_delay_s: float | None = None
    kept_delay_s: float | None = None

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
