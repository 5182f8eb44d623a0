"""The time that goes on while a recording is played, and stands while it is paused."""

from collections.abc import Callable

from tfbus.runtime import scheduler


class PlayedTime:
    """A call returns it, in nanoseconds from an arbitrary start. Calls are safe from any thread."""

    def __init__(self, real_ns: Callable[[], int] = lambda: scheduler.monotonic_ns()) -> None:
        self._real_ns = real_ns
        self._stood_ns = 0
        self._stands_at_ns: int | None = None

    def __call__(self) -> int:
        stands_at_ns = self._stands_at_ns
        return self._real_ns() - self._stood_ns if stands_at_ns is None else stands_at_ns

    def stand(self, is_paused: bool) -> None:
        """It stands from now on, or goes on; twice is fine."""
        if is_paused and self._stands_at_ns is None:
            self._stands_at_ns = self()
        elif not is_paused and self._stands_at_ns is not None:
            self._stood_ns = self._real_ns() - self._stands_at_ns
            self._stands_at_ns = None
