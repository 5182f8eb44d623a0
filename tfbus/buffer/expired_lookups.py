"""Counts lookups older than the cache."""

from tfbus.errors import PastExtrapolationException, TransformException

# A buffer that has just been started holds less than it will: what was asked of it says nothing.
_FULL = 0.9


class ExpiredLookups:
    """How many lookups asked for times that the buffer had already forgotten, in `count`, and by
    how much at most, in `missed_by_ns`.
    """

    def __init__(self, cache_time_s: float) -> None:
        self._cache_time_s = cache_time_s
        self.count = 0
        self.missed_by_ns = 0

    def note(self, error: TransformException | None) -> None:
        """Count a lookup that failed so, where a longer cache would have had the answer."""
        if (
            isinstance(error, PastExtrapolationException)
            and error.requested_ns is not None
            and error.oldest_ns is not None
            and error.newest_ns is not None
            and error.newest_ns - error.oldest_ns > _FULL * self._cache_time_s * 1e9
        ):
            self.count += 1
            self.missed_by_ns = max(self.missed_by_ns, error.oldest_ns - error.requested_ns)
