"""The epochs of recorded streams, as they are when the recording is replayed."""

from bisect import bisect_left
from collections.abc import Callable, Iterable

from tfbus.runtime import scheduler

# Epochs of one run: more than a stream has in a recording. In ns, a millisecond.
_APART_NS = 1_000_000


class StreamEpochs:
    """Gives each recorded epoch one of now, in the same order.

    Within a run, from one jump back to the next, a restart of a publisher is one again. Each run
    comes after the one before, so that listeners forget that. `recorded` are streams and their
    epochs.
    """

    def __init__(
        self,
        recorded: Iterable[tuple[str, int]],
        clock_ns: Callable[[], int] = lambda: scheduler.time_ns(),
    ) -> None:
        self._clock_ns = clock_ns
        self._run_ns = 0
        self._recorded: dict[str, list[int]] = {}
        for stream, epoch_ns in sorted(set(recorded)):
            self._recorded.setdefault(stream, []).append(epoch_ns)

    def begin_run(self) -> None:
        """From now on all epochs are later than those before."""
        self._run_ns = max(self._clock_ns(), self._run_ns + _APART_NS)

    def of(self, stream: str, epoch_ns: int) -> int:
        """The epoch now, in ns, of a recorded one."""
        return self._run_ns + bisect_left(self._recorded.get(stream, []), epoch_ns)
