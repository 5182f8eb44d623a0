"""What is known of one child frame: its samples in the order of their stamps."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from tfbus.errors import (
    ExtrapolationException,
    FutureExtrapolationException,
    NoDataException,
    PastExtrapolationException,
    SingleSampleException,
)
from tfbus.pose import Pose, interpolate


@dataclass(frozen=True, slots=True)
class Sample:
    """Where the child is in its parent; parents are kept by sample, so that history survives
    a change of parent.
    """

    parent: str
    pose: Pose


class History:
    """The samples of one child frame; `static` says which of the two kinds holds now."""

    def __init__(self, child: str) -> None:
        self.child = child
        self.static: Sample | None = None
        self.is_static = False
        self.authority = ""
        self.too_old = 0
        self.stamps: list[int] = []
        self._samples: list[Sample] = []

    def parent(self) -> str | None:
        """The parent by the newest that is known."""
        if self.is_static and self.static is not None:
            return self.static.parent
        return self._samples[-1].parent if self._samples else None

    def set_static(self, sample: Sample) -> None:
        """The sample holds at all times from now on."""
        self.static = sample
        self.is_static = True

    def insert(self, stamp_ns: int, sample: Sample, cache_time_ns: int) -> bool:
        """Take the sample, wherever its stamp belongs; of equal stamps the latest arrival
        counts. False where it is older than the newest by more than the cache time.
        """
        if self.stamps and stamp_ns < self.stamps[-1] - cache_time_ns:
            self.too_old += 1
            return False
        self.is_static = False
        at = bisect_left(self.stamps, stamp_ns)
        if at < len(self.stamps) and self.stamps[at] == stamp_ns:
            self._samples[at] = sample
            return True
        self.stamps.insert(at, stamp_ns)
        self._samples.insert(at, sample)
        expired = bisect_left(self.stamps, self.stamps[-1] - cache_time_ns)
        del self.stamps[:expired], self._samples[:expired]
        return True

    def forget_samples(self) -> None:
        """Drop what holds only at a time; a static transform stays."""
        self.stamps.clear()
        self._samples.clear()

    def at(self, stamp_ns: int) -> Sample:
        """The sample of this time, interpolated between its neighbours.

        Between two parents the older neighbour holds, as in tf2. Raises a kind of
        ExtrapolationException outside of what is known.
        """
        if self.is_static and self.static is not None:
            return self.static
        after = bisect_right(self.stamps, stamp_ns)
        if after and self.stamps[after - 1] == stamp_ns:
            return self._samples[after - 1]
        if after == 0 or after == len(self.stamps):
            raise self._outside(stamp_ns)
        older, newer = self._samples[after - 1], self._samples[after]
        if older.parent != newer.parent:
            return older
        start = self.stamps[after - 1]
        ratio = (stamp_ns - start) / (self.stamps[after] - start)
        return Sample(older.parent, interpolate(older.pose, newer.pose, ratio))

    def latest(self) -> tuple[int, str] | None:
        """The newest stamp and its parent; None where there are no samples."""
        return (self.stamps[-1], self._samples[-1].parent) if self.stamps else None

    def _outside(self, stamp_ns: int) -> ExtrapolationException:
        if not self.stamps:
            kind: type[ExtrapolationException] = NoDataException
            why = "there are no samples of it"
        elif len(self.stamps) == 1:
            kind = SingleSampleException
            why = f"there is only one sample so far, of {_seconds(self.stamps[0])}"
        elif stamp_ns < self.stamps[0]:
            kind = PastExtrapolationException
            early_ms = (self.stamps[0] - stamp_ns) / 1e6
            why = (
                f"that is {early_ms:.3f} ms before the oldest sample, of {_seconds(self.stamps[0])}"
            )
        else:
            kind = FutureExtrapolationException
            late_ms = (stamp_ns - self.stamps[-1]) / 1e6
            why = (
                f"that is {late_ms:.3f} ms after the newest sample, of "
                f"{_seconds(self.stamps[-1])}; wait for it (timeout_s) or ask for the latest (stamp_ns=None)"
            )
        parent = self.parent() or ""
        by = f", published by {self.authority}" if self.authority else ""
        return kind(
            f"{parent!r} -> {self.child!r}{by} is not known at {_seconds(stamp_ns)}: {why}",
            frame_id=parent,
            child_frame_id=self.child,
            authority=self.authority,
            requested_ns=stamp_ns,
            oldest_ns=self.stamps[0] if self.stamps else None,
            newest_ns=self.stamps[-1] if self.stamps else None,
        )


def _seconds(stamp_ns: int) -> str:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return f"{seconds}.{nanoseconds:09} s"
